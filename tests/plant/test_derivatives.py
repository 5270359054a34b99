"""Drive and loop with derivatives: forwards the machine's bits, backwards what differences say."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy import signal

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.lanes import clip, fields, part
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import z_axis
from kerfgym.envs.plant.derivatives import Felt, Made, Period, Rollout
from kerfgym.envs.plant.machine import SUBSTEPS
from kerfgym.envs.tasks import workshop

GATE = {"opens": 0.75 + 1e-9, "weight": 0.2}


class Gains(NamedTuple):
    kp: float = 85.0
    share: float = 0.35  # of what is on its way that counts


class Sent(NamedTuple):
    """Commands on their way: the second newest first."""

    c1: float = 0.0
    c2: float = 0.0
    c3: float = 0.0
    c4: float = 0.0
    c5: float = 0.0


@part
def follows(params, state, felt, memory):
    """A damped follower; memory: speed to feed forward, the sheet, and how many ms of commands are on their way."""
    s, behind = state, memory[2]
    moving = clip(behind - 0.5, 0.0, 1.0) * felt.command + clip(behind - 1.5, 0.0, 1.0) * s.c1
    moving += clip(behind - 2.5, 0.0, 1.0) * s.c2 + clip(behind - 3.5, 0.0, 1.0) * s.c3
    moving += clip(behind - 4.5, 0.0, 1.0) * s.c4 + clip(behind - 5.5, 0.0, 1.0) * s.c5
    error = felt.head_position - memory[1] - felt.set_height + params.share * 1e-3 * moving
    return Sent(felt.command, s.c1, s.c2, s.c3, s.c4), memory[0] - params.kp * error - 0.1 * felt.head_velocity


@part
def obeys(params, state, felt, memory):
    """Sends what it is told."""
    return Sent(0.0, 0.0, 0.0, 0.0, 0.0), memory[0]


def periods(machines, count, **values):
    """What is recorded of periods."""
    course = np.zeros((machines, count, len(Period._fields)))
    for name, value in {**GATE, "sent": np.nan, **values}.items():
        course[:, :, Period._fields.index(name)] = value
    return course


def drawn(random, exact=True):
    """A drive as scenarios have them and beyond; exact: without converter and encoder."""
    bristles = random.random() < 0.5
    return z_axis.Params(
        omega=2 * np.pi * random.uniform(40, 150),
        zeta=random.uniform(0.5, 1.2),
        acceleration=random.uniform(8e3, 2e4),
        jerk=random.uniform(8e5, 4e6),
        dead_time=random.uniform(0.0, 5.9),
        dac=0.0 if exact else 500.0 / 32768.0,
        encoder=0.0 if exact else 1e-3,
        friction=random.uniform(0.0, 1500.0),
        bristle=random.uniform(0.002, 0.02) if bristles else 0.0,
        stiction=random.uniform(1.0, 1.6),
        backlash=random.uniform(0.0, 0.02),
        omega_r=2 * np.pi * random.uniform(60, 180),
        zeta_r=random.uniform(0.02, 0.2),
        compliance=random.uniform(0.0, 0.3),
    )


@pytest.mark.parametrize("axis", [{}, {"bristle": 0.008, "stiction": 1.4, "dead_time": 0.0027}])
def test_forwards_it_is_the_machine_to_the_bit(axis):
    """With limits reached, friction, backlash, resonance, dead times that are not whole, converter and encoder."""
    scenario = scenarios.load("rough").varied(axis=axis, duration=0.4, settle=0.1)
    seeds = np.arange(40, dtype=np.uint64)
    fleet = workshop.fleet_for(scenario, stack.asked("pid"), seeds)
    mine = Rollout(40, obeys, Gains, Sent, 1)
    mine.put_law(np.arange(40), Gains(), Sent())
    mine.put_state(fleet)
    record = fleet.start_recording(400)
    course = periods(40, 400)
    encoder = np.zeros((40, 400))
    for t in range(400):
        fleet.advance()
        for name in ("surface", "slope", "bend", "opens", "weight"):
            course[:, t, Period._fields.index(name)] = fleet.column(f"course.{name}")
        course[:, t, Period._fields.index("sent")] = fleet.column("signals.command")
        encoder[:, t] = fleet.column("signals.head_position")
    mine.put_recorded(course, np.zeros((40, 400, 1)))
    made = mine.forward()
    np.testing.assert_array_equal(np.float32(made[:, :, Made._fields.index("gap")]), record[:, 0].T)
    np.testing.assert_array_equal(made[:, :, Made._fields.index("position")], encoder)
    assert np.ptp(encoder) > 0.2
    assert len(np.unique(fleet.column("z.dead_time"))) > 1


def test_a_thousand_machines_and_moments_have_the_derivative_that_differences_have():
    """Central differences of the whole roll-out along random directions of what it is given, extrapolated (Richardson);
    moments at which a limit, a sign or a comparison changes sides between them have no derivative and are few."""
    random, n, count = np.random.default_rng(5), 1000, 12
    roll = Rollout(n, follows, Gains, Sent, 3)
    drives = [drawn(random) for _ in range(n)]
    start = random.uniform(0.5, 3.0, n)
    before = random.normal(0.0, 60.0, (n, 7))
    speed, acceleration = random.normal(0.0, 60.0, n), random.normal(0.0, 2000.0, n)
    memory = np.stack(
        [random.normal(0, 60, (n, count)), random.normal(0, 0.3, (n, count)), random.uniform(1, 6, (n, count))], 2
    )
    weights = random.normal(size=(n, count, 3)) * [1.0, 1e-3, 1.0]
    direction = random.normal(size=(n, count, 3)) * [60.0, 0.3, 1.0]
    course = periods(n, count, surface=random.normal(0, 0.1, (n, count)))
    for i, p in enumerate(drives):
        roll.put_drive(i, p)

    def rolled(at, kp=0.0):
        for i in range(n):
            roll.put_law(i, Gains(kp=85.0 + kp), Sent(*before[i, 1:6]))
            roll.put_head(i, start[i], Felt(start[i], 0.0, 1.0, before[i, 0]))
        for k in range(7):
            roll.set(f"drive.c{k}", np.arange(n), before[:, k])
        roll.set("motion.velocity", np.arange(n), speed)
        roll.set("motion.acceleration", np.arange(n), acceleration)
        roll.put_recorded(course, at)
        return (roll.forward() * weights).sum(axis=(1, 2))

    def central(function, h):
        return (function(h) - function(-h)) / (2.0 * h)

    def differences(function):
        """Of each machine at the step at which they agree best with those at half of it, extrapolated; and how well."""
        found, apart = np.zeros(n), np.full(n, np.inf)
        halves = [central(function, 4e-4 * 0.5**i) for i in range(9)]
        for wide, middle, narrow in zip(halves[:-2], halves[1:-1], halves[2:], strict=True):
            one, other = (4.0 * middle - wide) / 3.0, (4.0 * narrow - middle) / 3.0
            better = np.abs(one - other) < apart
            found[better], apart[better] = other[better], np.abs(one - other)[better]
        return found, apart / np.abs(found)

    rolled(memory)
    bars = roll.backward(weights)
    mine, mine_kp = (bars * direction).sum(axis=(1, 2)), 85.0 * roll.law_adjoints()[:, 0]
    for ours, along in (
        (mine, lambda h: rolled(memory + h * direction)),
        (mine_kp, lambda h: rolled(memory, 85.0 * h)),
    ):
        theirs, apart = differences(along)
        smooth = apart < 1e-6  # the others change sides within the smallest step, or their sum is next to nothing
        error = np.abs(ours - theirs) / np.abs(theirs)
        assert smooth.sum() > 950
        assert error[smooth].max() < 1e-6


def substeps(p):
    """A period of a drive without limits, as a matrix on position, velocity, acceleration and command: its substeps by
    hand, in the order in which they are done."""
    dt = 1e-3 / SUBSTEPS
    x = p.omega * dt
    stiff = p.omega * x * (1.0 - p.zeta * x)
    damp = 2.0 * p.zeta * x - (2.0 * p.zeta**2 - 0.5) * x * x
    accelerate = np.eye(4)
    accelerate[2] = [0.0, -stiff, 1.0 - damp, stiff]
    move = np.eye(4)
    move[1] += 0.5 * dt * (np.eye(4)[2] + accelerate[2])
    move[2] = accelerate[2]
    place = move.copy()
    place[0] += 0.5 * dt * (np.eye(4)[1] + move[1])
    return np.linalg.matrix_power(place, SUBSTEPS)


def test_backwards_a_drive_without_limits_is_the_transpose_of_its_impulse_response():
    """Independent of all parts: its substeps as a matrix, and a second-order velocity loop in SciPy."""
    p = z_axis.Params(
        speed=1e6, acceleration=1e9, jerk=1e15, dead_time=1.0, dac=0.0, encoder=0.0, friction=0.0, backlash=0.0,
        compliance=0.0, low=-1e9, high=1e9,
    )  # fmt: skip
    count = 60
    roll = Rollout(1, obeys, Gains, Sent, 1)
    roll.put_drive(0, p)
    roll.put_law(0, Gains(), Sent())
    roll.put_head(0, 0.0)
    roll.put_recorded(periods(1, count), np.zeros((1, count, 1)))
    roll.forward()
    last_ = np.zeros((1, count, 3))
    last_[0, -1, 0] = 1.0  # d(gap at the end)/d(each command)
    bars = roll.backward(last_)[0, :, 0]
    period, state, moved = substeps(p), np.zeros(4), []
    for t in range(count):
        state = period @ [*state[:3], 1.0 if t == 0 else 0.0]
        moved.append(state[0])
    # A command acts after a period's dead time, which ends 1e-9 of a period before the next begins.
    expected = np.array([0.0, *moved[:-1]])[::-1]
    assert bars == pytest.approx(expected, rel=1e-9, abs=1e-15)
    plant = signal.lti([p.omega**2], [1.0, 2 * p.zeta * p.omega, p.omega**2, 0.0])
    _, position = signal.step(plant, T=np.arange(count) * 1e-3)  # of a velocity step of 1 mm/s
    assert expected.sum() == pytest.approx(position[-1], rel=1e-3)


def test_a_dead_time_whose_commands_are_not_kept_is_refused():
    roll = Rollout(1, follows, Gains, Sent, 3)
    roll.put_drive(0, z_axis.Params(dead_time=6.0))
    with pytest.raises(
        InvalidInput, match=r"latency of 6\.5 ms: gradients keep the commands of 6 ms; allowed: a machine"
    ):
        roll.put_drive(0, z_axis.Params(dead_time=6.5))
    late = scenarios.load("wavy").varied(axis={"dead_time": 0.01})
    fleet = workshop.fleet_for(late, stack.asked("xi2023-tuned"), [1000])
    with pytest.raises(InvalidInput, match=r"gradients keep the commands of 6 ms"):
        roll.put_state(fleet)


def test_what_the_supervisor_sends_instead_has_no_derivative_of_the_law():
    course = periods(2, 30)
    course[0, 10:, Period._fields.index("sent")] = 5.0
    roll = Rollout(2, follows, Gains, Sent, 3)
    for i in range(2):
        roll.put_drive(i, z_axis.Params(dead_time=2.0))
        roll.put_law(i, Gains(), Sent())
        roll.put_head(i, 1.0, Felt(1.0, 0.0, 1.0, 0.0))
    roll.put_recorded(course, np.zeros((2, 30, 3)))
    made = roll.forward()
    assert (made[0, 10:, 1] == 5.0).all()
    bars = roll.backward(np.ones((2, 30, 3)))
    assert not bars[0, 10:].any()
    assert bars[0, :10].any()
    assert bars[1, 10:].any()


def test_a_chunk_goes_on_where_the_last_one_ended():
    random = np.random.default_rng(3)
    memory = np.stack([random.normal(0, 50, (3, 40)), random.normal(0, 0.2, (3, 40)), np.full((3, 40), 4.2)], axis=2)
    course = periods(3, 40, surface=random.normal(0, 0.05, (3, 40)))
    made = []
    for pieces in ([40], [15, 25]):
        roll, at, found = Rollout(3, follows, Gains, Sent, 3), 0, []
        for i in range(3):
            roll.put_drive(i, z_axis.Params(dead_time=1.5, bristle=0.01))
            roll.put_law(i, Gains(), Sent())
            roll.put_head(i, 1.0, Felt(1.0, 0.0, 1.0, 0.0))
        roll.put_recorded(course, memory)
        for length in pieces:
            found.append(roll.forward(at, length))
            roll.backward(np.ones_like(found[-1]))  # changes nothing of where the machines are
            at += length
        made.append(np.concatenate(found, axis=1))
    np.testing.assert_array_equal(made[0], made[1])


def test_shapes_that_do_not_fit_are_refused():
    roll = Rollout(2, follows, Gains, Sent, 3)
    with pytest.raises(InvalidInput, match=r"memory has shape \(2, 5, 4\); it must be \(2, 5, 3\)"):
        roll.put_recorded(periods(2, 5), np.zeros((2, 5, 4)))
    roll.put_recorded(periods(2, 5), np.zeros((2, 5, 3)))
    with pytest.raises(InvalidInput, match="periods 3 to 6 are asked for; 5 are recorded"):
        roll.forward(3, 3)
    roll.forward()
    with pytest.raises(InvalidInput, match=r"what is recorded has shape \(1, 3\); it must be \(2, 3\)"):
        roll.put_memory(0, np.zeros((1, 3)))
    with pytest.raises(InvalidInput, match=r"what is wanted has shape \(2, 1, 1\)"):
        roll.put_wanted(0, np.zeros((2, 1, 1)))
    with pytest.raises(InvalidInput, match=r"more than 1,073,741,824 numbers; fewer machines"):
        roll.lay(10**9)
    with pytest.raises(InvalidInput, match=r"the adjoints have shape \(2, 5\); they must be \(2, 5, 3\)"):
        roll.backward(np.zeros((2, 5)))


def test_substeps_come_in_fives():
    assert SUBSTEPS % 5 == 0
    assert fields(Made) == ["gap", "command", "position"]


def test_adjoints_of_some_places_are_those_of_all():
    random = np.random.default_rng(8)
    memory = np.stack([random.normal(0, 50, (3, 20)), random.normal(0, 0.2, (3, 20)), np.full((3, 20), 4.2)], axis=2)
    found = []
    for wanted in (None, range(1, 2)):
        roll = Rollout(3, follows, Gains, Sent, 3, wanted)
        for i in range(3):
            roll.put_drive(i, z_axis.Params())
            roll.put_law(i, Gains(), Sent())
            roll.put_head(i, 1.0, Felt(1.0, 0.0, 1.0, 0.0))
        roll.put_recorded(periods(3, 20), memory)
        roll.forward()
        found.append(roll.backward(np.ones((3, 20, 3))))
    assert found[1].shape == (3, 20, 1)
    np.testing.assert_allclose(found[1][:, :, 0], found[0][:, :, 1], rtol=1e-12)


def test_after_other_periods_are_recorded_nothing_is_left_to_go_back_through():
    roll = Rollout(1, follows, Gains, Sent, 3)
    roll.put_recorded(periods(1, 50), np.zeros((1, 50, 3)))
    roll.forward()
    roll.put_recorded(periods(1, 2), np.zeros((1, 2, 3)))
    with pytest.raises(InvalidInput, match=r"they must be \(1, 0, 3\)"):
        roll.backward(np.zeros((1, 50, 3)))
