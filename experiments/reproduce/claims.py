"""What a document claims, what a run says of it, and the studies that find out.

A *study* is one experiment about one document: a function that adds :class:`Rows` in a :class:`Trial` and gives its
drawings. It is registered under ``document/key`` by :func:`study`, its key being the function's name. The numbers in a
row come out of that run; its verdict follows from them.
"""

import importlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import quantile_test

from ...envs.engine.quantity import InvalidInput, check_choice, did_you_mean
from ...envs.safety import files
from .pictures import Drawing
from .verdicts import FAILS, NAMED, PRESENT, REPRODUCED, SILENT, TREND, VERDICTS

DOCUMENTS = {
    "xi2023": "Xi2023: Z height following, its filters and its calibration",
    "wu": "Wu: sampled position loops of the X and Y axes",
    "huang2024": "Huang2024: B-spline path, dithered spot, cut quality",
    "cn102528288a": "CN102528288A: digital capacitive height controller and its commands",
    "patent2022": "Patent2022: velocity planning and incremental PID",
}
"""The documents, in the order of the page; each has a module of that name here."""


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
        value, low, high = (_text(each, self.digits) for each in (self.value, self.low, self.high))
        return f"{value} [{low}, {high}]{unit}"


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
class Evidence:
    """Three errors by one measure: the run's from what is printed, the largest that counts as agreement, and that of a
    predictor which knows nothing of the matter. Agreement says something only if that one misses.

    Raises:
        InvalidInput: no measure or trivial predictor is named, or tolerance or trivial error are no numbers.
    """

    measure: str  # what is compared, with its unit: "largest difference, Hz"
    error: float
    tolerance: float
    trivial: str  # "a straight line between the fitted points"
    trivial_error: float

    def __post_init__(self) -> None:
        if not self.measure or not self.trivial:
            raise InvalidInput("evidence needs a measure and the name of a trivial predictor")
        if not (np.isfinite(self.tolerance) and self.tolerance >= 0) or np.isnan(self.trivial_error):
            raise InvalidInput(
                f"evidence on {self.measure}: tolerance {self.tolerance}, trivial error {self.trivial_error}; "
                "the first must be a number from 0 on, the second may be infinite"
            )

    @property
    def met(self) -> bool:
        """Whether the run lies within the tolerance; a failed run does not."""
        return bool(abs(self.error) <= self.tolerance)

    @property
    def telling(self) -> bool:
        """Whether the trivial predictor lies outside it."""
        return bool(abs(self.trivial_error) > self.tolerance)

    def __str__(self) -> str:
        error, tolerance, trivial = (_text(v, 2) for v in (self.error, self.tolerance, self.trivial_error))
        return f"{self.measure}: {error}, at most {tolerance}; {self.trivial}: {trivial}"


@dataclass(frozen=True)
class Row:
    """A claim: where it stands, what is printed, what the simulation gives, and what to make of it.

    A row is *reproduced* only with evidence that is met and telling, behind a printed figure or claim (``paper``) that
    stands somewhere (``where``), by the document's own method. Where nothing is printed to compare with, ``paper``
    begins with "named" or "not mentioned", and the row is *present* or does not hold.

    Raises:
        InvalidInput: the verdict is unknown or goes beyond what the row has to show.
    """

    where: str  # in the document: "Table 1", "eq. 3", "claim 7"
    claim: str
    paper: str  # the printed figure, or the claim in the document's words
    simulation: Estimate | str
    verdict: str
    note: str = ""
    true: Estimate | str = ""  # the same of the true gap, where the document's figure is a measured height
    evidence: Evidence | None = None
    instead: str = ""  # what was run in place of the document's own method

    def __post_init__(self) -> None:
        check_choice(self.verdict, VERDICTS, "verdict")
        if wrong := self._overreach():
            raise InvalidInput(f"row '{self.claim}' can't be '{self.verdict}': {wrong}")

    @property
    def printed(self) -> bool:
        """Whether the document has a figure or a claim to compare with."""
        return bool(self.paper.strip(" –-")) and not self.paper.startswith((NAMED, SILENT))

    def _overreach(self) -> str:
        """What the verdict claims without ground, or nothing."""
        if self.verdict == REPRODUCED:
            if not self.where or not self.printed:
                return f"nothing is printed to reproduce (where '{self.where}', paper '{self.paper}')"
            if self.instead:
                return f"{self.instead} is not the document's method"
            if self.evidence is None:
                return "it has no evidence: an error, a tolerance, and a trivial predictor's error"
            if not (self.evidence.met and self.evidence.telling):
                return f"its evidence does not bear it: {self.evidence}"
        elif self.verdict == PRESENT and self.printed:
            return f"it is for what is only '{NAMED}' or '{SILENT}'; the column of the paper says '{self.paper}'"
        elif not self.printed and self.verdict not in (PRESENT, FAILS):
            return f"nothing is printed ('{self.paper}'); it can be '{PRESENT}' or '{FAILS}'"
        return ""


