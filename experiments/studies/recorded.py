"""Recorded results: ``docs/results/<study>.json``, small and readable, in the repository."""

from pathlib import Path
from typing import Any

from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.safety import files
from ..store import runs
from ..store.plain import plain
from ..store.stamp import ROOT

FOLDER = ROOT / "docs" / "results"


def file(study: str) -> Path:
    """Where a study's results stand."""
    return FOLDER / f"{study}.json"


def read(study: str) -> dict[str, Any] | None:
    """A study's results; None if it was never run.

    Raises:
        InvalidInput: the file cannot be read.
    """
    path = file(study)
    if not path.is_file():
        return None
    found = files.json_(path)
    if not isinstance(found, dict) or not {"study", "numbers", "depends"} <= set(found):
        raise InvalidInput(f"'{path}' is not the record of a study: it lacks study, numbers or depends")
    return found


def write(study: str, body: dict[str, Any]) -> Path:
    """Stores a study's results."""
    runs.write_json(file(study), plain(body))
    return file(study)


def number(path: str) -> Any:
    """One recorded value by study and keys, ``following.self-tuning.score``; None if the study was never run.

    Raises:
        InvalidInput: the study has no such value; the nearest key is named.
    """
    study, *keys = path.split(".")
    found = read(study)
    if found is None:
        return None
    value, gone = found["numbers"], study
    for key in keys:
        if not isinstance(value, dict) or key not in value:
            known = list(value) if isinstance(value, dict) else []
            hint = f"; {did_you_mean(key, known)}" if known else ""
            raise InvalidInput(f"results of '{gone}' have no '{key}'{hint}")
        value, gone = value[key], f"{gone}.{key}"
    if isinstance(value, dict | list):
        raise InvalidInput(f"'{path}' is a table, not a number")
    return value


def differences(before: dict[str, Any] | None, after: dict[str, Any], share: float = 0.01) -> tuple[int, int]:
    """How many values the new numbers have, and how many of them are new or differ by more than ``share``."""
    old, new = (dict(_flat(each)) for each in ((before or {}).get("numbers", {}), after["numbers"]))
    moved = 0
    for key, value in new.items():
        was = old.get(key)
        if isinstance(value, int | float) and isinstance(was, int | float):
            moved += abs(value - was) > share * max(abs(value), abs(was))
        else:
            moved += key not in old or value != was
    return len(new), moved


def _flat(value: Any, path: str = "") -> Any:
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _flat(each, f"{path}.{key}")
    elif isinstance(value, list):
        for i, each in enumerate(value):
            yield from _flat(each, f"{path}.{i}")
    else:
        yield path, value


def origin() -> dict[str, Any]:
    """Commit, its date, and whether sources were changed since; what this script itself writes does not count."""
    commit = runs.git("rev-parse", "HEAD")
    if not commit:
        return {}
    dirty = runs.git("status", "--porcelain", "-uno", "--", ".", ":!docs", ":!README.md", ":!CHANGELOG.md")
    return {"commit": commit, "committed": runs.git("show", "-s", "--format=%cs", "HEAD"), "changed": bool(dirty)}
