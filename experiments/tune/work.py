"""The trials of a study: which are over, under way, abandoned or still to come, and the work of one process."""

import math
import os
import socket
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import optuna
from optuna.trial import FrozenTrial, Trial, TrialState

from ...envs.engine.quantity import InvalidInput
from . import goals, sampling, storage
from .space import Space

STALE = 60.0
"""s after which a running trial that nobody has signed counts as abandoned."""

WORKER = "worker"


@dataclass(frozen=True, kw_only=True)
class Search(ABC):
    """What a study depends on and does, whatever its trials are.

    Attributes:
        sampler, trials, seed: of the study, as the user gave them.
        budget: simulated steps in all, after which no trial is begun; 0: any number.
        name: of the study.
        url: of its storage.
        folder: of the run, once there is one.
        directions: of each value, ``minimize`` or ``maximize``.
        counted: options that are at least 1.
        packages: on which the result depends, besides those of every run.
    """

    sampler: str = "tpe+cmaes"
    trials: int = 300
    seed: int = 0
    name: str = ""
    url: str = ""
    folder: str = ""
    budget: int = 0
    counted: ClassVar[tuple[str, ...]] = ("trials",)
    packages: ClassVar[tuple[str, ...]]

    @property
    def directions(self) -> list[str]:
        """For each value."""
        return ["minimize"]

    @property
    def expected(self) -> int:
        """Trials that there will be, if none is pruned."""
        return self.trials

    @property
    def explored(self) -> int:
        """Trials before another sampler takes over."""
        return sampling.explored(self.expected, self.space) if self.sampler == "tpe+cmaes" else 1

    @property
    @abstractmethod
    def space(self) -> Space:
        """What is searched."""

    @property
    @abstractmethod
    def words(self) -> list[str]:
        """What the trials depend on; of two studies that differ in a word, one cannot go on as the other."""

    @abstractmethod
    def samplers(self, explore: int) -> tuple[Any, Any]:
        """Sampler and pruner; ``explore`` trials come before CMA-ES takes over."""

    @abstractmethod
    def work(self, threads: int, study: Any = None) -> Any:
        """One process' part of it, a :class:`Work`."""

    @abstractmethod
    def state(self, study: Any) -> tuple[int, int, str]:
        """How many trials are over, of how many, and the best value."""

    def check(self, workers: int = 1) -> None:
        """Raises :class:`InvalidInput` for anything that the study could not be made of, before anything is written."""
        for option, value in (*((each, getattr(self, each)) for each in self.counted), ("workers", workers)):
            if value < 1:
                raise InvalidInput(f"--{option} {value} is out of range; at least 1")

    def open(self) -> Any:
        """The study, made if there is none; with its sampler and pruner.

        Raises:
            InvalidInput: the storage cannot be used, or holds another study of this name.
        """
        explore = self.explored
        study = storage.study_of(self.url, self.name, self.directions, self.words, {"explore": explore})
        study.sampler, study.pruner = self.samplers(study.user_attrs.get("explore", explore))
        return study


def done(study: Any) -> list[FrozenTrial]:
    """The trials that are over, in order; failed ones do not count."""
    return [t for t in study.get_trials(deepcopy=False) if t.state in (TrialState.COMPLETE, TrialState.PRUNED)]


def me() -> str:
    """This process, as a trial's signature."""
    return f"{socket.gethostname()}/{os.getpid()}/{_born(os.getpid())}"


def abandoned(study: Any, exclusive: bool) -> list[FrozenTrial]:
    """Running trials whose process is gone; with an exclusive study, all of them."""
    return [
        t
        for t in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
        if exclusive or _gone(t.user_attrs.get(WORKER), t)
    ]


def _gone(signature: str | None, trial: FrozenTrial) -> bool:
    if signature is None:
        return time.time() - trial.datetime_start.timestamp() > STALE if trial.datetime_start else True
    host, pid, born = signature.split("/")
    return host == socket.gethostname() and _born(int(pid)) != born


def _born(pid: int) -> str:
    """When a process started, since numbers of processes come again; empty if there is none."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rsplit(")", 1)[1].split()[19]
    except OSError:
        pass
    try:
        os.kill(pid, 0)
    except OSError:
        return ""
    return "alive"


def steps_of(trials: list[FrozenTrial]) -> int:
    """Simulated steps that trials took."""
    return sum(t.user_attrs.get("steps", 0) for t in trials)


def claim(study: Any, trials: int, budget: int = 0) -> Trial | None:
    """A new trial, or none if as many are over or under way as were asked for, or the budget of steps is spent."""
    alive = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.RUNNING)
    if budget and steps_of(done(study)) >= budget:
        return None
    if len(study.get_trials(deepcopy=False, states=alive)) >= trials:
        return None
    trial = study.ask()
    study._storage.set_trial_user_attr(trial._trial_id, WORKER, me())
    ahead = [t for t in study.get_trials(deepcopy=False, states=alive) if t.number < trial.number]
    if len(ahead) >= trials:  # another process was quicker
        study.tell(trial, state=TrialState.FAIL)
        return None
    return trial


def feasible(trial: FrozenTrial) -> bool:
    """Whether a trial was completed and keeps its limits."""
    return trial.state == TrialState.COMPLETE and all(v <= 0 for v in trial.constraints.values())


class Work(ABC):
    """One process' part of a study."""

    def __init__(self, task: Any, study: Any = None) -> None:
        self.task, self.study = task, study if study is not None else task.open()

    @abstractmethod
    def one(self, trial: Trial) -> None:
        """One trial from candidate to value, told with :meth:`over`."""

    def run(self, resume: list[FrozenTrial], told: Callable[[], None] = lambda: None) -> None:
        """Finishes abandoned trials, then makes new ones until enough are over."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for stale in resume:
                self.study._storage.set_trial_user_attr(stale._trial_id, WORKER, me())
                self.one(Trial(self.study, stale._trial_id))
                told()
            while (trial := claim(self.study, self.task.trials, self.task.budget)) is not None:
                self.one(trial)
                told()

    def over(self, trial: Trial, values: list[float] | None, **attributes: Any) -> None:
        """Tells the study how a trial ended; without values it was pruned."""
        try:
            for name, value in attributes.items():
                trial.set_user_attr(name, value)
            if values is None:
                self.study.tell(trial, state=TrialState.PRUNED)
            else:
                self.study.tell(trial, values)
        except (ValueError, optuna.exceptions.UpdateFinishedTrialError):
            state = self.study._storage.get_trial(trial._trial_id).state
            if not state.is_finished():
                raise  # otherwise another process that took it over was quicker, and found the same


def told_number(value: float) -> float:
    """``value``, or the mark of failure if it is none; storages take no NaN."""
    return value if math.isfinite(value) else goals.FAILED
