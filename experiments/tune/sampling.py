"""Samplers whose every trial depends on the seed, its number and the trials finished before it, and on nothing else.

The samplers of optuna (Akiba et al. 2019) keep a random state that dies with the process. Here a trial's sampler is
made for that trial, with a seed drawn from the study's seed and the trial's number, so a study that was killed and goes
on is the same study. CMA-ES is replayed from the trials that it asked for: generation by generation, which takes
milliseconds.
"""

import math
import warnings
import zlib
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import optuna
from optuna.samplers import BaseSampler, GPSampler, NSGAIISampler, RandomSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState

from ...envs.engine.quantity import InvalidInput, check_choice
from . import soundness
from .goals import FAILED
from .space import Axis, Space, numbers_of, start_of

SAMPLERS = ("tpe+cmaes", "tpe", "cmaes", "gp", "random", "nsga2")
"""TPE (Bergstra et al. 2011), CMA-ES (Hansen and Ostermeier 2001), Gaussian processes (Snoek et al. 2012), NSGA-II (Deb
et al. 2002)."""
SINGLE = ("tpe+cmaes", "cmaes")
"""Samplers for one metric only."""

STARTUP = 20
"""Random trials at the start of TPE."""

EXPLORE, EXPLORE_CHOICES = 0.3, 0.7
"""Share of the trials that TPE makes before CMA-ES takes over (docs/design.md#searching), and
the same where there are choices, which CMA-ES has to take as they are."""

TURNS = 6
"""Trials that each choice gets before TPE favours some: with the settings as they are, then with random ones."""

SIGMA = {"tpe+cmaes": 0.1, "cmaes": 0.2}
"""First standard deviation of CMA-ES, of the range: near an optimum that TPE has found, or anywhere."""

WEIGHT = 12.0
"""Weight of a broken limit in CMA-ES' cost, per unit of its logarithm."""

ASKED = "cmaes"
"""Attribute of a trial: generation and point."""


def check(name: str, objectives: int) -> None:
    """Whether this sampler exists and can do with so many objectives.

    Raises:
        InvalidInput: it cannot.
    """
    check_choice(name, SAMPLERS, "sampler")
    if objectives > 1 and name in SINGLE:
        raise InvalidInput(f"sampler '{name}' takes one metric; for {objectives} use tpe, nsga2, gp or random")


def explored(trials: int, space: Space) -> int:
    """Trials before CMA-ES takes over."""
    share = EXPLORE_CHOICES if space.conditional else EXPLORE
    return max(STARTUP + 5, round(share * trials))


def seed_of(seed: int, number: int) -> int:
    """The seed of one trial."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0] >> 1)


class Seeded(BaseSampler):
    """The sampler of a study.

    Args:
        name: one of :data:`SAMPLERS`.
        space: what is searched; its start is the first trial, so that a search never ends worse than it began.
        seed: of the study.
        explore: trials before CMA-ES takes over.
        cost: of a finished trial, for CMA-ES.
        startup: random trials at the start of TPE.
        turns: trials that each choice gets at the start of TPE.
    """

    def __init__(
        self,
        name: str,
        space: Space,
        seed: int,
        explore: int,
        cost: Callable[[FrozenTrial], float],
        startup: int = STARTUP,
        turns: int = TURNS,
    ) -> None:
        self.name, self.space, self.seed, self.explore, self.cost = name, space, seed, explore, cost
        self.startup, self.turns = startup, turns
        self._for, self._inner = -1, cast(BaseSampler, RandomSampler(seed=0))

    def _sampler(self, trial: FrozenTrial) -> BaseSampler:
        """The sampler of this trial."""
        if self._for != trial.number:
            self._for, self._inner = trial.number, self._make(trial.number)
        return self._inner

    def _make(self, number: int, salt: int = 0) -> BaseSampler:
        seed = seed_of(self.seed, number) ^ (salt >> 1)
        conditional = self.space.conditional
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if self.name in ("tpe", "tpe+cmaes"):
                startup = max(self.startup, 1 + self.turns * self._turns)
                return TPESampler(seed=seed, multivariate=True, group=conditional, n_startup_trials=startup)
            if self.name == "gp":
                return GPSampler(seed=seed, deterministic_objective=True)
            if self.name == "nsga2":
                return NSGAIISampler(seed=seed, population_size=20)
            return RandomSampler(seed=seed)

    @property
    def _turns(self) -> int:
        """Choices that take turns at the start."""
        return max((len(axis.choices) for axis in self.space.axes), default=0)

    def _turn(self, number: int) -> dict[str, Any]:
        """Parameters of the trials at the start in which the choices take turns; the rest of them is random."""
        if self.name not in ("tpe", "tpe+cmaes") or not 1 <= number <= self.turns * self._turns:
            return {}
        chosen = {a.name: a.choices[(number - 1) % len(a.choices)] for a in self.space.axes if a.choices}
        return {**numbers_of(self.space, chosen), **chosen} if number <= self._turns else chosen

    def _by_cmaes(self, trial: FrozenTrial) -> bool:
        return self.name in SINGLE and trial.number >= self.explore and trial.number > 0

    def infer_relative_search_space(self, study: Any, trial: FrozenTrial) -> dict[str, Any]:
        """What the trial's sampler searches together; nothing where this class itself decides."""
        if trial.number == 0 or self._turn(trial.number) or self._by_cmaes(trial):
            return {axis.name: distribution(axis) for axis in self.space.axes}
        return self._sampler(trial).infer_relative_search_space(study, trial)

    def sample_relative(self, study: Any, trial: FrozenTrial, search_space: dict[str, Any]) -> dict[str, Any]:
        """Parameters of the trial."""
        if trial.number == 0:
            return start_of(self.space)
        if turn := self._turn(trial.number):
            return turn
        if self._by_cmaes(trial):
            return self._cmaes(study, trial)
        return self._sampler(trial).sample_relative(study, trial, search_space)

    def sample_independent(self, study: Any, trial: FrozenTrial, param_name: str, param_distribution: Any) -> Any:
        """A parameter that is not searched together with the others.

        Its random numbers are its own, since a trial that was killed after some parameters were drawn draws the rest.
        """
        alone = self._make(trial.number, zlib.crc32(param_name.encode()))
        return alone.sample_independent(study, trial, param_name, param_distribution)

    def before_trial(self, study: Any, trial: FrozenTrial) -> None:
        """Tells the trial's sampler."""
        self._sampler(trial).before_trial(study, trial)

    def after_trial(self, study: Any, trial: FrozenTrial, state: TrialState, values: Any) -> None:
        """Tells the trial's sampler."""
        self._sampler(trial).after_trial(study, trial, state, values)

    # ------------------------------------------------------------------------------------------------- CMA-ES

    def _cmaes(self, study: Any, trial: FrozenTrial) -> dict[str, Any]:
        start = study.user_attrs.get(ASKED)
        if start is None:
            before = [t for t in study.get_trials(deepcopy=False) if t.number < self.explore and _done(t)]
            start = min(before, key=self.cost).params if before else start_of(self.space)
            study.set_user_attr(ASKED, start)
        soundness.start(start, (a for a in self.space.axes if a.choices), study.study_name)
        fixed = {k: v for k, v in start.items() if isinstance(v, str)}
        axes = [a for a in self.space.active(fixed) if not a.choices]
        if not axes:  # nothing to refine, so TPE goes on
            inner = self._sampler(trial)
            return inner.sample_relative(study, trial, inner.infer_relative_search_space(study, trial))
        asked = [t for t in study.get_trials(deepcopy=False) if ASKED in t.user_attrs and _done(t)]
        soundness.start(start, axes, study.study_name)
        soundness.points(asked, max(len(axes), 2), study.study_name)
        generation, point = ask(axes, start, asked, self.cost, SIGMA[self.name], self.seed, trial.number)
        study._storage.set_trial_user_attr(trial._trial_id, ASKED, {"generation": generation, "point": point})
        decoded = {a.name: a.decode(x) for a, x in zip(axes, point, strict=False)}  # a lone axis' point has two numbers
        return fixed | {a.name: int(decoded[a.name]) if a.whole else decoded[a.name] for a in axes}


