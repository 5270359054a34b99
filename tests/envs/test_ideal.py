"""Idealised stages are without fault, and leave the others and other machines alone."""

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import ideal, machine, z_axis
from kerfgym.envs.scenarios import Head, Scenario, Sheet
from kerfgym.experiments.measure import rollout

QUIET = Head(noise=0.0, jitter=0.0, impulses=0.0)
SLOPE = Scenario(name="slope", duration=0.15, settle=0.0, set_height=0.8, feed=200, sheet=Sheet(tilt=-0.05), head=QUIET)
STILL = Scenario(name="still", duration=0.2, settle=0.0, set_height=0.8, feed=0.0)


def rolled(scenario, controller, *stages, seeds=range(16), only=None):
    stack = stacks.resolve(controller)

    def change(fleet):
        for stage in stages:
            ideal.idealise(fleet, stage, np.arange(fleet.size) if only is None else only)

    return rollout.roll(scenario, stack, seeds, 1, change)


def test_an_ideal_servo_has_the_commanded_speed_after_two_substeps():
    p = z_axis.Params()._replace(**ideal.SERVO, dead_time=0.0)
    gains, drive = z_axis.gains(p, machine.DT), z_axis.accept(p, z_axis.Drive(), 37.3)
    state = z_axis.at_rest(0.0)
    speeds = []
    for k in range(machine.SUBSTEPS):
        state, head = z_axis.step(p, gains, z_axis.pace(p, drive), state, (k + 1) / machine.SUBSTEPS, machine.DT)
        speeds.append(state.velocity)
    assert speeds[1:] == pytest.approx([37.3] * (machine.SUBSTEPS - 1), rel=1e-9)
    assert head == pytest.approx(37.3 * (machine.SUBSTEPS - 1) * machine.DT, rel=1e-9)  # half of each substep lost


def test_without_dead_time_a_command_moves_the_head_in_the_period_in_which_it_is_given():
    slow = SLOPE.varied(axis={"dead_time": 0.002, "latency": 0.0})
    late, prompt = (rolled(slow, "xi2023-tuned", *s, seeds=[0]) for s in ((), ("dead time",)))
    given = np.argmax(np.abs(late["command"][:, 0]) > 1.0)
    moves = [int(np.argmax(np.abs(r["velocity"][:, 0]) > 1e-3)) for r in (late, prompt)]
    assert moves[0] - moves[1] == 2
    assert moves[1] <= given


def test_an_ideal_sensor_is_one_without_faults_bit_for_bit():
    faults = {"jitter": 1e-5, "drift": 0.01, "impulses": 30.0, "bursts": 5.0, "plasma": 0.02}
    bad, none = {"noise": 0.005, **faults}, dict.fromkeys(("noise", *faults), 0.0)
    real, cured, sound = (
        rolled(STILL.varied(head=head), "xi2023-improved", *stages)
        for head, stages in ((bad, ()), (bad, ("sensor",)), (none, ()))
    )
    np.testing.assert_array_equal(cured.data, sound.data)
    assert not np.array_equal(real.data, sound.data)


def test_an_exact_table_reads_the_gap_that_a_calibrated_one_misses():
    scenario = STILL.varied(head={"noise": 0.0, "jitter": 0.0, "impulses": 0.0})
    misread = {}
    for stages in ((), ("table",)):
        r = rolled(scenario, "idle:filter.kind=0", *stages)
        misread[stages] = np.abs((r["raw_height"] - r["gap"]).mean(axis=0)).max()
    assert misread[("table",)] < 1e-4 < 5e-4 < misread[()]  # mm; a count of the clock is 0.4 µm, its mean far less


@pytest.mark.parametrize(
    "filter_",
    [
        "filter.kind=1,filter.window=9",
        "filter.kind=2,filter.window=8,filter.trim=2",
        "filter.kind=4,filter.window=7",
        "filter.kind=5,filter.tau=4",
    ],
)
def test_a_filter_without_delay_follows_a_slope_at_once_and_still_averages_noise(filter_):
    late, prompt = (rolled(SLOPE, f"idle:{filter_}", *s) for s in ((), ("filter",)))
    behind = [np.abs((r["height"] - r["raw_height"])[20:].mean(axis=0)) for r in (late, prompt)]
    assert behind[0].min() > 0.025  # mm; 10 mm/s times 3 ms and more
    assert behind[1].max() < 1e-4

    noisy = STILL.varied(head={"noise": 0.005, "impulses": 0.0})
    late, prompt = (rolled(noisy, f"idle:{filter_}", *s) for s in ((), ("filter",)))
    np.testing.assert_allclose(prompt["height"], late["height"], atol=2e-6)  # nothing moves, so nothing is late
    assert late["height"].std() < 0.7 * late["raw_height"].std()


def test_other_machines_of_the_fleet_keep_every_bit():
    controller, wavy = "xi2023-improved", scenarios.load("wavy").varied(duration=0.3)
    real = rolled(wavy, controller, seeds=range(4))
    mixed = rolled(wavy, controller, *ideal.FOLLOWING, seeds=range(4), only=[1, 3])
    same = [(real.data[:, :, i] == mixed.data[:, :, i]).all() for i in range(4)]
    assert same == [True, False, True, False]


def test_a_filter_of_one_sample_has_no_delay_to_take_away():
    wavy = scenarios.load("wavy").varied(duration=0.3)
    records = [rolled(wavy, "xi2023-tuned", *s, seeds=range(4)) for s in ((), ("filter",))]
    np.testing.assert_array_equal(records[0].data, records[1].data)


def test_an_unknown_stage_is_named_with_the_nearest():
    with pytest.raises(InvalidInput, match=r"unknown stage 'servos'.*servo"):
        rolled(STILL, "idle", "servos", seeds=[0])
    with pytest.raises(InvalidInput, match="of jobs"):
        rolled(STILL, "idle", "axes", seeds=[0])
