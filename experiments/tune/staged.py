"""Searches in stages, each with a sampler of optuna's own: how the shipped presets are found (``tune/studies/``).

Such a sampler keeps a random state. When a study goes on after an interruption, its stages are gone through once more
with what the trials came to, which takes milliseconds each and brings every sampler to the state that it had. So a
stage needs its trials one after the other, in one process.
"""

import itertools
import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState
from scipy import optimize

from ...envs.engine.quantity import InvalidInput, did_you_mean
from .goals import FAILED
from .sampling import distribution
from .space import Axis, Space, start_of

SAMPLERS = ("tpe", "cmaes", "bounded", "nelder-mead")
"""The last two are scipy's: Brent's method for one number (Brent 1973), and simplices (Nelder and Mead 1965)."""

STARTUP = 30
"""Random trials at the start of TPE."""

AIM = 0.98
"""Share of the cap on Ms that costs nothing: between the few frequencies of a search |S| may be higher."""

SLACK = 1.005
"""Times the cap on Ms up to which a trial may come out best; what does is measured at all frequencies."""

CLOSE = 1.03
"""Times the best value so far; Ms of what is closer is measured at all frequencies at once."""

IMPOSSIBLE, ENDLESS = 20.0, 15.0
"""Costs of a candidate that cannot be made, and of one that fails."""


@dataclass(frozen=True)
class Stage:
    """Trials of one sampler.

    Attributes:
        sampler: of :data:`SAMPLERS`; ``cmaes`` starts from the best trial so far.
        weight: of a broken limit, per unit of its logarithm.
        spread: first standard deviation of ``cmaes``, in ranges.
        anew: without what the stage before has seen, but for its best trial.
    """

    sampler: str
    weight: float = 12.0
    spread: float = 0.1
    anew: bool = True

    @property
    def plain(self) -> bool:
        """Whether its sampler is told values as they are, not their logarithms."""
        return self.sampler in ("bounded", "nelder-mead")

    @property
    def words(self) -> str:
        """What the trials depend on."""
        spread = f" spread {self.spread:g}" if self.sampler == "cmaes" else ""
        return f"stage {self.sampler} weight {self.weight:g}{spread}{' anew' if self.anew else ''}"


def sizes(stages: tuple[Stage, ...], trials: int) -> list[int]:
    """Trials of each stage: alike, but that what the first leaves is shared out, and a remainder goes to the second."""
    later, first = len(stages) - 1, round(trials / len(stages))
    each = [(trials - first) // later] * later if later else []
    return [first, *((trials - first) % later + many if i == 0 else many for i, many in enumerate(each))]


def check(stages: tuple[Stage, ...], trials: int, directions: list[str], workers: int, space: Space) -> None:
    """Whether these stages can be gone through.

    Raises:
        InvalidInput: they cannot.
    """
    for stage in stages:
        if stage.sampler not in SAMPLERS:
            raise InvalidInput(f"unknown sampler '{stage.sampler}' of a stage; {did_you_mean(stage.sampler, SAMPLERS)}")
        if stage.plain and (space.conditional or (stage.sampler == "bounded" and len(space.axes) > 1)):
            raise InvalidInput("a stage with sampler bounded takes one number, with nelder-mead numbers alone")
    if directions != ["minimize"]:
        raise InvalidInput("stages take one metric of which less is better")
    if workers > 1:
        raise InvalidInput(f"stages go on trial by trial, in one process; --workers {workers} is out of range")
    if min(sizes(stages, trials)) < 1:
        raise InvalidInput(f"{trials} trials are too few for {len(stages)} stages")


def told(stages: tuple[Stage, ...], trials: int) -> str:
    """The stages as a record has them."""
    names = {"tpe": "TPE", "cmaes": "CMA-ES", "bounded": "Brent", "nelder-mead": "Nelder-Mead"}
    pairs = zip(stages, sizes(stages, trials), strict=True)
    runs = itertools.groupby(pairs, lambda pair: names[pair[0].sampler])
    return ", then ".join(f"{name} {' and '.join(str(many) for _, many in each)}" for name, each in runs)


def rank(trial: FrozenTrial, cap: float) -> float:
    """The value of a trial that may come out best; of others infinite."""
    if trial.state != TrialState.COMPLETE or trial.values[0] >= FAILED:
        return math.inf
    kept = all(v <= 0 for name, v in trial.constraints.items() if name != "ms")
    return trial.values[0] if kept and trial.user_attrs.get("ms", 0.0) <= SLACK * cap else math.inf


def cost(trial: FrozenTrial, cap: float, weight: float) -> float:
    """What a stage's sampler is told of a trial: the logarithm of its value and of what it breaks."""
    if trial.state != TrialState.COMPLETE:
        return IMPOSSIBLE
    value, peak = trial.values[0], trial.user_attrs.get("ms", 0.0)
    if value >= FAILED or peak >= FAILED:
        return ENDLESS
    broken = {name: max(0.0, v) for name, v in trial.constraints.items() if name != "ms"}
    crashes = broken.pop("collision", 0.0)  # weighs alike in all stages
    above = math.log(peak / (AIM * cap)) if peak > 0 and math.isfinite(cap) else 0.0
    return math.log(max(value, 1e-12)) + weight * max(0.0, above) + weight * sum(broken.values()) + crashes


class _Together(BaseSampler):
    """A sampler of all that is searched at once."""

    def __init__(self, axes: tuple[Axis, ...]) -> None:
        self.axes = axes

    def infer_relative_search_space(self, study: Any, trial: FrozenTrial) -> dict[str, Any]:
        """All that is searched."""
        return {axis.name: distribution(axis) for axis in self.axes}

    def sample_independent(self, study: Any, trial: FrozenTrial, param_name: str, param_distribution: Any) -> Any:
        """Never asked."""
        raise AssertionError(param_name)


class _Asked(Exception):
    """The point whose value a minimiser asks for."""


class Minimised(_Together):
    """A minimiser of scipy, gone through anew for every trial with the values that are known so far.

    Args:
        name: ``bounded`` or ``nelder-mead``.
        axes: numbers.
        start: where simplices begin.
    """

    def __init__(self, name: str, axes: tuple[Axis, ...], start: dict[str, float]) -> None:
        super().__init__(axes)
        self.name, self.start = name, [float(start[axis.name]) for axis in axes]

    def sample_relative(self, study: Any, trial: FrozenTrial, search_space: dict[str, Any]) -> dict[str, Any]:
        """The next point; the best one again where the minimiser has come to its end."""
        known = iter([each.value for each in study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))])
        bounds = [(axis.low, axis.high) for axis in self.axes]

        def value(x: Any) -> float:
            for each in known:
                return float(each)
            raise _Asked(np.atleast_1d(x).tolist())

        try:
            if self.name == "bounded":
                point = [optimize.minimize_scalar(value, bounds=bounds[0], method="bounded").x]
            else:
                ends = {"xatol": 1e-4, "fatol": 1e-3}
                point = optimize.minimize(value, self.start, method="Nelder-Mead", bounds=bounds, options=ends).x
        except _Asked as asked:
            point = asked.args[0]
        return {axis.name: float(x) for axis, x in zip(self.axes, point, strict=True)}


