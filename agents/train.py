"""Training of a policy: a run folder that can be killed at any time and goes on where its last checkpoint stands.

::

    runs/<name>/settings.toml         every value that differs from the libraries' defaults
                parts/checkpoint.pt   the last checkpoint, see checkpoint.py
                evaluations.csv       tune seeds, at intervals
                tensorboard/          curves
                policy/               the best policy, as an artefact
"""

import csv
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..envs import scenarios
from ..envs.engine.quantity import InvalidInput
from . import checkpoint
from .evaluation import Evaluation, Evaluator
from .learner import environment, learner
from .settings import Settings

CHECKPOINTS, EVALUATIONS = 50, 10
"""How many of each a training has unless its settings say otherwise."""

CHECKPOINT = Path("parts") / "checkpoint.pt"

CURVES = "tensorboard"

Told = Callable[[int, int, str], None]
"""Is told the steps done, the steps in all, and a word about where training stands."""

Seen = Callable[[int, float], None]
"""Is told the steps done and the score of each evaluation; what it raises ends the training."""


@contextmanager
def curves_are_written(folder: Path) -> Iterator[None]:
    """Curves are written by a thread of its own. What that runs into it raises once more in this one, so it need not
    print it.

    Raises:
        InvalidInput: the disk does not take them.
    """
    before = threading.excepthook

    def hook(arguments: Any) -> None:
        if not isinstance(arguments.exc_value, OSError):
            before(arguments)

    threading.excepthook = hook
    try:
        yield
    except OSError as error:
        raise InvalidInput(
            f"cannot write '{error.filename or folder}': {error.strerror or error}; nothing written before is lost, "
            "and the same command goes on"
        ) from None
    finally:
        threading.excepthook = before


class Diverged(InvalidInput):
    """A training whose numbers ran away; other settings may bear it."""


@dataclass
class Trained:
    """A training that is over; ``model`` holds the best policy."""

    model: Any
    score: float
    best_at: int  # steps
    evaluations: list[dict[str, Any]]
    ledger: dict[str, Any]
    """``simulated_steps`` are of 1 ms; ``training_steps`` and ``evaluation_steps`` the environment's."""


def train(
    settings: Settings,
    folder: Path,
    seed: int = 0,
    device: str = "cpu",
    threads: int = 1,
    resume: bool = False,
    told: Told | None = None,
) -> Trained:
    """Trains a policy and keeps the best one by its score on tune seeds.

    Args:
        settings: what is trained, on what, for how long.
        folder: of the run.
        seed: of everything random.
        device: of torch.
        threads: of torch.
        resume: go on from the folder's checkpoint, if there is one.
        told: shown the progress.

    Raises:
        InvalidInput: settings that the environment or the algorithm refuses, or a checkpoint of another training.
        Diverged: it came to no finite numbers.
    """
    return begun(settings, folder, seed, device, threads, resume, told).finish()


def begun(
    settings: Settings,
    folder: Path,
    seed: int = 0,
    device: str = "cpu",
    threads: int = 1,
    resume: bool = False,
    told: Told | None = None,
    seen: Seen | None = None,
) -> "Training":
    """A training that stands at its beginning or, with ``resume``, at its last checkpoint; see :func:`train`.

    Args:
        settings, folder, seed, device, threads, resume, told: as for :func:`train`.
        seen: shown every evaluation.
    """
    model = untrained(settings, seed, device, threads)
    run = Training(settings, folder, seed, model, Evaluator(settings), told or (lambda *_: None))
    run.seen = seen or run.seen
    if resume and (folder / CHECKPOINT).is_file():
        run.take_up(checkpoint.read(folder / CHECKPOINT, device))
    return run


def untrained(settings: Settings, seed: int = 0, device: str = "cpu", threads: int = 1) -> Any:
    """The model that a training begins with, on its environment; see :func:`train`.

    Raises:
        InvalidInput: anything that no training could be made of.
    """
    import torch

    if seed < 0:
        raise InvalidInput(f"seed = {seed}; a whole number from 0 on")
    if threads < 1:
        raise InvalidInput(f"threads = {threads}; a whole number, at least 1")
    torch.set_num_threads(threads)
    return learner(settings, environment(settings), seed, device)


