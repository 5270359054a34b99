"""MPC: the LQG's estimator and cost, under bounds on the command and on its change.

Each period it plans the next HORIZON changes of command: the LQG's cost over them, and behind them the cost-to-go of
the unbounded regulator (Mayne et al. 2000), subject to

    |change| ≤ acceleration·T,   |command| ≤ fastest

of which the first change is carried out. Where no bound is met the plan is the LQG's and so is the command; else a
quadratic program is solved to the optimum (:mod:`active_set`). During an approach, which the supervisor plans, the
LQG's command is clipped instead.
"""

from typing import Annotated, Any, NamedTuple

from kerfgym.baselines import active_set, lqg
from kerfgym.envs.engine.lanes import clip, extended, part, stage
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD

HORIZON = 20
"""Changes of command that are planned: 20 ms, beyond which the drive has settled."""

N, N2, S = HORIZON, HORIZON * HORIZON, lqg.STATES
PLAN = lqg.MEMORY  # the plan without bounds, by coordinate of the state
J = PLAN + N * S
X = J + N2
LARGEST, WAY = X + N, X + N + S  # most that a unit of each coordinate changes the command by: at once, and in all
ROOM = X + N + 2 * S
MEMORY = ROOM + active_set.room(N)


class Bounds(NamedTuple):
    """The LQG's, and the bounds."""

    acceleration: Annotated[float, Quantity("mm/s²", 100.0, 1e5, "largest change of command", log=True)] = 1e4
    fastest: Annotated[float, Quantity("mm/s", 1.0, 1000.0, "largest command", "Xi2023", log=True)] = 500.0


Params: Any = extended("Params", lqg.Params, Bounds)
State = lqg.State
init = lqg.init


@stage
def prepare(m, effort, damping):
    """Hessian, factored, and the unbounded plan, from the LQG's model and gains; weights in s."""
    # Response of the states to a change now, i + 1 periods on, and P times it.
    far, weighed = ROOM, ROOM + N * S
    for c in range(S):
        m[far + c] = m[lqg.B + c]
    for i in range(N):
        for c in range(S):
            onward, cost = 0.0, 0.0
            for k in range(S):
                cost += m[lqg.P + c * S + k] * m[far + i * S + k]
                onward += m[lqg.A + c * S + k] * m[far + i * S + k]
            m[weighed + i * S + c] = cost
            if i + 1 < N:
                m[far + (i + 1) * S + c] = onward
    h = ROOM + 2 * N * S  # the Hessian: row j, column k
    for j in range(N):
        for k in range(N):
            total = effort * effort if j == k else 0.0
            late = max(j, k)
            for i in range(late + 1, N):
                one, two = far + (i - j - 1) * S, far + (i - k - 1) * S
                total += m[one] * m[two] + damping * damping * m[one + 1] * m[two + 1]
            for c in range(S):
                total += m[far + (N - j - 1) * S + c] * m[weighed + (N - k - 1) * S + c]
            m[h + j * N + k] = total
    active_set.factor(m, N, h, J)
    # The change i periods on is −k·(A − b·k)^i times the state of now.
    for c in range(S):
        m[PLAN + c * N] = -m[lqg.K + c]
    for i in range(1, N):
        along = 0.0
        for k in range(S):
            along += m[PLAN + k * N + i - 1] * m[lqg.B + k]
        for c in range(S):
            total = -along * m[lqg.K + c]
            for k in range(S):
                total += m[PLAN + k * N + i - 1] * m[lqg.A + k * S + c]
            m[PLAN + c * N + i] = total
    for c in range(S):
        largest, way = 0.0, 0.0
        for i in range(N):
            largest, way = max(largest, abs(m[PLAN + c * N + i])), way + abs(m[PLAN + c * N + i])
        m[LARGEST + c], m[WAY + c] = largest, way


@part
def most_of(m, at, r):
    """What a sum over the relative state ``r`` with coefficients from ``at`` on cannot exceed."""
    one = m[at] * abs(r.error) + m[at + 1] * abs(r.speed) + m[at + 2] * abs(r.acceleration)
    two = m[at + 3] * abs(r.sent_1) + m[at + 4] * abs(r.sent_2) + m[at + 5] * abs(r.sent_3)
    return one + two + m[at + 6] * abs(r.bend)


@stage
def plan(m, r):
    """The unbounded plan for the relative state ``r`` into X."""
    for i in range(N):
        one = m[PLAN + i] * r.error + m[PLAN + N + i] * r.speed + m[PLAN + 2 * N + i] * r.acceleration
        two = m[PLAN + 3 * N + i] * r.sent_1 + m[PLAN + 4 * N + i] * r.sent_2 + m[PLAN + 5 * N + i] * r.sent_3
        m[X + i] = one + two + m[PLAN + 6 * N + i] * r.bend


@part
def control(params, state, signals, tables, memory):
    """Head velocity, mm/s."""
    p, m = params, memory
    if signals.fresh and not lqg.is_made(p, m):
        lqg.prepare(p, m)
        prepare(m, 1e-3 * p.effort, 1e-3 * p.damping)
    after = lqg.estimate(p, state, signals, m)
    most, start = params.acceleration * PERIOD, after.sent_1
    r = lqg.relative(after, signals)
    first = lqg.change(m, r)
    # Mostly it takes no plan to see that no plan meets a bound.
    bounded = most_of(m, LARGEST, r) > most or abs(start) + most_of(m, WAY, r) > params.fastest
    if bounded and signals.captured and not signals.override:
        plan(m, r)
        active_set.solve(m, N, J, X, ROOM, most, start, params.fastest)
        first = m[X]
    limit = active_set.bound(0.0, most, start, params.fastest)
    return after, clip(start + clip(first, -most, most), -limit, limit)