def judged(holds: Any, verdict: str, otherwise: str = FAILS) -> str:
    """The verdict if what the row claims came out, else ``otherwise``.

    Raises:
        InvalidInput: the verdict is *reproduced*, which takes evidence, see :func:`weighed`.
    """
    if REPRODUCED in (verdict, otherwise):
        raise InvalidInput(f"'{REPRODUCED}' follows from evidence alone; use weighed()")
    return verdict if bool(holds) else otherwise


def weighed(
    where: str,
    claim: str,
    paper: str,
    simulation: Estimate | str,
    evidence: Evidence,
    note: str = "",
    true: Estimate | str = "",
    otherwise: str = FAILS,
    instead: str = "",
) -> Row:
    """A row whose verdict follows from its evidence.

    *Reproduced* if the run lies within the tolerance and the trivial predictor does not; *trend only* if both do, or if
    another method than the document's was run; ``otherwise`` if the run lies outside.
    """
    verdict = otherwise
    if evidence.met:
        verdict = REPRODUCED if evidence.telling and not instead else TREND
    return Row(where, claim, paper, simulation, verdict, note, true, evidence, instead)


TEMPLATES = ("found", "where", "claim", "paper", "measure", "trivial", "instead", "note")
"""The texts of an entry of a document's table, in the order in which a run's figures are named."""


class Rows(list[Row]):
    """The rows of a study: ``<document>.toml`` beside this file says what is claimed, a run what it found.

    An entry has where, claim and paper as in :class:`Row`; the text of what was found, or a figure's unit and digits;
    the verdict if it holds, or the evidence's measure, tolerance and trivial predictor; ``otherwise``; and a note. The
    texts are templates. A text that depends on the run is a table of cases.
    """

    def __init__(self, document: str) -> None:
        self._entries = files.toml(Path(__file__).parent / f"{document}.toml")

    def __call__(
        self,
        key: str,
        figures: Any = (),
        holds: Any = None,
        error: Any = None,
        guess: float = np.nan,
        case: str = "",
        true: Estimate | str = "",
        **given: Any,
    ) -> None:
        """Adds the row of an entry.

        Args:
            key: of the entry.
            figures: one or a tuple: what was found if the entry has no text of it (a number, the runs' numbers, an
                estimate, a text); then those of the templates, in the order in which :data:`TEMPLATES` name them first.
            holds: whether the run agrees, if the entry has a verdict.
            error, guess: the run's and the trivial predictor's, if it has evidence.
            case: which of the texts.
            true: what was found of the true gap.
            given: what the entry leaves to the run.
        """
        every = {**self._entries[key], **given}
        names = dict.fromkeys(re.findall(r"(?<!{){(\w+)", " ".join(str(every.get(k, "")) for k in TEMPLATES)))
        entry = {k: v.get(case, "") if isinstance(v, dict) else v for k, v in every.items()}
        values = figures if isinstance(figures, tuple) else (figures,)
        words = dict(zip(names if "found" in entry else ("", *names), values, strict=True))
        text = {k: entry.get(k, "").format(**words) for k in TEMPLATES}
        seen = words.get("", text["found"])
        if not isinstance(seen, (str, Estimate)):
            unit, digits = entry.get("unit", ""), entry.get("digits", 3)
            seen = estimate(seen, unit, digits) if np.ndim(seen) else Estimate(seen, unit, digits=digits)
        row = text["where"], text["claim"], text["paper"], seen
        otherwise = entry.get("otherwise", FAILS)
        if error is None:
            verdict = judged(holds, entry["verdict"], otherwise)
            self.append(Row(*row, verdict, text["note"], true, None, text["instead"]))
        else:
            evidence = Evidence(text["measure"], error, entry["tolerance"], text["trivial"], guess)
            self.append(weighed(*row, evidence, text["note"], true, otherwise, text["instead"]))


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


Measure = Callable[[Trial, Rows], Sequence[Drawing] | None]
"""What a study does: it adds its rows and gives its drawings, if it has any."""


def study(document: str, title: str) -> Callable[[Measure], Callable[[Trial], Findings]]:
    """Registers a function as a study of ``document``; its name, with hyphens, is the study's key."""

    def register(measure: Measure) -> Callable[[Trial], Findings]:
        def run(trial: Trial) -> Findings:
            rows = Rows(document)
            return Findings(rows, list(measure(trial, rows) or ()))

        found = Study(document, measure.__name__.replace("_", "-"), title, run)
        _studies[found.name] = found
        return run

    return register


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
