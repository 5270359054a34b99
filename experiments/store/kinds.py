"""What ``run.json`` may hold: its keys and their kinds, checked before anything is made of them.

A record that somebody else wrote, or edited, is data: a key of the wrong kind is an error with its place. Names in it
never lead out of the run's folder (:mod:`archive`).
"""

from typing import Annotated, Any, Literal

from pydantic import Strict
from typing_extensions import TypedDict  # as pydantic wants it below Python 3.12

from ...envs.control.stack import recorded
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.figures import job_metrics
from ...envs.figures.metrics import METRICS
from ...envs.safety import files, names, secrets

Words = dict[str, str]
Numbers = dict[str, float]


class Commit(TypedDict, total=False):
    """Of the package's checkout."""

    commit: str | None
    changed: bool


class Computer(TypedDict, total=False):
    """On which it was run."""

    system: str
    processor: str | None
    cores: int | None


class Cost(TypedDict, total=False):
    """Of a controller in the run."""

    simulated_steps: int
    cpu_seconds: float


class CutBy(TypedDict, total=False):
    """The machine that the scenarios were put on."""

    name: str
    summary: str
    digest: str
    replaces: list[str]


class Settings(TypedDict):
    """What a controller is to be set to."""

    of: str
    policy: bool
    rows: list[Annotated[tuple[str, str, str, str], Strict(False)]]


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
    materials: list[Annotated[tuple[str, float], Strict(False)]]  # in JSON it is a list
    seeds: str
    seed_count: int
    plates: list[float]
    corners: list[str]
    ledger: dict[str, Cost]
    tuning: dict[str, dict[str, Any]] | None
    programs: Words | None
    parameters: dict[str, dict[str, float | str]] | None
    settings: dict[str, Settings] | None
    decisions: dict[str, dict[str, float | None]] | None
    bounds: Numbers | None
    linear: Numbers | None
    machines: dict[str, list[str]] | None
    cut_by: CutBy | None


class RunRecord(GridRecord, total=False):
    """Of the run; the first format had the only suite's keys among its own."""

    format: int
    command: str | list[str] | None
    kerfgym: str | None
    git: Commit | None
    python: str
    packages: Words
    machine: Computer | None
    wall_seconds: float
    kernel: str | None
    notes: list[str]
    runs: dict[str, dict[str, Any]]
    grids: Any  # each is looked at by itself, for one that is wrong does not hide the others


def _checked(kind: Any, data: Any, where: str) -> dict[str, Any]:
    files.fitting(kind, data, where)
    found: dict[str, Any] = secrets.everywhere(data)
    for name, record in (found.get("tuning") or {}).items():
        recorded(record, f"{where}: tuning.{name}")
    return found


def run(data: Any, where: str) -> dict[str, Any]:
    """The record of a run as it was stored, without passwords.

    Raises:
        InvalidInput: it is none, a key is of the wrong kind, or a provenance is none; with its place.
    """
    return _checked(RunRecord, data, where)


def grid(data: Any, suite: str, where: str) -> dict[str, Any]:
    """The record of one suite.

    Raises:
        InvalidInput: as :func:`run`; also an unknown metric, or jobs without one.
    """
    found = _checked(GridRecord, data, where)
    names.checked(suite.replace("/", "_"), f"{where}: suite")
    metric = found.get("metric")
    known = {**METRICS, **job_metrics.METRICS}
    for key in ("metric", "reference"):
        if found.get("kind") == "jobs" and found.get(key) is None:
            raise InvalidInput(f"{where}: '{key}' is missing; jobs are ranked by a metric, beside a reference")
    if metric is not None and metric not in known:
        raise InvalidInput(f"{where}: unknown metric '{metric}'; {did_you_mean(metric, known)}")
    return found
