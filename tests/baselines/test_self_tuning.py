"""The self-tuning predictor: its estimator against numpy's least squares, its prediction against the sheet."""

import numpy as np
import pytest

from kerfgym.baselines import self_tuning as law
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.plant import supervisor
from kerfgym.envs.plant.controller import PERIOD, Sensed
from kerfgym.experiments.measure import rollout

TERMS = law.TERMS


def readings(sheet, commands=None, velocity=None):
    """Signals of a head that rests while the sheet under it moves; mm, one a period."""
    rows = []
    for k, level in enumerate(sheet):
        rows.append(
            Sensed(
                height=1.0 - level,
                raw_height=1.0 - level,
                frequency=1e6,
                valid=True,
                set_height=1.0,
                head_position=1.0,
                head_velocity=0.0 if velocity is None else velocity[k],
                command=0.0 if commands is None else commands[k],
                mode=supervisor.FOLLOW,
                override=False,
                captured=True,
                fresh=k == 0,
                feed=200.0,
                place=0.0,
                lap=0.0,
            )
        )
    return rows


def driven(params, signals):
    """Memory, states and commands of the law over the signals."""
    memory, state, out = np.zeros(law.MEMORY), law.init(params), []
    for x in signals:
        state, command = law.control(params, state, x, np.zeros(0), memory)
        out.append(command)
    return memory, state, np.array(out)


def design(sheet):
    """What predictions are made from, a row a period, built from the definition."""
    sheet = np.asarray(sheet)
    rows = []
    for k in range(law.RECENT):
        before = np.concatenate([np.full(k + 1, sheet[0]), sheet[: len(sheet) - k - 1]])
        rows.append(sheet - before)
    for k in range(law.AVERAGES):
        share, mean, off = 0.5 ** (k + 1), sheet[0], []
        for level in sheet:
            off.append(level - mean)
            mean += share * (level - mean)
        rows.append(np.array(off))
    return np.array(rows).T


