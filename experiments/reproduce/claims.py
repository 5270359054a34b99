"""What a document claims, what a run says of it, and the studies that find out.

A *study* is one experiment about one document: a function from :class:`Trial` to :class:`Findings`, rows and figures.
It is registered under ``document/key`` by :func:`study`, its key being the function's name. The numbers in a row come
out of that run; its verdict follows from them.
"""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import quantile_test

from ...envs.plant.quantity import InvalidInput, did_you_mean

DOCUMENTS = {
    "xi2023": "Xi2023: Z height following, its filters and its calibration",
    "wu": "Wu: sampled position loops of the X and Y axes",
    "huang2024": "Huang2024: B-spline path, dithered spot, cut quality",
    "cn102528288a": "CN102528288A: digital capacitive height controller and its commands",
    "patent2022": "Patent2022: velocity planning and incremental PID",
}
"""The documents, in the order of the page; each has a module of that name here."""

REPRODUCED = "reproduced"
CALIBRATED = "calibrated"
TREND = "trend only"
NOT = "not reproducible as printed"
VERDICTS = {
    REPRODUCED: "the simulation, or the algebra, gives what is printed, from parameters that were not fitted to it",
    CALIBRATED: "free parameters were fitted to this very number, so that it agrees proves nothing",
    TREND: "direction or order agree, the number does not or is not comparable",
    NOT: "what is printed contradicts itself, is incomplete, or is not what this machine does; the note says which",
}
"""The verdicts, best first, and what they mean."""


@dataclass(frozen=True)
class Estimate:
    """A number that a run gave: the median over ``runs`` seeds with its 95 % interval, or one exact figure."""

    value: float
    unit: str = ""
    low: float = np.nan
    high: float = np.nan
    runs: int = 1
    digits: int = 3  # significant

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if np.isnan(self.low):
            return f"{_text(self.value, self.digits)}{unit}"
        return (
            f"{_text(self.value, self.digits)} [{_text(self.low, self.digits)}, {_text(self.high, self.digits)}]{unit}"
        )


def _text(value: float, digits: int) -> str:
    if not np.isfinite(value):
        return "failed"
    text = f"{value:.{digits}g}"
    return (f"{float(text):g}" if "e" in text and 1e-4 <= abs(value) < 1e6 else text).replace("-", "−")


def estimate(values: Sequence[float] | np.ndarray, unit: str = "", digits: int = 3) -> Estimate:
    """Median over seeds with its distribution-free 95 % interval (order statistics); a failed run makes it a failure.

    Args:
        values: one number a seed; with fewer than six there is no interval.
        unit: of the values.
        digits: significant ones in print.
    """
    array = np.asarray(values, float)
    if not np.isfinite(array).all():
        return Estimate(np.nan, unit, runs=len(array), digits=digits)
    middle = float(np.median(array))
    if len(array) < 6 or np.ptp(array) == 0:
        return Estimate(middle, unit, runs=len(array), digits=digits)
    interval = quantile_test(array, p=0.5).confidence_interval(0.95)
    return Estimate(middle, unit, float(interval.low), float(interval.high), len(array), digits)


@dataclass(frozen=True)
class Row:
    """A claim: where it stands, what is printed, what the simulation gives, and what to make of it."""

    where: str  # in the document: "Table 1", "eq. 3", "claim 7"
    claim: str
    paper: str
    simulation: Estimate | str
    verdict: str
    note: str = ""
    true: Estimate | str = ""  # the same of the true gap, where the document's figure is a measured height

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise InvalidInput(f"unknown verdict '{self.verdict}'; {did_you_mean(self.verdict, tuple(VERDICTS))}")


@dataclass(frozen=True)
class Drawing:
    """A figure, its caption (with units and what to see) and what it corresponds to ("Xi2023 Fig. 7")."""

    name: str
    figure: Figure
    caption: str
    source: str


@dataclass(frozen=True)
class Findings:
    """What a study found."""

    rows: list[Row]
    drawings: list[Drawing] = field(default_factory=list)


@dataclass(frozen=True)
class Trial:
    """How a study is run: ``seeds`` independent runs where something is random, ``threads`` worker threads."""

    seeds: int = 24
    threads: int = 1


@dataclass(frozen=True)
class Study:
    """A registered study."""

    document: str
    key: str
    title: str
    run: Callable[[Trial], Findings]

    @property
    def name(self) -> str:
        """``document/key``, as the command takes it."""
        return f"{self.document}/{self.key}"


_studies: dict[str, Study] = {}


def study(document: str, title: str) -> Callable[[Callable[[Trial], Findings]], Callable[[Trial], Findings]]:
    """Registers a function as a study of ``document``; its name, with hyphens, is the study's key."""

    def register(function: Callable[[Trial], Findings]) -> Callable[[Trial], Findings]:
        found = Study(document, function.__name__.replace("_", "-"), title, function)
        _studies[found.name] = found
        return function

    return register


def judged(holds: Any, verdict: str = REPRODUCED, otherwise: str = NOT) -> str:
    """The verdict if what the row claims came out, else ``otherwise``."""
    return verdict if bool(holds) else otherwise


def studies(names: Sequence[str] = ()) -> list[Study]:
    """The studies asked for, in the order of the documents: ``xi2023``, ``xi2023/table-1``; all of them if none is.

    Raises:
        InvalidInput: no document or study of that name.
    """
    for document in DOCUMENTS:
        importlib.import_module(f"{__package__}.{document}")
    known = {s.name: s for document in DOCUMENTS for s in _studies.values() if s.document == document}
    wanted: list[str] = []
    for name in names or DOCUMENTS:
        found = [key for key, s in known.items() if name.lower() in (s.document, key)]
        if not found and name not in DOCUMENTS:
            raise InvalidInput(f"no document or study '{name}'; {did_you_mean(name, (*DOCUMENTS, *known))}")
        wanted += found
    return [known[name] for name in dict.fromkeys(wanted)]
