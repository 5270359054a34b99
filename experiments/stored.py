"""What ``run.json`` may hold: its keys and their kinds, checked before anything is made of them.

A record that somebody else wrote, or edited, is data: a key of the wrong kind is an error with its place. Names in it
never lead out of the run's folder (:mod:`archive`).
"""

import functools
from typing import Any, Literal

from typing_extensions import TypedDict  # as pydantic wants it below Python 3.12

from ..envs import job_metrics, names, secrets
from ..envs.engine.quantity import InvalidInput, did_you_mean
from ..envs.metrics import METRICS
from ..envs.stack import recorded

Words = dict[str, str]


class GridRecord(TypedDict, total=False):
    """Of a suite."""

    kind: Literal["following", "jobs"]
    folder: str
    tables: Words
    scenarios: list[str]
    controllers: list[str]
    core: list[str]
    exempt: list[str]
    summaries: Words
    metric: str | None
    reference: str | None
    labels: list[str]
    materials: list[tuple[str, float | None]]
    seeds: str
    seed_count: int
    ledger: dict[str, dict[str, Any]]
    tuning: dict[str, dict[str, Any]] | None
    programs: Words | None
    parameters: dict[str, dict[str, float | str]] | None
    decisions: dict[str, dict[str, float | None]] | None
    bounds: dict[str, float] | None
    machines: dict[str, list[str]] | None


class RunRecord(GridRecord, total=False):
    """Of the run; the first format had the only suite's keys among its own."""

    format: int
    command: str | list[str] | None
    kerfgym: str | None
    git: dict[str, Any] | None
    python: str
    packages: Words
    machine: dict[str, Any] | None
    wall_seconds: float
    kernel: str | None
    notes: list[str]
    runs: dict[str, dict[str, Any]]
    grids: Any  # each is looked at by itself, for one that is wrong does not hide the others


@functools.cache
def _validator(kind: Any) -> Any:
    from pydantic import ConfigDict, TypeAdapter

    kind.__pydantic_config__ = ConfigDict(extra="allow", strict=False)
    return TypeAdapter(kind)


def _checked(kind: Any, data: Any, where: str) -> dict[str, Any]:
    from pydantic import ValidationError

    try:
        _validator(kind).validate_python(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(key) for key in first["loc"])
        raise InvalidInput(f"{where}: {f'{place}: ' * bool(place)}{first['msg']}") from None
    found: dict[str, Any] = secrets.everywhere(data)
    return found


def run(data: Any, where: str) -> dict[str, Any]:
    """The record of a run as it was stored, without passwords.

    Raises:
        InvalidInput: it is none, or a key is of the wrong kind; with its place.
    """
    return _checked(RunRecord, data, where)


def grid(data: Any, suite: str, where: str) -> dict[str, Any]:
    """The record of one suite.

    Raises:
        InvalidInput: as :func:`run`; also an unknown metric, or a provenance that is none.
    """
    found = _checked(GridRecord, data, where)
    names.checked(suite.replace("/", "_"), f"{where}: suite")
    for name, record in (found.get("tuning") or {}).items():
        recorded(record, f"{where}: tuning.{name}")
    metric = found.get("metric")
    known = {**METRICS, **job_metrics.METRICS}
    if metric is not None and metric not in known:
        raise InvalidInput(f"{where}: unknown metric '{metric}'; {did_you_mean(metric, known)}")
    return found
