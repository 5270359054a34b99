"""LQG: model, gains and estimate, each against scipy; and the machine it regulates."""

import numpy as np
import pytest
from scipy import linalg, signal

from kerfgym.baselines import lqg, servo
from kerfgym.envs.plant import supervisor
from kerfgym.envs.plant.controller import PERIOD, Sensed

T = PERIOD
ODD = lqg.Params(bandwidth=47.0, zeta=1.3, dead_time=2.6, effort=3.0, damping=4.0, wander=0.5, bend=60.0, memory=7.0)
FEW = lqg.Params(bandwidth=130.0, zeta=0.5, dead_time=0.3, shift=1e-3, drift=3000.0)


def drive_matrices(p):
    """ẋ = F·x + G·u of position, speed and acceleration."""
    w = 2 * np.pi * p.bandwidth
    return np.array([[0, 1, 0], [0, 0, 1], [0, -w * w, -2 * p.zeta * w]]), np.array([[0.0], [0.0], [w * w]])


def held(p, time):
    """x⁺ = A·x + B·u after ``time`` of a constant u, by scipy."""
    f, g = drive_matrices(p)
    both = linalg.expm(np.block([[f, g], [np.zeros((1, 4))]]) * time)
    return both[:3, :3], both[:3, 3]


def model(p):
    """A, b of position, speed, acceleration and the last three commands, dead time included, by scipy."""
    whole = int(p.dead_time)
    late = (p.dead_time - whole) * T
    (a1, b1), (a2, b2) = held(p, late), held(p, T - late)
    a, b = np.zeros((6, 6)), np.zeros(6)
    a[:3, :3] = a2 @ a1
    inputs = np.zeros((3, 4))  # of the command of now, and of 1, 2, 3 periods ago
    inputs[:, whole] += b2
    inputs[:, whole + 1] += a2 @ b1
    a[:3, 3:], b[:3] = inputs[:, 1:], inputs[:, 0]
    b[3] = a[4, 3] = a[5, 4] = 1.0
    return a, b


def sheet_matrix(p):
    tau = p.memory * 1e-3
    return linalg.expm(np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1 / tau]]) * T)


def prepared(p):
    memory = np.zeros(lqg.MEMORY)
    lqg.prepare(p, memory)
    return memory


@pytest.mark.parametrize("p", [lqg.Params(), ODD, FEW])
def test_the_models_period_is_the_matrix_exponential(p):
    a, b = model(p)
    memory = prepared(p)
    step = memory[lqg.STEP :][:18].reshape(3, 6)
    assert step == pytest.approx(np.column_stack([a[:3, 1:], b[:3]]), rel=1e-9, abs=1e-12)
    course = servo.sheet(p.memory * 1e-3)
    f = sheet_matrix(p)
    assert tuple(course) == pytest.approx((f[0, 2], f[1, 2], f[2, 2]), rel=1e-6)


@pytest.mark.parametrize("p", [lqg.Params(), ODD, FEW])
def test_seen_from_the_sheet_the_model_is_drive_less_sheet(p):
    """The relative model against absolute drive and sheet, both stepped by scipy's matrices."""
    rng = np.random.default_rng(3)
    a, b = model(p)
    f = sheet_matrix(p)
    head, sheet = rng.normal(size=6), rng.normal(size=3)

    def relative(head, sheet):
        z, v, acceleration, *sent = head
        return [z - sheet[0], v - sheet[1], acceleration, *(u - sheet[1] for u in sent), sheet[2]]

    x = np.array(relative(head, sheet))
    memory = prepared(p)
    onward = memory[lqg.A :][:49].reshape(7, 7) @ x + memory[lqg.B :][:7] * 0.7
    after = relative(a @ head + b * (head[3] + 0.7), f @ sheet)
    assert onward == pytest.approx(after, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("p", [lqg.Params(), ODD, FEW])
def test_the_gains_solve_the_riccati_equations(p):
    memory = prepared(p)
    a, b = memory[lqg.A :][:49].reshape(7, 7), memory[lqg.B :][:7][:, None]
    q, r = np.diag([1.0, (1e-3 * p.damping) ** 2, 0, 0, 0, 0, 0]), np.array([[(1e-3 * p.effort) ** 2]])
    cost = linalg.solve_discrete_are(a, b, q, r)
    gain = np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a)[0]
    assert memory[lqg.K :][:7] == pytest.approx(gain, rel=1e-6, abs=1e-9 * abs(gain).max())
    assert memory[lqg.P :][:49].reshape(7, 7) == pytest.approx(cost, rel=1e-6, abs=1e-8 * abs(cost).max())

    c = np.array([[1.0], [0.0], [0.0]])
    for at, f, noise, reading in (
        (lqg.DRIVE, held(p, T)[0], [0.0, 0.0, p.drift], p.encoder),
        (lqg.SHEET, sheet_matrix(p), [p.shift, p.wander, p.bend], p.reading),
    ):
        variance = linalg.solve_discrete_are(f.T, c, np.diag(np.square(noise)), np.array([[reading**2]]))
        kalman = variance[:, 0] / (variance[0, 0] + reading**2)
        assert memory[at : at + 3] == pytest.approx(kalman, rel=1e-6)