class Training:
    """What a training knows besides its model: the best policy so far, and what has been spent."""

    def __init__(
        self, settings: Settings, folder: Path, seed: int, model: Any, evaluator: Evaluator, told: Told
    ) -> None:
        self.settings, self.folder, self.seed, self.model = settings, folder, seed, model
        self.evaluator, self.told = evaluator, told
        self.seen: Seen = lambda *_: None
        self.keep_every = settings.checkpoint.get("every", max(settings.steps // CHECKPOINTS, 1))
        self.look_every = settings.evaluation.get("every", max(settings.steps // EVALUATIONS, 1))
        self.rows: list[dict[str, Any]] = []
        self.best: dict[str, Any] = {"score": float("inf"), "steps": 0, "policy": {}}
        self.spent, self.began, self.looked, self.looking = 0.0, time.process_time(), 0, 0

    def take_up(self, content: dict[str, Any]) -> None:
        """Goes on from a checkpoint.

        Raises:
            InvalidInput: it is of another training, or does not hold what one holds.
        """
        try:
            self._take_up(content)
        except InvalidInput:
            raise
        except (KeyError, TypeError, AttributeError, ValueError, RuntimeError) as error:
            what = f"{type(error).__name__}: {error}".split("\n")[0][:160]
            raise InvalidInput(f"the checkpoint in '{self.folder}' does not fit its training: {what}") from None

    def _take_up(self, content: dict[str, Any]) -> None:
        mine, theirs = self.identity(), content["identity"]
        for key in sorted({*mine, *theirs}):
            if mine.get(key) != theirs.get(key):
                raise InvalidInput(
                    f"'{self.folder}' was trained with {key} = {theirs.get(key)}, not {mine.get(key)}; "
                    "use the same command, or another --name"
                )
        checkpoint.put_state(self.model, content["model"])
        self.best, self.rows, self.spent = content["best"], content["rows"], content["cpu_seconds"]
        self.looked, self.looking = content["looked"], content["evaluation_steps"]

    def identity(self) -> dict[str, Any]:
        """What must not change between two parts of a training."""
        return {"seed": self.seed, **{key: repr(value) for key, value in self.settings.flat().items()}}

    def finish(self) -> Trained:
        """Trains to the end.

        Raises:
            Diverged: the weights, or every evaluation, came to no finite numbers.
            InvalidInput: the disk does not take checkpoint, curves or table; what was written before is not lost.
        """
        with curves_are_written(self.folder / CURVES):
            return self._finish()

    def _finish(self) -> Trained:
        from stable_baselines3.common.logger import configure

        model, steps = self.model, self.settings.steps
        model.set_logger(configure(str(self.folder / CURVES), ["tensorboard"]))
        if model.num_timesteps < steps:
            try:
                model.learn(steps - model.num_timesteps, callback=self._callback(), reset_num_timesteps=False)
                self.look()
            except (ValueError, RuntimeError) as error:  # libraries and environments have words of their own for it
                if self.finite:
                    raise
                raise self.diverged() from error
            self.keep()
        if not math.isfinite(self.best["score"]):
            raise self.diverged()
        model.policy.load_state_dict(self.best["policy"])
        self._table()
        return Trained(model, self.best["score"], self.best["steps"], self.rows, self.ledger)

    @property
    def finite(self) -> bool:
        """Whether all weights, and the spread of the actions, are still numbers."""
        weights = self.model.policy.state_dict()
        checked = [value.exp().log() if name == "log_std" else value for name, value in weights.items()]
        return all(bool(value.isfinite().all()) for value in checked)

    def diverged(self) -> Diverged:
        """The error of a training whose numbers ran away."""
        return Diverged(
            f"the training came to no finite numbers within {self.model.num_timesteps} steps; "
            "a smaller algorithm.learning_rate may bear it"
        )

    @property
    def ledger(self) -> dict[str, Any]:
        """What has been spent so far."""
        return {
            "simulated_steps": self.evaluator.env.batch.task.period * (self.model.num_timesteps + self.looking),
            "training_steps": self.model.num_timesteps,
            "evaluation_steps": self.looking,
            "cpu_seconds": round(self.cpu_seconds, 1),
            "seeds": {"train": f"from {scenarios.SPLITS['train'].start}", "tune": f"0-{self.evaluator.episodes - 1}"},
        }

    @property
    def cpu_seconds(self) -> float:
        """CPU time so far, evaluations included."""
        return self.spent + time.process_time() - self.began

    def keep(self) -> None:
        """Writes a checkpoint."""
        kept = {"identity": self.identity(), "model": checkpoint.state_of(self.model), "best": self.best}
        spent = {"cpu_seconds": self.cpu_seconds, "looked": self.looked, "evaluation_steps": self.looking}
        checkpoint.write(self.folder / CHECKPOINT, kept | {"rows": self.rows} | spent)

    def look(self) -> Evaluation:
        """Evaluates the policy; the best one is kept."""
        seen, model = self.evaluator(self.model), self.model
        self.looked, self.looking = model.num_timesteps, self.looking + seen.steps
        row = {"steps": model.num_timesteps, "cpu_seconds": round(self.cpu_seconds, 1), "score": seen.score}
        row |= {"mean_return": seen.mean_return, "collisions": int(seen.collisions), **seen.scenarios}
        self.rows.append(row)
        for key, value in {"score": seen.score, "mean_return": seen.mean_return, **seen.scenarios}.items():
            model.logger.record(f"tune/{key}", value)
        model.logger.dump(model.num_timesteps)
        if seen.score < self.best["score"]:
            policy = {name: value.detach().clone() for name, value in model.policy.state_dict().items()}
            self.best = {"score": seen.score, "steps": model.num_timesteps, "policy": policy}
        self._table()
        self.seen(model.num_timesteps, seen.score)
        return seen

    def show(self) -> None:
        """Tells how far the training is."""
        score = f"best {self.best['score']:.2f}" if self.rows else "not evaluated yet"
        self.told(min(self.model.num_timesteps, self.settings.steps), self.settings.steps, score)

    def _callback(self) -> Any:
        from stable_baselines3.common.callbacks import BaseCallback

        run, last = self, [-1]

        class Between(BaseCallback):
            """At the beginning of a roll-out networks and optimisers rest, so that is when checkpoints are made."""

            def _on_rollout_start(self) -> None:
                done = self.model.num_timesteps
                run.show()
                if last[0] >= 0 and done - run.looked >= run.look_every:
                    run.look()  # changes nothing in the training
                if last[0] >= 0 and done - last[0] < run.keep_every:
                    return
                if last[0] >= 0:
                    run.keep()
                checkpoint.restart(self.model, run.seed)
                last[0] = done

            def _on_step(self) -> bool:
                return True

        return Between()

    def _table(self) -> None:
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        with checkpoint.replaced(self.folder / "evaluations.csv") as part, part.open("w", newline="") as file:
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            writer.writerows(self.rows)