class Staged(_Together):
    """The sampler of a study in stages.

    Args:
        stages: one after the other.
        space: what is searched; its start is the first trial, so that a search never ends worse than it began.
        seed: of the first sampler; each ``cmaes`` after the first has the next one.
        trials: in all.
        cap: on Ms.
        also: further trials at the start, as changes of the first one.
    """

    def __init__(
        self,
        stages: tuple[Stage, ...],
        space: Space,
        seed: int,
        trials: int,
        cap: float,
        also: tuple[dict[str, float], ...] = (),
    ) -> None:
        super().__init__(space.axes)
        self.stages, self.space, self.seed, self.cap, self.also = stages, space, seed, cap, also
        ends, self._firsts = 0, []
        for many in sizes(stages, trials):
            self._firsts.append(ends)
            ends += many
        self._over: list[tuple[float, float, FrozenTrial]] = []
        self._inner: Any = None
        self._asked: Any = None

    def sample_relative(self, study: Any, trial: FrozenTrial, search_space: dict[str, Any]) -> dict[str, Any]:
        """Parameters of the trial, after the samplers have been told of those before it.

        Raises:
            InvalidInput: what was found before is not what the stages ask for.
        """
        before = [t for t in study.get_trials(deepcopy=False) if t.number < trial.number]
        for each in before[len(self._over) :]:
            if self._asked is None and self._ask(each.number) != each.params:
                raise InvalidInput(
                    f"trial {each.number} of '{study.study_name}' is not what its stages ask for; was it edited, or "
                    "begun with another version of optuna? Use --overwrite"
                )
            self._tell(each)
        if self._asked is None:
            self._ask(trial.number)
        return dict(self._asked.params)

    def _at(self, number: int) -> int:
        return max(i for i, first in enumerate(self._firsts) if first <= number)

    def _ask(self, number: int) -> dict[str, Any]:
        if number in self._firsts:
            self._begin(self._at(number))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._asked = self._inner.ask()
            self.space.suggest(self._asked)
        return dict(self._asked.params)

    def _tell(self, trial: FrozenTrial) -> None:
        stage, place = self.stages[self._at(trial.number)], rank(trial, self.cap)
        told = cost(trial, self.cap, stage.weight)
        if stage.plain:
            told = place if math.isfinite(place) else math.exp(told)
        self._inner.tell(self._asked, told)
        self._asked = None
        self._over.append((place, told, trial))

    def _begin(self, i: int) -> None:
        stage, make = self.stages[i], optuna.samplers
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            best = min(self._over, key=lambda each: each[:2])[2].params if self._over else start_of(self.space)
            if not stage.anew and self._over:
                best = self._inner.best_params
            if stage.sampler == "tpe":
                sampler: Any = make.TPESampler(seed=self.seed, multivariate=True, n_startup_trials=STARTUP)
            elif stage.sampler == "cmaes":
                later = sum(each.sampler == "cmaes" for each in self.stages[:i])
                sampler = make.CmaEsSampler(x0=dict(best), sigma0=stage.spread, seed=self.seed + later)
            else:
                sampler = Minimised(stage.sampler, self.space.axes, best)
        if self._inner is None or stage.anew:
            self._inner = optuna.create_study(sampler=sampler)
        self._inner.sampler = sampler
        if i == 0 and not stage.plain:
            self._inner.enqueue_trial(start_of(self.space))
            for changes in self.also:
                self._inner.enqueue_trial({**start_of(self.space), **changes})
