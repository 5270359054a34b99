"""``kerfgym tune --gradient``: TPE looks around, then a minimiser goes down along exact slopes (:mod:`measure.slopes`).

The minimiser is sequential quadratic programming in a trust region (Nocedal and Wright 2006, ch. 18): of each candidate
it knows the logarithms of score and Ms and their slopes, and looks for the lowest score below the cap. It starts from
the best candidate of the exploration, and when it has come to an end, from the next best whose loop settles; after the
last of them from what TPE proposes next, until trials or budget are spent. A study that goes on after an interruption
goes through the minimiser once more with what is known, which takes milliseconds.
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
from .goals import FAILED
from .sampling import Seeded, distribution
from .space import Axis, Space

SAMPLER = "tpe+gradient"
"""The sampler's name in studies and records."""

METRIC = "rms_true"
"""What has slopes."""

SLOPES = "slopes"
"""Attribute of a trial: slopes of the logarithm of ``score``, one number for each axis that has some, per unit of the
parameter; and where there is a cap, logarithms of the highest ``peaks`` of |S| and their slopes ``ms``, one behind the
other."""

FIRST = 0.1
"""Length of the first step, in ranges."""

AIM = 0.995
"""Share of the cap on Ms that is aimed at, so that what comes near keeps the cap."""

END = 1e-3
"""What the score's logarithm must still be expected to fall by; below, a descent ends."""

LONGEST = 25
"""Steps of a descent at most."""

ANY = 1e3
"""Logarithm of a cap on Ms that caps nothing."""

WEIGHT = 12.0
"""Weight of a broken cap, per unit of its logarithm."""


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
        settled = (t for t in over if t.number < self.explore and t.params and t.user_attrs.get("ms", 0.0) < FAILED)
        before = sorted(settled, key=self.cost)
        told = iter([t for t in over if t.number >= self.explore])
        for start in before:
            if asked := self._down(start, told):
                return asked
        for start in told:  # from here on a descent's first point is what TPE proposed, which has slopes, too
            if asked := self._down(start, itertools.chain([start], told)):
                return asked
        inner = self._sampler(trial)
        return inner.sample_relative(study, trial, inner.infer_relative_search_space(study, trial))

    def _down(self, start: FrozenTrial, told: Iterator[FrozenTrial]) -> dict[str, Any]:
        """The next candidate of the descent from a trial, after ``told``; nothing at its end."""
        fixed = {axis.name: start.params[axis.name] for axis in self.space.axes if axis not in self.axes}
        first = [axis.encode(start.params[axis.name]) for axis in self.axes]
        asked = _descend(np.clip(first, 0.0, 1.0), self.axes, self.cap, map(self._measured, told))
        return {} if asked is None else fixed | {a.name: a.decode(x) for a, x in zip(self.axes, asked, strict=True)}

    def _measured(self, trial: FrozenTrial) -> "Measured":
        """What a trial found: the score is NaN if it did not come to one."""
        slopes, none = trial.user_attrs.get(SLOPES, {}), [0.0] * len(self.axes)
        by_score, by_ms = (np.array(slopes.get(name, none)) for name in ("score", "ms"))
        peaks = np.array(slopes.get("peaks", [-ANY]))
        lost = not trial.value or trial.value >= FAILED or FAILED in [*by_score, *by_ms, *peaks]
        score = math.nan if lost or not trial.value else math.log(trial.value)
        return score, peaks, by_score, by_ms.reshape(len(peaks), -1)


Measured = tuple[float, np.ndarray, np.ndarray, np.ndarray]
"""Logarithms of score and of peaks of |S|, and their slopes, shapes (axes,) and (peaks, axes)."""


def _descend(first: np.ndarray, moved: tuple[Axis, ...], cap: float, told: Iterator[Measured]) -> np.ndarray | None:
    """The next point of a descent, 0 to 1 on each axis, after what has been told of its points; None at its end.

    A trust region: the next point is the best one near by of a model (the slopes, and the bend that they have shown,
    BFGS). Where the score falls as told the region grows, where it does not it shrinks.
    """
    x, here = first, next(told, None)
    if here is None:
        return x
    here = _on_axes(here, moved, x)
    if not math.isfinite(here[0]):
        return None
    radius, bend = FIRST, np.eye(len(x)) * np.linalg.norm(here[2]) / FIRST
    most = min(math.log(AIM * cap), ANY)
    for _ in range(LONGEST):
        step, gain = _step(here, bend, most, np.maximum(-radius, -x), np.minimum(radius, 1.0 - x))
        if gain < END:
            return None
        found = next(told, None)
        if found is None:
            return x + step
        there = _on_axes(found, moved, x + step)
        fallen = _merit(here, most) - _merit(there, most)
        if math.isfinite(there[0]):
            bend = _bent(bend, step, there[2] - here[2])
        if not fallen > 0.25 * gain:  # NaN neither
            radius = 0.4 * float(np.abs(step).max())
        elif fallen > 0.75 * gain:
            radius = max(radius, 2.0 * float(np.abs(step).max()))
        if fallen > 0.0:
            x, here = x + step, there
    return None


def _merit(found: Measured, most: float) -> float:
    """What falls from step to step: the score, and what Ms is above its cap."""
    return found[0] + WEIGHT * max(0.0, float(found[1].max()) - most)


def _step(here: Measured, bend: np.ndarray, most: float, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
    """The step to the least merit of the model, and by how much it would fall; what Ms is above its cap is one number
    more that is sought."""
    _, peaks, by_score, by_ms = here
    n, above = len(low), max(0.0, float(peaks.max()) - most)

    def merit(z: np.ndarray) -> tuple[float, np.ndarray]:
        d, over = z[:n], z[n]
        slope = by_score + bend @ d
        return by_score @ d + 0.5 * d @ bend @ d + WEIGHT * over, np.append(slope, WEIGHT)

    def room(z: np.ndarray) -> np.ndarray:
        return z[n] + most - peaks - by_ms @ z[:n]

    rooms = {"type": "ineq", "fun": room, "jac": lambda z: np.hstack([-by_ms, np.ones((len(peaks), 1))])}
    bounds = [*zip(low, high, strict=True), (0.0, None)]
    begin = np.append(np.zeros(n), above)
    found = optimize.minimize(
        merit, begin, method="SLSQP", jac=True, bounds=bounds, constraints=[rooms], options={"ftol": 1e-9}
    )
    step = np.clip(found.x[:n], low, high)
    after = by_score @ step + 0.5 * step @ bend @ step + WEIGHT * max(0.0, float((peaks + by_ms @ step).max()) - most)
    return step, WEIGHT * above - after


def _bent(bend: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The model's bend after a step that has changed the slopes: BFGS, damped so that it bends up."""
    pull = bend @ step
    whole = step @ pull
    share = 1.0 if step @ change >= 0.2 * whole else 0.8 * whole / (whole - step @ change)
    change = share * change + (1.0 - share) * pull
    return bend - np.outer(pull, pull) / whole + np.outer(change, change) / (step @ change)


def _on_axes(found: Measured, moved: tuple[Axis, ...], x: np.ndarray) -> Measured:
    """Slopes per range of the axes in place of those per unit of the parameters."""
    score, peaks, by_score, by_ms = found
    per = np.array([_per_unit(axis, u) for axis, u in zip(moved, x, strict=True)])
    return score, peaks, per * by_score, per * by_ms


def _per_unit(axis: Axis, u: float) -> float:
    """How a parameter changes with its place on the axis."""
    return axis.decode(u) * math.log(axis.high / axis.low) if axis.log else axis.high - axis.low