def test_gains_are_made_once_for_the_same_parameters():
    memory = np.zeros(lqg.MEMORY)
    x = Sensed(height=0.8, set_height=0.8, head_position=2.0, fresh=True, captured=True, mode=supervisor.FOLLOW)
    lqg.control(lqg.Params(), lqg.init(lqg.Params()), x, (), memory)
    memory[lqg.K] = 0.0  # would be made good if they were made anew
    lqg.control(lqg.Params(), lqg.init(lqg.Params()), x, (), memory)
    assert memory[lqg.K] == 0.0
    for field in set(lqg.Params._fields) - {"gate"}:  # which is no part of any gain
        lqg.control(lqg.Params(), lqg.init(lqg.Params()), x, (), memory)
        memory[lqg.K] = 0.0
        p = lqg.Params()._replace(**{field: getattr(lqg.Params(), field) * 1.1})
        lqg.control(p, lqg.init(p), x, (), memory)
        assert memory[lqg.K] != 0.0, field


def loop(p, surface, plant=None, override=None):
    """The law against its own model (or ``plant``), noiseless, on a given sheet.

    Returns errors, states of the law, and the head's position, speed and acceleration.
    """
    a, b = model(plant or p)
    memory, state = np.zeros(lqg.MEMORY), lqg.init(p)
    head, errors, states, motion = np.zeros(6), [], [], []
    for i, level in enumerate(surface):
        x = Sensed(
            height=head[0] + 0.8 - level,
            head_position=head[0] + 0.8,
            set_height=0.8,
            command=head[3],
            fresh=i == 0,
            captured=True,
            mode=supervisor.FOLLOW,
        )
        state, wish = lqg.control(p, state, x, (), memory)
        states.append(state)
        errors.append(x.height - x.set_height)
        motion.append((head[0] + 0.8, head[1], head[2]))
        command = wish if override is None or not override[i] else 1.5
        head = a @ head + b * command
    return np.array(errors), np.array(states), np.array(motion)


OPEN = {"gate": 5.0}


@pytest.mark.parametrize("p", [lqg.Params(**OPEN), ODD._replace(**OPEN)])
def test_on_its_own_model_the_drive_is_estimated_exactly_and_a_ramp_leaves_no_error(p):
    surface = 3.0 * T * np.arange(1500)
    errors, states, motion = loop(p, surface)
    assert np.abs(motion[:, 1]).max() > 3.0
    assert states[:, :3] == pytest.approx(motion, abs=1e-8)
    assert states[-1, 4] == pytest.approx(3.0, abs=1e-6)  # the sheet's
    assert abs(errors).max() > 1e-3
    assert abs(errors[-1]) < 1e-7


def test_a_wrong_model_leaves_no_error_on_a_ramp_either():
    errors, _, _ = loop(lqg.Params(**OPEN), 3.0 * T * np.arange(3000), plant=lqg.Params(bandwidth=60.0, zeta=1.0))
    assert abs(errors[-1]) < 1e-6


def test_nothing_winds_up_while_the_supervisor_overrides_the_law():
    """The supervisor sends 1.5 mm/s for a while; the estimate of the drive knows."""
    override = (np.arange(600) >= 300) & (np.arange(600) < 340)
    errors, states, _ = loop(lqg.Params(**OPEN), np.zeros(600), override=override)
    assert states[:300, 1] == pytest.approx(0.0, abs=1e-9)
    assert states[339, 1] == pytest.approx(1.5, abs=0.02)
    assert errors.max() == pytest.approx(0.06, abs=0.01)  # 40 ms at 1.5 mm/s
    assert errors.min() > -0.1 * errors.max()
    assert abs(errors[-1]) < 1e-6


def test_the_estimate_of_the_sheet_is_scipys_kalman_filter():
    p = lqg.Params(**OPEN)
    rng = np.random.default_rng(4)
    read = np.concatenate([[0.0], 0.01 * rng.normal(size=300)])
    memory, state, seen = np.zeros(lqg.MEMORY), lqg.init(p), []
    for i, z in enumerate(read):
        x = Sensed(height=-z, head_position=0.0, fresh=i == 0, captured=i > 0, mode=supervisor.FOLLOW)
        state, _ = lqg.control(p, state, x, (), memory)
        seen.append(state[3:6])
    f, gain = sheet_matrix(p), memory[lqg.SHEET : lqg.SHEET + 3][:, None]
    c = np.array([[1.0, 0.0, 0.0]])
    a = f - gain @ c @ f
    _, y, _ = signal.dlsim((a, a @ gain, np.eye(3), gain, T), read)
    assert np.array(seen)[1:] == pytest.approx(y[1:], rel=1e-6, abs=1e-7)


def test_an_impulse_moves_the_estimate_no_more_than_the_gate_does():
    p = lqg.Params(gate=0.05)
    tracks = []
    for size in (0.05, 3.0):
        memory, state = np.zeros(lqg.MEMORY), lqg.init(p)
        for i in range(60):
            level = size if i == 30 else 0.0
            x = Sensed(height=-level, head_position=0.0, fresh=i == 0, captured=True, mode=supervisor.FOLLOW)
            state, _ = lqg.control(p, state, x, (), memory)
            tracks.append(state.level)
    assert tracks[:60] == pytest.approx(tracks[60:])
    assert max(map(abs, tracks)) < 0.05


def test_the_sheet_stands_still_over_a_hole_and_is_taken_as_read_during_an_approach():
    p, memory = lqg.Params(), prepared(lqg.Params())
    state = lqg.State(1.0, 0.0, 0.0, 0.3, 5.0, 100.0)
    x = Sensed(height=2.0, head_position=1.0, set_height=0.8, fresh=False, captured=True, mode=supervisor.HOLD)
    held_, _ = lqg.control(p, state, x, (), memory)
    assert held_[3:6] == (0.3, 0.0, 0.0)
    far, _ = lqg.control(p, state, x._replace(mode=supervisor.FOLLOW, captured=False), (), memory)
    assert far[3:6] == (-1.0, 0.0, 0.0)
