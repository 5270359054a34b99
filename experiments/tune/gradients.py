"""``kerfgym tune --gradient``: TPE looks around, then a minimiser goes down along exact slopes (:mod:`measure.slopes`).

The minimiser is sequential quadratic programming (Kraft 1988) of scipy: at each candidate it is told the logarithms of
score and Ms and their slopes, and looks for the lowest score below the cap. It starts from the best candidate of the
exploration, and when it has come to an end, from the next best, until trials or budget are spent. A study that goes on
after an interruption goes through the minimiser once more with what is known, which takes milliseconds.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from optuna.trial import FrozenTrial
from scipy import optimize

from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.engine.quantity import InvalidInput
from .sampling import Seeded, distribution
from .space import Axis, Space

SAMPLER = "tpe+slsqp"
"""The sampler's name in studies and records."""

METRIC = "rms_true"
"""What has slopes."""

SLOPES = "slopes"
"""Attribute of a trial: slopes of the logarithms of ``score`` and, where it is measured, ``ms``, one number for each
axis that has some, per unit of the parameter."""

FIRST = 0.1
"""Length of the first step, in ranges."""

AIM = 0.98
"""Share of the cap on Ms that is aimed at: between the few frequencies of a search |S| may be higher."""

END = 1e-4
"""Change of the score's logarithm at which a descent ends."""

LONGEST = 25
"""Steps of a descent at most."""

LOST = 10.0
"""Logarithm of a score that could not be measured, above the best of those that could."""


def axes(space: Space) -> tuple[Axis, ...]:
    """What the minimiser moves. Whole numbers stay as the exploration found them."""
    return tuple(axis for axis in space.axes if not (axis.whole or axis.choices))


def check(task: Any, workers: int) -> None:
    """Whether this study has slopes.

    Raises:
        InvalidInput: it has none, and why.
    """
    if task.jobs or task.base.slots != "z":
        raise InvalidInput(f"--gradient is for controllers of the slot z alone, not for suite '{task.suite}'")
    if task.metrics != (METRIC,):
        raise InvalidInput(f"--gradient makes {METRIC} least; {', '.join(task.metrics)} has no slope here")
    if task.limits.limits or task.relative:
        what = task.limits.limits[0].name if task.limits.limits else f"a ratio to {task.relative}"
        raise InvalidInput(f"--gradient keeps the cap on Ms and no other limit; {what} has no slope here")
    if workers > 1:
        raise InvalidInput(f"--gradient goes on trial by trial, in one process; --workers {workers} is out of range")
    if why := refusal(task.base.z, task.space):
        raise InvalidInput(f"--gradient: {why}; laws with slopes: {', '.join(known())}")


def refusal(stack: Stack, space: Space) -> str:
    """Why a space of a stack cannot be searched along slopes; empty if it can."""
    from ..measure import slopes

    if why := slopes.refusal(stack, tuple(axis.name for axis in axes(space))):
        return why
    for axis in space.axes:
        if axis.name == "filter.kind":
            return "filter.kind would try filters that rank their samples, which have no slope"
        if axis.name == "filter.trim" and axis.high > 1.0:
            return "filter.trim above 1 ranks the samples, which has no slope; filter.trim=0..1 has"
    if not axes(space):
        return f"{', '.join(axis.name for axis in space.axes)}: whole numbers and choices have no slope"
    return ""


def known() -> list[str]:
    """Registered controllers whose laws have slopes."""
    from ..measure import slopes

    found = [name for name in stacks.names() if len(stacks.asked(name).stacks) == 1]
    each = {name: stacks.asked(name).stacks[0] for name in found}
    return [name for name, stack in each.items() if stack.part("law") and not slopes.refusal(stack, ())]