def test_the_coefficients_are_those_of_regularised_least_squares():
    """Without forgetting and gate, recursive least squares is ridge regression with the weights that it took."""
    rng = np.random.default_rng(1)
    sheet = np.cumsum(rng.normal(size=150)) * 1e-3
    p = law.Params(memory=1e12, prior=0.7, gate=1e9)
    memory, _, _ = driven(p, readings(sheet))
    x, far = design(sheet), law.FAR
    # The usual innovation changes, and with it the weight of a period: it is followed here by the definition.
    a, usual, known = np.eye(TERMS) / 0.7**2, 4e-6, 0
    b, theta = np.zeros((TERMS, 3)), np.zeros((TERMS, 3))
    for t in range(1, len(sheet)):
        known += 1
        if known <= far + 2:
            continue
        row = x[t - far]
        came = np.array([sheet[t - far + h] - sheet[t - far] for h in (law.NEAR, law.MIDDLE, far)])
        missed = came - row @ theta
        a += np.outer(row, row) / usual
        b += np.outer(row, came) / usual
        theta = np.linalg.solve(a, b)
        usual = max(0.99 * usual + 0.01 * missed[2] ** 2, law.QUIET**2)
    found = memory[law.NEARER :][: 3 * TERMS].reshape(3, TERMS).T
    assert found == pytest.approx(theta, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("frequency", [2.5, 20.0, 60.0])
def test_a_vibration_is_predicted_once_it_has_been_seen(frequency):
    """The command is the speed that a sine will have when the drive has answered: after half a second, within 2 %."""
    time = np.arange(700) * PERIOD
    sheet = 0.05 * np.sin(2 * np.pi * frequency * time)
    p = law.Params(kp=1e-9, lead=0.0, sharpen=0.0, lag=4.0, reach=5.0)
    _, _, commands = driven(p, readings(sheet))
    ahead = (law.NEAR + law.FAR) / 2 * PERIOD
    # The slope between the nearest and the farthest prediction is that of the chord.
    half = (law.FAR - law.NEAR) / 2 * PERIOD
    phase = 2 * np.pi * frequency
    chord = 0.05 * (np.sin(phase * (time + ahead + half)) - np.sin(phase * (time + ahead - half))) / (2 * half)
    last = slice(500, None)
    assert np.abs(commands[last] - chord[last]).max() < 0.02 * np.abs(chord).max()


@pytest.mark.parametrize(("reach", "exceeds"), [(1.0, False), (2.0, True)])
def test_nothing_is_fed_forward_faster_than_the_sheet_has_moved(reach, exceeds):
    """A vibration that grows will be faster than it has ever been; that is believed up to ``reach``."""
    time = np.arange(400) * PERIOD
    sheet = 1e-3 * np.exp(time / 0.08) * np.sin(2 * np.pi * 30 * time)
    _, _, commands = driven(law.Params(kp=1e-9, feed=1.0, reach=reach), readings(sheet))
    seen = np.maximum.accumulate(np.abs(sheet[4:] - sheet[:-4]) / 4 / PERIOD)
    assert bool((np.abs(commands[4:]) > seen * (1 + 1e-9)).any()) == exceeds


def test_what_does_not_come_true_is_not_fed_forward():
    """Steps at random cannot be predicted; what the estimator makes of them is kept from the head."""
    rng = np.random.default_rng(5)
    sheet = np.repeat(np.cumsum(rng.normal(size=20) * 0.1), 20)
    _, _, commands = driven(law.Params(kp=1e-9), readings(sheet))
    fastest = np.abs(sheet[4:] - sheet[:-4]).max() / 4 / PERIOD
    assert np.abs(commands).max() < 0.3 * fastest


@pytest.mark.parametrize("late", [2, 5, 7])
def test_the_drives_lag_is_found_from_command_and_velocity(late):
    """A head that does what it is told ``late`` periods later: what the law takes for its lag shifts by as much."""
    time = np.arange(500) * PERIOD
    told = 10.0 * np.sin(2 * np.pi * 6.0 * time)
    done = np.concatenate([np.zeros(late), told[:-late]])
    # The signal ``command`` is the last one sent: at period t it was sent at t − 1.
    sent = np.concatenate([[0.0], told[:-1]])
    p = law.Params(memory=1e12, trust=1.0)
    _, state, _ = driven(p, readings(np.zeros(500), sent, done))
    assert law.lag(p, state) == pytest.approx(late, abs=0.15)


def test_an_impulse_is_bridged_and_a_step_is_not():
    """One reading that is 0.1 mm off changes nothing; a sheet that stays lower is believed after ``hold`` periods."""
    p = law.Params(kp=50.0, jump=0.035, hold=4)
    level = np.zeros(400)
    impulse, step = level.copy(), level.copy()
    impulse[300], step[300:] = 0.1, -0.1
    _, _, commands = driven(p, readings(impulse))
    assert np.abs(commands[290:]).max() < 1e-9
    _, _, commands = driven(p, readings(step))
    assert np.abs(commands[300:304]).max() < 1e-9
    assert commands[304] < -0.9 * 50.0 * 0.1


def test_on_a_slope_an_impulse_is_what_lies_off_the_trend_before_predictions_have_proved_themselves():
    """A sheet that falls by 50 mm/s: 0.1 mm the other way is bridged along the slope, the slope itself is believed."""
    sheet = -0.05 * np.arange(81)
    spoilt = sheet + 0.1 * (np.arange(81) == 60)
    p, memory, state, believed = law.Params(jump=0.035), np.zeros(law.MEMORY), law.init(law.Params()), []
    for x in readings(spoilt):
        state, _ = law.control(p, state, x, np.zeros(0), memory)
        believed.append(memory[law.READINGS + law._slot(state.tick, 0.0)])
    assert state.calm < law.PROVED
    assert believed[20:] == pytest.approx(sheet[20:], abs=1e-9)


def test_over_a_hole_nothing_is_learnt_and_nothing_fed_forward():
    time = np.arange(300) * PERIOD
    signals = readings(0.1 * np.sin(2 * np.pi * 5 * time))
    p = law.Params(kp=1e-9)
    before, state, _ = driven(p, signals)
    memory = before.copy()
    for _ in range(50):
        hole = signals[-1]._replace(height=10.0, raw_height=10.0, mode=supervisor.HOLD)
        state, command = law.control(p, state, hole, np.zeros(0), memory)
        assert abs(command) < 1e-6
    assert memory[law.NEARER :] == pytest.approx(before[law.NEARER :], rel=0, abs=0)


def test_a_vibrating_sheet_is_followed_closer_than_it_moves():
    """No fixed loop behind this drive does: of a tone of 12 to 30 Hz the tuned PID's error exceeds the vibration."""
    case = scenarios.suite("following-v1")["flutter"]
    seeds = range(200, 216)
    own, pid = (rollout.roll(case, stacks.resolve(name), seeds) for name in ("self-tuning", "pid"))
    square = [np.sqrt(np.mean(np.square(r.error[1000:]))) for r in (own, pid)]
    assert square[0] < 0.4 * square[1]
    assert not own.collided.any()


def test_factors_stay_the_covariance_of_least_squares():
    """After 20 000 weighted readings U·D·Uᵀ is the inverse of the information matrix, which numpy sums up by itself."""
    rng, memory, grow = np.random.default_rng(0), np.zeros(law.MEMORY), 2.0 ** (1.0 / 100.0)
    p = law.Params(memory=100.0)
    law._forget(p, memory)
    information = np.eye(TERMS) / p.prior**2
    for _ in range(20_000):
        row = rng.normal(size=TERMS)
        memory[law.SEEN : law.SEEN + TERMS] = row
        law._weigh(memory, law.SEEN, 0.5 / grow, grow, np.inf)
        information = information / grow + np.outer(row, row) / 0.5
    factors = memory[law.SPREAD : law.SPREAD + TERMS**2].reshape(TERMS, TERMS)
    upper, diagonal = np.triu(factors, 1) + np.eye(TERMS), np.diag(factors)
    assert (diagonal > 0).all()
    assert upper @ np.diag(diagonal) @ upper.T == pytest.approx(np.linalg.inv(information), rel=1e-6, abs=1e-9)


def test_bridges_do_not_hold_each_other_up():
    """Every second reading jumps: one in four of them at least is taken as it is, as predictions reach back so far."""
    time = np.arange(2000) * PERIOD
    sheet = 0.02 * np.sin(2 * np.pi * 4 * time) + 1e-4 * np.random.default_rng(0).normal(size=2000)
    sheet[1500::2] += 0.02
    p, memory, state, taken = law.Params(), np.zeros(law.MEMORY), law.init(law.Params()), []
    for k, x in enumerate(readings(sheet)):
        state, _ = law.control(p, state, x, np.zeros(0), memory)
        believed = memory[law.READINGS + law._slot(state.tick, 0.0)]
        taken.append(believed == pytest.approx(sheet[k], abs=1e-9))
    assert not taken[1500]  # once they were bridged
    assert np.mean(taken[1500::2]) >= 0.25


@pytest.mark.parametrize("name", ["wavy", "rough"])
def test_it_stays_close_for_minutes(name):
    """What a plain covariance loses to rounding grows with the forgetting; it fell apart within 45 to 68 s."""
    case = scenarios.suite("following")[name].varied(duration=100.0)
    recording = rollout.roll(case, stacks.resolve("self-tuning"), range(4))
    error = np.abs(recording.error)
    assert error[10_000:].max() < 1.5 * error[300:10_000].max()
    assert not recording.collided.any()


RISE = 0.01
"""mm per period, of a sheet that rises evenly after a while of waves."""


def followed(spoilt):
    """Signals of a head that keeps 1 mm from a sheet, waves for a second and then an even rise, and what is added to
    the sheet's readings from then on."""
    waves = 0.1 * np.sin(2 * np.pi * 20.0 * np.arange(1000) * PERIOD)
    sheet = np.concatenate(
        [waves, waves[-1] + RISE * np.arange(1, 301), waves[-1] + RISE * (301 + np.arange(len(spoilt)))]
    )
    heights = 1.0 - np.concatenate([np.zeros(1300), spoilt])
    return [
        x._replace(height=h, raw_height=h, head_position=1.0 + z)
        for x, h, z in zip(readings(sheet), heights, sheet, strict=True)
    ]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_two_impulses_of_opposite_signs_leave_the_rise_as_it_is(sign):
    """The second lies where the sheet was before the first: that alone makes it no reading of the sheet."""
    spoilt = np.zeros(60)
    spoilt[10:14] = sign * np.array([0.08, 0.08, -0.03, -0.04])
    _, _, command = driven(law.Params(), followed(spoilt))
    assert command[1314:] == pytest.approx(RISE / PERIOD, rel=0.15)


def test_a_jump_that_outlasts_leaves_the_trend():
    """What is fed forward until all readings lie behind the jump is the rise; a prediction would mix both sides."""
    p, spoilt = law.Params(), np.zeros(60)
    spoilt[10:] = 0.1
    _, _, command = driven(p, followed(spoilt))
    first = 1310 + int(p.hold)
    assert command[first : first + law.FAR + 2] == pytest.approx(RISE / PERIOD + p.kp * 0.1, rel=0.2)


def test_after_a_hold_it_begins_with_the_first_reading():
    """What was read before the hold tells nothing: a saturated count would be bridged to for some periods."""
    p, spoilt = law.Params(), np.zeros(60)
    spoilt[10:20] = -9.0
    signals = followed(spoilt)
    for k in range(1316, 1321):
        signals[k] = signals[k]._replace(mode=supervisor.HOLD, override=True)
    _, _, command = driven(p, signals)
    assert np.abs(command[1321:1330]).max() < 3.0 * RISE / PERIOD
