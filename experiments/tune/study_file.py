"""Study files: searches of several controllers by one protocol, as TOML, for ``kerfgym tune --study FILE``.

docs/tuning.md has the keys. Shipped ones lie in ``tune/studies/`` and go by their names; they made the presets.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.safety import consent, files, names
from .evaluate import with_jobs
from .goals import Limit, Limits
from .rules import RULES
from .space import space
from .staged import Stage
from .study import Task, controller

SHIPPED = Path(__file__).parent / "studies"
"""Studies that go by their names."""


_PLAIN = ("sampler", "seed", "digits", "fresh", "relative", "criterion")
"""Keys of a search that a task takes as they are."""


class _Stage(TypedDict, total=False):
    sampler: str
    weight: float
    spread: float
    anew: bool


class _Final(TypedDict, total=False):
    best: int
    seeds: int


class _Search(TypedDict, total=False):
    criterion: str
    controller: str
    fresh: bool
    set: dict[str, float | dict[str, float]]
    suite: str
    what: list[str]
    ranges: dict[str, list[float]]
    metric: str | list[str]
    relative: str
    ms: float | list[float]
    limits: dict[str, float]
    sampler: str
    trials: int
    digits: int
    seed: int
    seeds: int
    also: list[dict[str, float]]
    stage: list[_Stage]
    final: _Final


class _Study(_Search, total=False):
    like: str
    without: list[str]
    presets: bool
    search: dict[str, _Search]


@dataclass(frozen=True)
class Study:
    """What a study file asks for.

    Attributes:
        name: of a shipped study, or its file.
        searches: by name, which is that of the preset or of the controller, with the cap on Ms behind it where the file
            asks for several.
        presets: whether the package's presets are written.
    """

    name: str
    searches: dict[str, Task]
    presets: bool = False


def shipped() -> tuple[str, ...]:
    """Names of the studies that are shipped."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


def read(word: str, only: tuple[str, ...] = (), trials: int | None = None) -> Study:
    """A study, by the name of a shipped one or by its file.

    Args:
        word: name or file.
        only: the searches wanted; all unless told otherwise.
        trials: of each search, in place of the file's.

    Raises:
        InvalidInput: no such study, or its file does not say what can be carried out; with the nearest valid name.
    """
    path, data = _loaded(word)
    each = data.get("search", {})
    if not each:
        raise InvalidInput(f"{path}: no search; it needs a table such as [search.pid]")
    for name in (*only, *data.get("without", [])):
        if name not in each:
            raise InvalidInput(f"{path}: unknown search '{name}'; {did_you_mean(name, each)}")
    if data.get("presets") and path.parent != SHIPPED:
        raise InvalidInput(f"{path}: presets: those of the package are made by its own studies")
    found: dict[str, Task] = {}
    for name in only or [name for name in each if name not in data.get("without", [])]:
        names.checked(name, f"{path}: search")
        body = {"controller": name, **data, **each[name]}
        for spec in (body["controller"], body.get("relative", "")):
            consent.required(spec, f"{path}: search.{name}")
        caps = body.get("ms", math.inf)
        for ms in caps if isinstance(caps, list) else [caps]:
            key = f"{name}-ms-{ms:g}" if isinstance(caps, list) else name
            found[key] = _task(path, name, body, float(ms), trials)
    return Study(word, found, data.get("presets", False))


def _loaded(word: str) -> tuple[Path, dict[str, Any]]:
    """A study's file, and what it says beside what the one says that it is like."""
    path = SHIPPED / f"{word}.toml" if word in shipped() else Path(word)
    if path.suffix != ".toml":
        raise InvalidInput(f"unknown study '{word}'; {did_you_mean(word, shipped())}, or a path to a TOML file")
    data = files.toml(path)
    files.fitting(_Study, data, path)
    _check(_Study, data, str(path))
    for name, body in data.get("search", {}).items():
        _check(_Search, body, f"{path}: search.{name}")
    if "like" not in data:
        return path, data
    if data["like"] not in shipped():
        raise InvalidInput(f"{path}: like: no shipped study '{data['like']}'; {did_you_mean(data['like'], shipped())}")
    return path, {**_loaded(data["like"])[1], "presets": False, **data}


def _check(kind: Any, found: dict[str, Any], where: str) -> None:
    """Whether there are only keys of this kind, in stages and the final check as well."""
    for key in found:
        if key not in kind.__annotations__:
            raise InvalidInput(f"{where}: unknown key '{key}'; {did_you_mean(key, kind.__annotations__)}")
    for i, stage in enumerate(found.get("stage", [])):
        _check(_Stage, stage, f"{where}: stage[{i}]")
        if not stage.get("spread", 1.0) > 0:
            raise InvalidInput(f"{where}: stage[{i}]: spread is above 0")
    if "final" in found:
        _check(_Final, found["final"], f"{where}: final")


def _number(key: str, given: Any, searched: set[str]) -> float:
    """A parameter that a file sets: a number, or a rule with what it is given.

    Raises:
        InvalidInput: no such rule.
    """
    if not isinstance(given, dict):
        return float(given)
    rule, of = next(iter(given.items()), ("", 0.0))
    if len(given) != 1 or rule not in RULES:
        raise InvalidInput(f"set: {key} = {given}: no such rule; {did_you_mean(rule, RULES)}")
    try:
        found = RULES[rule](of)
    except ArithmeticError:
        found = math.nan
    if not math.isfinite(found):
        raise InvalidInput(f"set: {key} = {given}: {rule} of {of:g} is no number")
    return found if key in searched else float(f"{found:.5g}")


def _metrics(given: str | list[str]) -> tuple[str, ...]:
    """One metric, or several of which a front is sought."""
    return (given,) if isinstance(given, str) else tuple(given)


def _task(path: Path, name: str, body: dict[str, Any], ms: float, trials: int | None) -> Task:
    """One search; what its own table says stands before what the file says of all.

    Raises:
        InvalidInput: it cannot be made; with file and search.
    """
    try:
        suite, final = body.get("suite", "following"), body.get("final", {})
        scenarios.suite(suite)
        words = tuple(body.get("what", ["law"]))
        base = controller(body["controller"])
        searched = {axis.name for axis in space(base, words).axes}
        for key, ends in body.get("ranges", {}).items():
            if key not in base.parameters():
                raise InvalidInput(f"ranges: unknown parameter '{key}'; {did_you_mean(key, base.parameters())}")
            if len(ends) != 2:
                raise InvalidInput(f"ranges: {key} = {ends}; a range has two ends, [low, high]")
            if key in searched:
                words = (*words, f"{key}={ends[0]!r}..{ends[1]!r}")
        plain: dict[str, Any] = {key: body.get(key) for key in _PLAIN if key in body}
        return Task(
            body["controller"],
            words,
            suite,
            _metrics(body.get("metric") or str(scenarios.rules(suite).get("score", "rms_true"))),
            Limits(ms, tuple(Limit(key, most) for key, most in body.get("limits", {}).items())),
            body.get("seeds", 8 if with_jobs(suite) else 32),
            trials=trials if trials is not None else body.get("trials", 300),
            stages=tuple(Stage(**stage) for stage in body.get("stage", [])),
            also=tuple(tuple(changes.items()) for changes in body.get("also", [])),
            finalists=final.get("best", 0),
            final_seeds=final.get("seeds", 200),
            set=tuple((key, _number(key, value, searched)) for key, value in body.get("set", {}).items()),
            **plain,
        )
    except (InvalidInput, TypeError) as error:
        raise InvalidInput(f"{path}: search.{name}: {error}") from None