class Descents(Seeded):
    """The sampler: trials of TPE, then descents.

    Args:
        space: what is searched.
        seed: of TPE.
        explore: trials before the first descent.
        cost: of a finished trial; the exploration's least are where descents start.
        cap: on Ms.
    """

    def __init__(self, space: Space, seed: int, explore: int, cost: Any, cap: float) -> None:
        super().__init__("tpe", space, seed, explore, cost)
        self.axes, self.cap = axes(space), cap

    def infer_relative_search_space(self, study: Any, trial: FrozenTrial) -> dict[str, Any]:
        """All that is searched, in a descent."""
        if trial.number >= self.explore:
            return {axis.name: distribution(axis) for axis in self.space.axes}
        return super().infer_relative_search_space(study, trial)

    def sample_relative(self, study: Any, trial: FrozenTrial, search_space: dict[str, Any]) -> dict[str, Any]:
        """Parameters of the trial."""
        if trial.number < self.explore:
            return super().sample_relative(study, trial, search_space)
        over = [t for t in study.get_trials(deepcopy=False) if t.number < trial.number and t.state.is_finished()]
        before = sorted((t for t in over if t.number < self.explore and t.params), key=self.cost)
        told = iter([t for t in over if t.number >= self.explore])
        for start in itertools.chain(before, itertools.repeat(before[0])):
            fixed = {axis.name: start.params[axis.name] for axis in self.space.axes if axis not in self.axes}
            first = [axis.encode(start.params[axis.name]) for axis in self.axes]
            asked = _descend(np.clip(first, 0.0, 1.0), self.axes, self.cap, map(self._measured, told))
            if asked is not None:
                return fixed | {a.name: a.decode(x) for a, x in zip(self.axes, asked, strict=True)}
        raise AssertionError

    def _measured(self, trial: FrozenTrial) -> tuple[float, float, np.ndarray, np.ndarray]:
        """What a trial found: logarithms of score and Ms, and their slopes; NaN what it did not find."""
        slopes, none = trial.user_attrs.get(SLOPES, {}), [math.nan] * len(self.axes)
        score = math.log(trial.value) if slopes and trial.value else math.nan
        ms = math.log(trial.user_attrs["ms"]) if slopes and "ms" in slopes else -math.inf
        return score, ms, np.array(slopes.get("score", none)), np.array(slopes.get("ms", none))


class _Asked(Exception):
    """The point whose score a minimiser asks for."""


def _descend(
    first: np.ndarray, moved: tuple[Axis, ...], cap: float, told: Iterator[tuple[float, float, np.ndarray, np.ndarray]]
) -> np.ndarray | None:
    """The next point of a descent, 0 to 1 on each axis, after what has been told of its points; None at its end."""
    known: dict[bytes, tuple[float, float, np.ndarray, np.ndarray]] = {}
    best, scale = math.inf, 1.0

    def at(x: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
        nonlocal best, scale
        x = np.clip(x, 0.0, 1.0)
        if x.tobytes() not in known:
            found = next(told, None)
            if found is None:
                raise _Asked(x)
            score, ms, by_score, by_ms = found
            if not all(np.isfinite([score, *by_score])):
                score, by_score = (best if math.isfinite(best) else 0.0) + LOST, np.zeros(len(x))
            if not all(np.isfinite([ms, *by_ms])):
                ms, by_ms = -1e3, np.zeros(len(x))
            per = np.array([_per_unit(axis, u) for axis, u in zip(moved, x, strict=True)])
            if not known:  # the first step has a length of its own, whatever the slope is
                scale = FIRST / max(float(np.linalg.norm(per * by_score)), 1e-9)
            best = min(best, score)
            known[x.tobytes()] = score, ms, per * by_score, per * by_ms
        return known[x.tobytes()]

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        score, _, slopes, _ = at(x)
        return scale * score, scale * slopes

    def room(x: np.ndarray) -> float:
        return math.log(AIM * cap) - at(x)[1]

    limits = [{"type": "ineq", "fun": room, "jac": lambda x: -at(x)[3]}] if math.isfinite(cap) else []
    ends = {"maxiter": LONGEST, "ftol": END * FIRST}
    try:
        optimize.minimize(
            value, first, method="SLSQP", jac=True, bounds=[(0.0, 1.0)] * len(first), constraints=limits, options=ends
        )
    except _Asked as asked:
        return np.asarray(asked.args[0])
    return None


def _per_unit(axis: Axis, u: float) -> float:
    """How a parameter changes with its place on the axis."""
    return axis.decode(u) * math.log(axis.high / axis.low) if axis.log else axis.high - axis.low
