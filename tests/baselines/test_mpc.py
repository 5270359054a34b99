"""MPC: its quadratic program against scipy, and what bounds do in the loop."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from kerfgym.baselines import active_set, lqg, mpc, servo
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.plant import machine, supervisor
from kerfgym.envs.plant.controller import PERIOD, Sensed
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure.rollout import fleet_for


def solved(h, x0, most, start, fastest):
    n = len(x0)
    m = np.zeros(2 * n * n + n + active_set.room(n))
    m[: n * n] = h.ravel()
    jay, x, work = n * n, 2 * n * n, 2 * n * n + n
    active_set.factor(m, n, 0, jay)
    m[x : x + n] = x0
    steps = active_set.solve(m, n, jay, x, work, most, start, fastest)
    return m[x : x + n].copy(), steps


def problems(count, seed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        n = int(rng.integers(1, mpc.HORIZON + 1))
        root = rng.normal(size=(n + 2, n)) * np.exp(rng.normal(size=n))
        yield root, 3.0 * rng.normal(size=n), 2.0 * rng.normal(), float(rng.choice([0.5, 2.0, 1e3]))


def test_with_bounds_on_the_changes_alone_the_optimum_is_scipys():
    met = 0
    for root, x0, start, _ in problems(60, 1):
        h = root.T @ root
        found, _ = solved(h, x0, 1.0, start, 1e6)
        oracle = lsq_linear(root, root @ x0, (-1.0, 1.0), method="bvls", tol=1e-14).x
        assert found == pytest.approx(oracle, abs=1e-7)
        met += np.isclose(np.abs(found), 1.0).sum()
    assert met > 200


def test_the_optimum_meets_the_conditions_of_karush_kuhn_and_tucker_and_no_bound_is_broken():
    sums = 0
    for root, x0, start, fastest in problems(200, 2):
        n = len(x0)
        h = root.T @ root + 1e-3 * np.eye(n)
        found, steps = solved(h, x0, 1.0, start, fastest)
        total = start + np.cumsum(found)
        reach = np.maximum(fastest, abs(start) - np.arange(1, n + 1))
        assert (np.abs(found) <= 1.0 + 1e-12).all()
        assert (np.abs(total) <= reach + 1e-12).all()
        assert steps < 6 * n
        # The gradient must be a sum of the active bounds' normals with multipliers that push inwards.
        unit, step = np.eye(n), np.tril(np.ones((n, n)))
        normals = [-s * unit[i] for s in (1, -1) for i in range(n) if s * found[i] > 1.0 - 1e-9]
        normals += [-s * step[i] for s in (1, -1) for i in range(n) if s * total[i] > reach[i] - 1e-9]
        gradient = h @ (found - x0)
        left = nnls(np.array(normals).T, gradient)[1] if normals else np.linalg.norm(gradient)
        assert left < 1e-9 * (1.0 + np.linalg.norm(h @ x0))
        sums += (np.abs(total) > reach - 1e-9).sum()
    assert sums > 100


def test_from_beyond_the_bound_of_the_command_it_comes_back_as_fast_as_it_may():
    found, _ = solved(np.eye(6), np.zeros(6), 1.0, 5.5, 2.0)
    assert found == pytest.approx([-1.0, -1.0, -1.0, -0.5, 0.0, 0.0])


# ------------------------------------------------------------------------------------------------- the law


P = mpc.Params(effort=10.0, damping=2.0, drift=100.0, acceleration=1e4)


@pytest.mark.parametrize("p", [P, P._replace(dead_time=0.4, effort=2.0, damping=5.0)])
def test_the_plans_hessian_and_unbounded_optimum_are_those_of_a_dense_least_squares_problem(p):
    m = np.zeros(mpc.MEMORY)
    mpc.control(p, mpc.init(p), Sensed(height=0.8, head_position=2.0, set_height=0.8), (), m)
    a, b = m[lqg.A :][:49].reshape(7, 7), m[lqg.B :][:7]
    cost = m[lqg.P :][:49].reshape(7, 7)
    q = np.diag([1.0, (1e-3 * p.damping) ** 2, 0, 0, 0, 0, 0])
    n = mpc.HORIZON
    powers = [np.linalg.matrix_power(a, i) for i in range(n + 1)]
    free = np.vstack(powers[1:])  # stacked states of the coming periods, from the state of now
    forced = np.zeros((7 * n, n))
    for i in range(n):
        for j in range(i + 1):
            forced[7 * i : 7 * i + 7, j] = powers[i - j] @ b
    weight = np.kron(np.eye(n), q)
    weight[-7:, -7:] = cost
    h = forced.T @ weight @ forced + (1e-3 * p.effort) ** 2 * np.eye(n)
    jay = m[mpc.J :][: n * n].reshape(n, n)
    assert jay.T @ h @ jay == pytest.approx(np.eye(n), abs=1e-7)
    best = -np.linalg.solve(h, forced.T @ weight @ free)
    plan = m[mpc.PLAN :][: 7 * n].reshape(7, n).T
    assert plan == pytest.approx(best, rel=1e-5, abs=1e-5 * abs(best).max())


def test_no_sum_over_a_state_exceeds_what_says_whether_a_plan_is_needed():
    rng = np.random.default_rng(3)
    m, state = rng.uniform(0.1, 1.0, 9), servo.Relative(*rng.normal(size=7))
    most = mpc.most_of(m, 1, state)
    assert most == pytest.approx(m[1:8] @ np.abs(state))
    signs = np.sign(state)  # the worst that coefficients of this size can have
    assert most == pytest.approx((m[1:8] * signs) @ np.array(state))


def test_where_no_bound_is_met_it_is_the_lqg():
    fleets = []
    for spec in ("lqg", "mpc:law.acceleration=1e5,law.fastest=1000"):
        chosen = resolve("lqg")
        stack = resolve(spec).varied({name: p.value for name, p in chosen.parameters().items()})
        fleet = fleet_for(load("rough"), stack, [1001, 1002])
        record = fleet.start_recording(900)
        fleet.advance(900)
        fleets.append(record[:, machine.CHANNELS.index("gap")].copy())
    assert np.ptp(fleets[0]) > 0.01
    assert fleets[0] == pytest.approx(fleets[1], abs=1e-6)


def stepped(p, clipped, size=0.1, periods=200):
    """Head, mm, and commands, mm/s, while the sheet steps up by ``size``; the plant is the model.

    ``clipped``: the law believes itself overridden, and so clips the LQG's command instead of planning.
    """
    memory, state = np.zeros(mpc.MEMORY), mpc.init(p)
    motion, sent, heads = np.zeros(3), [0.0] * 4, []
    for i in range(periods):
        surface = size if i >= 5 else 0.0
        x = Sensed(
            height=motion[0] + 0.8 - surface,
            head_position=motion[0] + 0.8,
            set_height=0.8,
            command=sent[-1],
            fresh=i == 0,
            captured=True,
            override=clipped,
            mode=supervisor.FOLLOW,
        )
        state, wish = mpc.control(p, state, x, (), memory)
        step = memory[lqg.STEP :][:18].reshape(3, 6)
        motion = np.array([motion[0], 0.0, 0.0]) + step @ [*motion[1:], *sent[:-4:-1], wish]
        sent.append(wish)
        heads.append(motion[0])
    return np.array(heads), np.array(sent)


def test_a_plan_that_knows_its_bounds_overshoots_less_than_a_clipped_command():
    p = P._replace(acceleration=500.0, fastest=5.0, gate=5.0, shift=0.1, wander=1e-4, bend=1e-2, effort=3.0)
    over = {}
    for clipped in (False, True):
        heads, sent = stepped(p, clipped)
        assert np.abs(np.diff(sent)).max() == pytest.approx(p.acceleration * PERIOD)
        assert np.abs(sent).max() == pytest.approx(p.fastest)
        over[clipped] = heads.max() - 0.1
    assert 0.0 < over[False] < 0.3 * over[True]


def test_a_plan_that_will_meet_the_bound_of_the_command_alone_begins_gently():
    p = P._replace(acceleration=1e5, fastest=3.0, gate=5.0, shift=0.1, wander=1e-4, bend=1e-2, effort=50.0)
    (_, planned), (_, clipped) = (stepped(p, clipped, periods=20) for clipped in (False, True))
    for sent in (planned, clipped):
        assert np.abs(sent).max() == pytest.approx(p.fastest)
        assert np.abs(np.diff(sent)).max() < 0.1 * p.acceleration * PERIOD  # no change meets its bound
    # Changes cost more than time, and the last of those that the LQG plans would be cut off.
    begins = np.flatnonzero(clipped)[0]
    assert 0.0 < planned[begins] < 0.95 * clipped[begins]
