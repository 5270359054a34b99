"""A search of a training's settings: what it depends on, and one trial, which is a short training."""

import math
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import Trial

from ...agents import settings as presets
from ...agents.learner import NUM_ENVS
from ...agents.settings import Settings
from ...agents.train import Diverged, Training, begun
from ...envs.engine.quantity import InvalidInput
from . import goals, sampling, storage
from .hyper import REST, Hyper
from .space import Space
from .work import Search, Work, done, feasible

SHARE = 10
"""Part of the preset's steps that a trial trains unless told otherwise."""


def short_steps(base: Settings) -> int:
    """Of a trial unless told otherwise: a tenth of the preset's, but not less than an episode of each machine."""
    episode = base.environment.get("max_steps") or 0
    return max(1, base.steps // SHARE, min(base.steps, episode * base.environment.get("num_envs", NUM_ENVS)))


LOOKS, CHECKPOINTS = 5, 10
"""Evaluations of a trial, and its checkpoints unless the preset says when they are made."""

STARTUP = 10
"""Random trials at the start of TPE."""

PRUNE_AFTER, PRUNE_TRIALS = 2, 5
"""Evaluation from which on, and trials after which, the median of those prunes."""


@dataclass(frozen=True)
class TrainingTask(Search):
    """Everything that a study of a training's settings depends on, as the user gave it.

    Attributes:
        base: the settings from which the search begins, for as many steps as they are meant for.
        steps: of each trial.
        threads: of torch, whose sums depend on them.
        sampler, trials: as of any study; its seed is also that of every training, which go on in its folder.
    """

    base: Settings
    steps: int
    threads: int = 1
    sampler: str = field(default="tpe", kw_only=True)
    trials: int = field(default=40, kw_only=True)

    counted = ("trials", "steps", "threads")
    packages = ("optuna", "stable-baselines3", "torch")

    @property
    def hyper(self) -> Hyper:
        """What is searched."""
        return Hyper(self.base)

    @property
    def space(self) -> Space:
        """Its axes."""
        return self.hyper.space

    @property
    def every(self) -> int:
        """Steps between two evaluations."""
        return -(-self.steps // LOOKS)

    def settings(self, number: int, params: dict[str, Any]) -> Settings:
        """Of a trial; the first one trains with the settings as they stand, even where a range leaves them out."""
        return self.base if number == 0 else self.hyper.settings(params)

    def short(self, settings: Settings) -> Settings:
        """The settings for a trial's length; episodes begin anew at a checkpoint, so where the preset says when, it is
        left at that.
        """
        keep = settings.checkpoint.get("every", -(-self.steps // CHECKPOINTS))
        return settings.varied({"steps": self.steps, "evaluation.every": self.every, "checkpoint.every": keep})

    @property
    def words(self) -> list[str]:
        """What the trials depend on; of two studies that differ in a word, one cannot go on as the other."""
        start = self.space.start
        searched = {name.removeprefix(REST) for name in start}
        fixed = [f"{key}={value!r}" for key, value in self.base.flat().items() if key not in (*searched, "steps")]
        fixed += [f"{name} from {value!r}" for name, value in start.items()]
        words = [f"algorithm {self.base.name}", f"environment {self.base.env}"]
        words += [f"{name} {getattr(self, name)}" for name in ("steps", "sampler", "seed", "threads")]
        return [*words, *(axis.words for axis in self.space.axes), f"{storage.FIXED}{storage.digest(fixed)}"]

    def samplers(self, explore: int) -> tuple[Any, Any]:
        """What the user asked for; scores are RMS errors, or minus a return, which has any sign."""
        cost = sampling.costs(1.0, self.height, False)
        pruner = optuna.pruners.MedianPruner(n_startup_trials=PRUNE_TRIALS, n_warmup_steps=PRUNE_AFTER)
        return sampling.Seeded(self.sampler, self.space, self.seed, explore, cost, STARTUP, turns=0), pruner

    def check(self, workers: int = 1) -> None:
        """See :meth:`Search.check`."""
        super().check(workers)
        sampling.check(self.sampler, 1)
        begun(self.short(self.base), Path(), self.seed, threads=self.threads)  # writes nothing

    @property
    def height(self) -> bool:
        """Whether the score is an RMS error in µm."""
        return presets.TASKS[self.base.env].name == "height-following"

    def work(self, threads: int, study: Any = None) -> "Trainings":
        """One process' part of the study."""
        return Trainings(self, study)

    def state(self, study: Any) -> tuple[int, int, str]:
        """How many trials are over, of how many, and the best value."""
        trials = done(study)
        good = [t.values[0] for t in trials if feasible(t)]
        unit = " µm" * self.height
        return len(trials), self.trials, f"best {min(good):.4g}{unit}" if good else "no trial has ended well yet"


class Trainings(Work):
    """One process' part of a study whose trials are trainings."""

    task: TrainingTask

    def one(self, trial: Trial) -> None:
        """One trial; a training whose numbers ran away, or that the algorithm refuses, is one that failed."""
        task, place = self.task, Path(self.task.folder) / "trials" / f"{trial.number:04d}"
        chosen = task.short(task.settings(trial.number, task.space.suggest(trial)))
        training: Training | None = None
        values: list[float] | None = None
        spent: dict[str, Any] = {}
        try:
            training = self._begun(chosen, place, trial)
            trained = training.finish()
            values, spent = [trained.score], {"best_at": trained.best_at}
            trial.set_constraint("finite", -1.0)
        except optuna.TrialPruned:
            pass
        except Diverged as error:
            values, spent = [goals.FAILED], {"error": str(error)}
            trial.set_constraint("finite", goals.FAR)
        ledger = training.ledger if training else {"simulated_steps": 0, "training_steps": 0, "cpu_seconds": 0.0}
        cost = {key: ledger[key] for key in ("training_steps", "cpu_seconds")}
        self.over(trial, values, steps=ledger["simulated_steps"], **cost, **spent)
        shutil.rmtree(place / "parts", ignore_errors=True)  # the checkpoint, of which there would be many

    def _begun(self, chosen: Settings, place: Path, trial: Trial) -> Training:
        """The trial's training, at its checkpoint if it was interrupted, else at the beginning.

        Raises:
            Diverged: the algorithm refuses this combination of settings.
        """
        task = self.task

        def seen(steps: int, score: float) -> None:
            if not math.isfinite(score):
                raise Diverged(f"the score after {steps} steps is {score}")
            trial.report(score, steps // task.every)
            if trial.number > 0 and steps < task.steps and trial.should_prune():
                raise optuna.TrialPruned

        def begin(resume: bool) -> Training:
            return begun(chosen, place, task.seed, threads=task.threads, resume=resume, seen=seen)

        try:
            return begin(resume=True)
        except InvalidInput:  # a damaged checkpoint, or one of another study, is begun anew
            shutil.rmtree(place, ignore_errors=True)
        try:
            return begin(resume=False)
        except InvalidInput as error:
            raise Diverged(str(error)) from error
