"""Whether what a study's storage gives back is what we put there: a journal is a text file, and files get edited."""

import sys
from collections.abc import Iterable
from typing import Any

from optuna.trial import FrozenTrial

from ...envs.engine.quantity import InvalidInput
from .space import Axis

_NUMBERS = ("steps", "training_steps", "cpu_seconds", "ms", "ms_steps", "parts", "best_at")
_TEXTS = ("worker", "candidate", "error")


def check(study: Any, where: str) -> None:
    """Looks at every attribute that a search goes on from.

    Raises:
        InvalidInput: one is of another kind than it was written as; with trial, name and value.
    """
    own = study.user_attrs
    if not _whole(own.get("explore", 0)):
        raise InvalidInput(_told(where, "the study", "explore", own["explore"], "a whole number from 0 on"))
    if not isinstance(own.get("cmaes", {}), dict):
        raise InvalidInput(_told(where, "the study", "cmaes", own["cmaes"], "a table of parameters"))
    for trial in study.get_trials(deepcopy=False):
        for name, value, allowed in _odd(trial):
            raise InvalidInput(_told(where, f"trial {trial.number}", name, value, allowed))


def start(found: Any, axes: Iterable[Axis], where: str) -> None:
    """Looks at where CMA-ES begins, as the study or one of its trials has it.

    Raises:
        InvalidInput: it is not on one of the axes.
    """
    for axis in axes:
        value = found.get(axis.name) if isinstance(found, dict) else found
        if axis.choices and value not in axis.choices:
            raise InvalidInput(_told(where, "the study", f"cmaes.{axis.name}", value, ", ".join(axis.choices)))
        if not axis.choices and not _number(value):
            raise InvalidInput(_told(where, "the study", f"cmaes.{axis.name}", value, "a number"))


def points(asked: list[FrozenTrial], size: int, where: str) -> None:
    """Looks at the points that CMA-ES asked for.

    Raises:
        InvalidInput: one has not as many numbers as there are axes.
    """
    for trial in asked:
        found = trial.user_attrs["cmaes"]["point"]
        if len(found) != size:
            raise InvalidInput(_told(where, f"trial {trial.number}", "cmaes.point", found, f"{size} numbers"))


def _odd(trial: FrozenTrial) -> Any:
    """What a trial holds that is of another kind than what was written."""
    attributes = trial.user_attrs
    for name in _NUMBERS:
        if not _number(attributes.get(name, 0)) or attributes.get(name, 0) < 0:
            yield name, attributes[name], "a number from 0 on"
    for name in _TEXTS:
        if not isinstance(attributes.get(name, ""), str):
            yield name, attributes[name], "text"
    worker = attributes.get("worker", "host/1/0")
    if isinstance(worker, str) and (worker.count("/") != 2 or not worker.split("/")[1].isdecimal()):
        yield "worker", worker, "host/process/start"
    asked = attributes.get("cmaes", {"generation": 0, "point": []})
    fits = isinstance(asked, dict) and _whole(asked.get("generation")) and isinstance(asked.get("point"), list)
    if not fits or not all(map(_number, asked["point"])):
        yield "cmaes", asked, "a table of generation and point"
    slopes = attributes.get("slopes", {})
    if not (isinstance(slopes, dict) and all(isinstance(of, list) and all(map(_number, of)) for of in slopes.values())):
        yield "slopes", slopes, "a table of lists of numbers"
    for value in trial.values or ():
        if not _number(value):
            yield "value", value, "a number"
    for value in trial.intermediate_values.values():
        if not _number(value):
            yield "intermediate value", value, "a number"
    for name, value in trial.constraints.items():
        if not _number(value):
            yield f"constraint {name}", value, "a number"


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _told(where: str, what: str, name: str, value: Any, allowed: str) -> str:
    return f"'{where}': {what}: {name} = {str(value)[:80]!r}; allowed: {allowed}; was the file edited?"
