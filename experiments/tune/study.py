"""A search of a controller: what it depends on, and one trial from candidate to value."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import optuna
from optuna.trial import FrozenTrial, Trial

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.control.stack import Team
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Machine
from ..store.ledger import Ledger
from . import goals, gradients, sampling, staged, storage
from .evaluate import Evaluator, with_jobs
from .goals import Limits
from .space import Space, space
from .staged import CLOSE, Stage, Staged, rank
from .work import Search, Work, done, feasible, steps_of, told_number

NEAR = 1.25
"""Times the cap on Ms beyond which a candidate is not looked at any further."""

PRUNE_AFTER, PRUNE_TRIALS = 3, 10
"""Scenarios that a candidate goes through, and trials that are completed, before the median of those prunes (Golovin
et al. 2017)."""


@dataclass(frozen=True)
class Task(Search):
    """Everything that a study of a controller depends on, as the user gave it."""

    counted = ("trials", "seeds")
    packages = ("optuna", "cmaes")

    controller: str
    what: tuple[str, ...]
    suite: str = "following"
    metrics: tuple[str, ...] = ("rms_true",)
    limits: Limits = field(default_factory=Limits)
    seeds: int = 32
    extrapolate: bool = False  # process settings may leave what was published
    stages: tuple[Stage, ...] = ()  # in place of the sampler
    also: tuple[tuple[tuple[str, float], ...], ...] = ()  # further trials at the start of stages: what they change
    digits: int = 5  # of a candidate's numbers; 0: as the sampler gives them, neither rounded nor mended
    finalists: int = 0  # how many of the best are run again; 0: none, the best of the trials is the result
    final_seeds: int = 200  # tune seeds on which they are
    fresh: bool = False  # from what the law declares, without what earlier searches found
    set: tuple[tuple[str, float], ...] = ()  # parameters in place of the controller's own
    relative: str = ""  # controller to whose figures metrics and limits are ratios
    criterion: str = ""  # what is sought, for the record
    named: tuple[str, ...] = ()  # scenarios in place of the suite's
    machine: Machine | None = None  # on which they are put

    @property
    def base(self) -> Team:
        """The controller as it stands.

        Raises:
            InvalidInput: unknown, or it does not fit the suite.
        """
        base = controller(self.controller)
        if self.fresh:
            if len(base.stacks) > 1:
                raise InvalidInput(f"fresh takes one stack, not '{self.controller}'")
            (stack,) = base.stacks
            kept = {name: value for name, value in stack.values.items() if not name.startswith("law.")}
            base = replace(base, stacks=(replace(stack, values=kept, provenance={}),))
        return base.varied(dict(self.set))

    @property
    def space(self) -> Space:
        """What is searched."""
        return space(self.base, self.what)

    @property
    def jobs(self) -> bool:
        """Whether jobs are done."""
        return with_jobs(self.suite, self.named)

    @property
    def over(self) -> str:
        """Suite or scenarios, and machine, in words."""
        what = f"scenarios {', '.join(self.named)}" if self.named else f"suite {scenarios.called(self.suite)}"
        return f"{what} · machine {self.machine.name}" if self.machine else what

    @property
    def directions(self) -> list[str]:
        """For each metric."""
        return ["maximize" if goals.metric(m, self.jobs).better == "higher" else "minimize" for m in self.metrics]

    @property
    def wanted(self) -> tuple[str, ...]:
        """Metrics that are needed of every scenario."""
        each = [part for name in self.metrics for part in goals.joined(name)]
        return tuple(dict.fromkeys((*each, *self.limits.metrics)))

    @property
    def pruned(self) -> bool:
        """Whether hopeless candidates are left off half-way; with several metrics nobody can say which are."""
        return len(self.metrics) == 1 and not self.stages

    @property
    def descends(self) -> bool:
        """Whether slopes are followed, see :mod:`gradients`."""
        return self.sampler == gradients.SAMPLER

    @property
    def peaks(self) -> bool:
        """Whether Ms is measured; of a search in stages, of whose results much is asked, even where any is allowed."""
        return math.isfinite(self.limits.ms) or (bool(self.stages) and not self.jobs)

    def told(self, limit: goals.Limit) -> str:
        """A limit in words."""
        return f"{limit.name} {'≥' if goals.metric(limit.name, self.jobs).better == 'higher' else '≤'} {limit.most:g}"

    @property
    def words(self) -> list[str]:
        """What the trials depend on; of two studies that differ in a word, one cannot go on as the other."""
        fixed = [f"{n}={p.value}" for n, p in self.base.parameters().items()] + self.base.program
        if self.relative:
            other = controller(self.relative)
            fixed += [f"{n}={p.value}" for n, p in other.parameters().items()] + other.program
        words = [f"controller {self.controller}", f"suite {self.suite}", f"metric {', '.join(self.metrics)}"]
        words += [f"scenario {name}" for name in self.named]
        words += [f"machine {self.machine.name} {self.machine.digest}"] if self.machine else []
        words += [f"Ms ≤ {self.limits.ms:g}", *(f"{limit.name} ≤ {limit.most:g}" for limit in self.limits.limits)]
        words += [f"sampler {self.sampler}", f"seed {self.seed}", f"tune seeds 0-{self.seeds - 1}"]
        words += ["extrapolate"] if self.extrapolate else []
        words += [*(axis.words for axis in self.space.axes), *(stage.words for stage in self.stages)]
        words += [f"trials {self.trials}"] if self.stages else []
        words += [f"also {dict(changes)}" for changes in self.also]
        words += [f"digits {self.digits}"] if self.digits != 5 else []
        words += [f"{name}={other}" for name, other in self.space.ties.items()]
        words += [f"relative to {self.relative}"] if self.relative else []
        return [*words, f"{storage.FIXED}{storage.digest(fixed)}"]

    @property
    def expected(self) -> int:
        """Trials that there will be, if none is pruned."""
        if not self.budget:
            return self.trials
        return min(self.trials, self.budget // self.evaluator().steps)

    @property
    def explored(self) -> int:
        """See :attr:`Search.explored`; before a descent at most half of the trials."""
        if not self.descends:
            return super().explored
        return max(1, min(sampling.explored(self.expected, self.space), self.expected // 2))

    def evaluator(self, seeds: Any = None, threads: int = 1) -> Evaluator:
        """What runs its candidates, on its *tune* seeds unless told otherwise."""
        seeds = range(self.seeds) if seeds is None else seeds
        other = controller(self.relative) if self.relative else None
        return Evaluator(self.base, self.suite, seeds, threads, self.extrapolate, other, self.named, self.machine)

    def samplers(self, explore: int) -> tuple[Any, Any]:
        """Of stages, or what the user asked for."""
        pruner = optuna.pruners.MedianPruner(n_startup_trials=PRUNE_TRIALS, n_warmup_steps=PRUNE_AFTER)
        if self.stages:
            also = tuple(map(dict, self.also))
            return Staged(self.stages, self.space, self.seed, self.trials, self.limits.ms, also), pruner
        positive = not goals.metric(self.metrics[0], self.jobs).zero
        cost = sampling.costs(1.0, positive, self.directions[0] == "maximize")
        if self.descends:
            return gradients.Descents(self.space, self.seed, explore, cost, self.limits.ms), pruner
        return sampling.Seeded(self.sampler, self.space, self.seed, explore, cost), pruner

    def check(self, workers: int = 1) -> None:
        """See :meth:`Search.check`."""
        scenarios.suite(self.suite)  # an unknown one is an error here
        if any(stack.sealed for stack in self.base.stacks):
            raise InvalidInput(f"'{self.controller}' is C; tune the controller that it was exported from")
        super().check(workers)
        if self.seeds > (most := len(scenarios.SPLITS["tune"])):
            raise InvalidInput(f"--seeds {self.seeds} is out of range; split 'tune' has {most}")
        if self.seed < 0:
            raise InvalidInput(f"--seed {self.seed} is out of range; 0 and up")
        for name in (*self.metrics, *(limit.name for limit in self.limits.limits)):
            goals.metric(name, self.jobs)
        twice = [m for m in self.metrics if self.metrics.count(m) > 1]
        if twice:
            raise InvalidInput(f"metric '{twice[0]}' is given twice")
        if self.stages:
            staged.check(self.stages, self.trials, self.directions, workers, self.space)
        elif self.descends:
            gradients.check(self, workers)
        else:
            sampling.check(self.sampler, len(self.metrics))
        evaluator = self.evaluator()  # refuses what does not fit the suite
        if self.budget and self.budget < (one := evaluator.steps):
            raise InvalidInput(f"--budget of {self.budget:,} steps is out of range; one candidate takes {one:,}")
        _ = self.space

    def work(self, threads: int, study: Any = None) -> "RollOuts":
        """One process' part of the study."""
        return RollOuts(self, threads, study)

    def state(self, study: Any) -> tuple[int, int, str]:
        """How many trials are over, of how many, and the best value."""
        trials = done(study)
        good = [t.values for t in trials if feasible(t)]
        told = len(trials), self.trials
        if self.budget:
            told = min(100, 100 * steps_of(trials) // self.budget), 100
        if not good:
            return *told, "no trial keeps the limits yet" if trials else ""
        if len(self.metrics) > 1:
            return *told, f"{len(good)} keep the limits"
        values = [v[0] for v in good]
        best = max(values) if self.directions[0] == "maximize" else min(values)
        unit = goals.metric(self.metrics[0], self.jobs).unit
        return *told, f"best {best:.4g} {unit}".rstrip(" 1")


def _measured(trials: list[FrozenTrial]) -> dict[str, tuple[bool, int]]:
    """What finished trials have measured of each candidate: whether its Ms, and how many parts of the scenarios."""
    found: dict[str, tuple[bool, int]] = {}
    for trial in trials:
        word = trial.user_attrs.get("candidate", "")
        peak, parts = found.get(word, (False, 0))
        found[word] = peak or "ms" in trial.user_attrs, max(parts, trial.user_attrs.get("parts", 0))
    return found


def controller(spec: str) -> Team:
    """The team that the words name; what they leave open is not tuned."""
    return stacks.asked(spec)


@dataclass
class _Known:
    """What has been measured of a candidate; whole numbers and choices come again and again."""

    peak: float | None = None
    parts: list[goals.Figures] = field(default_factory=list)
    slopes: dict[str, Any] = field(default_factory=dict)


class RollOuts(Work):
    """One process' part of a study whose trials are roll-outs of controllers."""

    task: Task

    def __init__(self, task: Task, threads: int, study: Any = None) -> None:
        super().__init__(task, study)
        self.base, self.space = task.base, task.space
        self.evaluator = task.evaluator(threads=threads)
        self.validation = Ledger()
        self._known: dict[str, _Known] = {}
        self._again, self._lost = 0, {}
        self.ms_steps = 0  # of the last trial, at all frequencies
        if not task.url or storage.is_file(task.url):
            self._lost = _measured(done(self.study))

    def one(self, trial: Trial) -> None:
        """One trial from candidate to value.

        Its steps are those that the study needed for it. What an earlier process of the same study had measured, and
        took with it, is measured again but does not count, or a study with a budget would end with fewer trials for
        having been interrupted.
        """
        ledger = self.evaluator.ledger
        steps, seconds, self._again, self.ms_steps = ledger.steps, ledger.cpu_seconds, 0, 0
        try:
            values = self._values(trial)
        except optuna.TrialPruned:
            values = None
        cost: dict[str, float] = {"steps": ledger.steps - steps - self._again - self.ms_steps}
        cost |= {"cpu_seconds": round(ledger.cpu_seconds - seconds, 4)}
        self.over(trial, values, **cost, **({"ms_steps": self.ms_steps} if self.ms_steps else {}))

    def _values(self, trial: Trial) -> list[float]:
        task, limits, first = self.task, self.task.limits, trial.number == 0
        values = self.space.values(self.space.suggest(trial), task.digits)
        try:
            candidate = self.base.varied(values)
        except InvalidInput:  # what is in range alone may be impossible together
            trial.set_constraint("possible", goals.FAR)
            raise optuna.TrialPruned from None
        by = self._by(trial)
        word = str(sorted(values.items())) + (" with slopes" if by else "")
        known = self._known.setdefault(word, _Known())
        lost, ledger = self._lost.get(word, (False, 0)), self.evaluator.ledger
        trial.set_user_attr("candidate", word)
        if task.peaks:
            if known.peak is None:
                before = ledger.steps
                known.peak, known.slopes = self._peak(candidate, by)
                self._again += (ledger.steps - before) * lost[0]
            peak = known.peak
            broken = self._broken(trial, peak)
            if task.pruned and not first and not by and broken > math.log(NEAR):
                raise optuna.TrialPruned
        figures: goals.Figures = {}
        core = self.evaluator.core
        for i in range(self.evaluator.parts):
            if i == len(known.parts):
                before = ledger.steps
                try:
                    known.parts.append(self.evaluator.part(i, candidate, task.wanted, by))
                    trial.set_user_attr("parts", len(known.parts))
                    self._again += (ledger.steps - before) * (i < lost[1])
                except InvalidInput:  # a feed that the axes cannot do, a dither that the optics cannot
                    trial.set_constraint("possible", goals.FAR)
                    raise optuna.TrialPruned from None
            figures |= known.parts[i]
            if not task.pruned or by:
                continue
            ran = [s for s in core if s in figures]
            value = goals.score(task.metrics[0], figures, core)
            trial.report(told_number(value), len(ran) - 1)
            if not first and len(ran) < len(core) and trial.should_prune():
                raise optuna.TrialPruned
        kept = limits.check(figures, core, task.jobs)
        for name, broken in kept.items():
            trial.set_constraint(name, broken)
        found = [goals.score(name, figures, core) for name in task.metrics]
        if by:
            self._tell_slopes(trial, known, figures)
        if task.stages and task.peaks and peak <= limits.ms and max(kept.values()) <= 0:
            self._look_closer(trial, candidate, peak, found[0])
        trial.set_constraint("finite", -1.0 if all(map(math.isfinite, found)) else goals.FAR)
        higher = [d == "maximize" for d in task.directions]
        return [
            v if math.isfinite(v) else -goals.FAILED if h else goals.FAILED for v, h in zip(found, higher, strict=True)
        ]

    def _by(self, trial: Trial) -> tuple[str, ...]:
        """The parameters whose slopes the trial is to find; none while the study explores."""
        if not self.task.descends or trial.number < self.study.user_attrs.get("explore", 0):
            return ()
        return tuple(axis.name for axis in gradients.axes(self.space))

    def _peak(self, candidate: Team, by: tuple[str, ...]) -> tuple[float, dict[str, Any]]:
        """Ms, and the slopes of its peaks if some are wanted."""
        if not by:
            return self.evaluator.peak(candidate), {}
        peak, peaks, slopes = self.evaluator.bent_peaks(candidate, by)
        return peak, {"peaks": peaks, "ms": slopes.ravel()}

    def _tell_slopes(self, trial: Trial, known: "_Known", figures: goals.Figures) -> None:
        """Tells the study the slopes of the score, a geometric mean over the core of roots of mean squares, and of
        Ms."""
        if "score" not in known.slopes:
            each = [self.evaluator.bent[s] / np.mean(figures[s]["rms_true"] ** 2) for s in self.evaluator.core]
            known.slopes["score"] = 0.5 * np.mean(each, axis=0)
        told = {name: [told_number(x) for x in of.tolist()] for name, of in known.slopes.items()}
        trial.set_user_attr(gradients.SLOPES, told)

    def _broken(self, trial: Trial, peak: float) -> float:
        """By how much the cap on Ms is broken; the study is told."""
        broken = self.task.limits.peak(peak)
        trial.set_user_attr("ms", told_number(peak))
        trial.set_constraint("ms", broken)
        return broken

    def _look_closer(self, trial: Trial, candidate: Team, peak: float, value: float) -> None:
        """Measures Ms of what may come out best at all frequencies; what that takes is counted apart."""
        best = min((rank(each, self.task.limits.ms) for each in done(self.study)), default=math.inf)
        if value < CLOSE * best:
            self._broken(trial, max(peak, self.exact_peak(candidate)))

    def exact_peak(self, candidate: Team) -> float:
        """Ms as a benchmark measures it; its steps are counted apart from those of the roll-outs."""
        before = self.evaluator.ledger.steps
        found = self.evaluator.exact_peak(candidate)
        self.ms_steps += self.evaluator.ledger.steps - before
        return found
