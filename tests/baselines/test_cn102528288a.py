"""CN102528288A: the schedules against the text, and integrals that are eased in without a bump."""

import numpy as np
import pytest

from kerfgym.baselines import cn102528288a as law
from kerfgym.envs.control.stack import get, resolve
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant.controller import PERIOD, Sensed


@pytest.mark.parametrize(
    ("error", "share"), [(0.0, 0.35), (0.99, 0.35), (1.0, 0.35), (2.0, 0.55), (3.0, 0.75), (3.01, 0.75), (12.0, 0.75)]
)
def test_the_position_gain_is_35_percent_for_small_and_75_for_large_errors(error, share):
    assert law.position_gain(error) == law.position_gain(-error) == pytest.approx(share)


@pytest.mark.parametrize(("error", "share"), [(5.0, 0.0), (1.0, 0.0), (0.99, 0.5), (0.5, 0.5), (0.49, 1.0), (0.0, 1.0)])
def test_the_integral_gain_opens_in_halves(error, share):
    assert law.integral_share(error) == law.integral_share(-error) == share


def lived(p, errors, velocities=None, **more):
    """Commands of the law over a list of errors, mm."""
    state, out = law.init(p), []
    speeds = np.zeros(len(errors)) if velocities is None else velocities
    for i, (e, v) in enumerate(zip(errors, speeds, strict=True)):
        x = Sensed(height=1.0 + e, set_height=1.0, head_velocity=v, fresh=i == 0, captured=True)._replace(**more)
        state, wish = law.control(p, state, x, ())
        out.append(wish)
    return np.array(out), state


ENCODER = law.Params(gain=100.0, ki=5000.0, kpv=0.8, kiv=60.0, speed=0.0)


@pytest.mark.parametrize("edge", [0.5, 1.0])
@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_crossing_a_step_of_the_integral_gain_does_not_move_the_command(edge, speed):
    p = ENCODER._replace(speed=speed, lag=3.0)
    errors = np.linspace(edge + 0.1, edge - 0.1, 401)  # 0.5 µm a period
    wishes, _ = lived(p, errors)
    change = np.abs(np.diff(wishes))[20:]  # the lag has settled
    # Within a period no term moves by more than its gain's increment: the proportional one and both integrals.
    wanted = p.gain * 0.35 * edge + p.limit
    assert change.max() < p.kpv * (p.gain * 0.35 * 5e-4 + p.ki * edge * PERIOD) + p.kiv * wanted * PERIOD
    assert np.abs(np.diff(wishes[20:], 2)).max() < p.kpv * p.ki * edge * PERIOD + p.kiv * wanted * PERIOD
    # An integral whose gain was switched rather than its increments would have jumped by half of itself.
    _, state = lived(p, errors[:200])
    assert abs(state.position) > 3 * change.max() or edge == 1.0


def test_the_integrals_grow_by_the_share_that_is_on():
    for error, share in ((1.2, 0.0), (0.7, 0.5), (0.3, 1.0)):
        _, state = lived(ENCODER._replace(kiv=0.0), np.full(4, error))
        assert state.position == pytest.approx(-4 * share * ENCODER.ki * error * PERIOD)
        _, state = lived(ENCODER._replace(ki=0.0), np.full(4, error))
        wanted = -100.0 * 0.35 * error if error < 1 else -100.0 * law.position_gain(error) * error
        assert state.speed == pytest.approx(4 * share * ENCODER.kiv * wanted * PERIOD)


def test_without_integrals_the_steady_speed_is_what_the_speed_loop_leaves_of_it():
    p = law.Params(gain=100.0, ki=0.0, kpv=3.0, kiv=0.0)
    wanted = -75.0 * 4.0
    for _ in range(3):  # a head that does what it is told, in the end
        settled = wanted * p.kpv / (1 + p.kpv)
        wishes, _ = lived(p, np.full(5, 4.0), np.full(5, settled))
    assert wishes[-1] == pytest.approx(settled)


def test_the_integrals_stand_still_under_override_and_are_empty_during_the_approach():
    _, grown = lived(ENCODER, np.full(50, 0.3))
    x = Sensed(height=1.3, set_height=1.0, fresh=False, captured=True, override=True)
    held, _ = law.control(ENCODER, grown, x, ())
    assert (held.position, held.speed) == (grown.position, grown.speed)
    far, _ = law.control(ENCODER, grown, x._replace(captured=False), ())
    assert (far.position, far.speed) == (0.0, 0.0)


def test_the_speed_of_the_gap_holds_the_sheets_and_so_feeds_it_forward():
    rising = 0.1 - 4.0 * PERIOD * np.arange(50)  # a sheet rises by 4 mm/s under a head that stands still
    p = law.Params(gain=100.0, ki=0.0, kpv=1.5, kiv=0.0)
    encoder, gap = lived(p, rising)[0], lived(p._replace(speed=1.0), rising)[0]
    assert (gap - encoder)[1:] == pytest.approx(1.5 * 4.0)


def test_both_readings_of_the_following_speed_can_be_chosen_by_name():
    assert get("cn102528288a").part("law").speed == law.SPEEDS.index("encoder")
    assert get("cn102528288a-gap").part("law").speed == law.SPEEDS.index("gap")
    assert resolve("cn102528288a:law.speed=gap").part("law").speed == 1.0
    with pytest.raises(InvalidInput, match=r"law\.speed = 'gab' is not known; did you mean 'gap'\?"):
        resolve("cn102528288a:law.speed=gab")