def ask(
    axes: list[Axis],
    start: dict[str, Any],
    asked: list[FrozenTrial],
    cost: Callable[[FrozenTrial], float],
    sigma: float,
    seed: int,
    number: int,
) -> tuple[int, list[float]]:
    """Generation and point (0 to 1 on every axis) of CMA-ES' next trial, from the finished ones that it asked for.

    Of a lone axis the point has a second number, without effect: the library needs two dimensions.
    """
    import cmaes

    mean = np.clip([a.encode(float(start[a.name])) for a in axes], 0.0, 1.0)
    size = max(4 + int(3 * math.log(len(axes))), 6)
    if len(axes) == 1:
        mean = np.append(mean, 0.5)
    optimiser = cmaes.CMA(
        mean=mean, sigma=sigma, bounds=np.tile([0.0, 1.0], (len(mean), 1)), seed=seed_of(seed, 0), population_size=size
    )
    by_generation: dict[int, list[FrozenTrial]] = {}
    for trial in sorted(asked, key=lambda t: t.number):
        by_generation.setdefault(trial.user_attrs[ASKED]["generation"], []).append(trial)
    while len(found := by_generation.get(optimiser.generation, [])) >= size:
        optimiser.tell([(np.asarray(t.user_attrs[ASKED]["point"]), cost(t)) for t in found[:size]])
    optimiser._rng.seed(seed_of(seed, number))
    return optimiser.generation, [float(x) for x in optimiser.ask()]


def costs(start: float, positive: bool, higher: bool) -> Callable[[FrozenTrial], float]:
    """CMA-ES' cost of a finished trial: its value, on a logarithmic scale if it is positive, plus what it breaks.

    Args:
        start: the metric of the controller as it is, the unit of the scale if it may be zero.
        positive: the metric cannot be zero.
        higher: higher is better.
    """

    def cost(trial: FrozenTrial) -> float:
        broken = sum(max(0.0, v) for v in trial.constraints.values())
        if trial.state == TrialState.PRUNED or trial.value is None:
            last = max(trial.intermediate_values.items(), default=(0, FAILED))[1]
            return 50.0 + min(broken, 50.0) + math.atan(last)
        if positive:
            value = math.log(max(trial.value, 1e-12))
        else:
            value = trial.value / max(abs(start), 1e-9)
        return (-value if higher else value) + WEIGHT * broken

    return cost


def distribution(axis: Axis) -> Any:
    """The axis as optuna knows it."""
    if axis.choices:
        return optuna.distributions.CategoricalDistribution(list(axis.choices))
    if axis.whole:
        return optuna.distributions.IntDistribution(int(axis.low), int(axis.high))
    return optuna.distributions.FloatDistribution(axis.low, axis.high, log=axis.log)


def _done(trial: FrozenTrial) -> bool:
    return trial.state in (TrialState.COMPLETE, TrialState.PRUNED)
