"""What a run of minutes says: each controller on each sheet, and what is promised of ``self-tuning``."""

import math
from typing import Any

import pandas as pd

from ...report.terminal import TextTable
from .sheets import TURNS
from .worse import BURST, EARLY, LARGEST_MARGIN, LIMIT, RMS_MARGIN, TIMES, WORSE

SUBJECT, REFERENCE = "self-tuning", "xi2023-tuned"
"""Whose largest error is limited, and by whose along a drawing."""


MOST = 1000.0
"""Ratios above it are of an error that was almost nothing, and are only shown to be larger."""


def table(frame: pd.DataFrame) -> TextTable:
    """One row for each controller and sheet.

    Args:
        frame: columns ``sheet``, ``controller``, ``drawing`` and the fields of :class:`worse.Verdict`, intervals in
            columns of their own (``rms_growth``, ``rms_growth_low``, …).
    """
    rms = ["RMS, first 10 s", "RMS later", "growth of RMS"]
    largest = ["largest, first 10 s", "largest later", "later over first", "above", "growth of largest"]
    ends = ["> 50 µm", "> 100 µm", "bursts", "lost", "verdict"]
    sheet = TextTable("Errors with time, µm", ["controller", "sheet", *rms, *largest, *ends])
    for _, part in frame.groupby("sheet", sort=False):
        sheet.sections.append([_row(row) for _, row in part.iterrows()])
    worse = frame[frame["word"] == WORSE]
    names = ", ".join(f"{row['controller']} on {row['sheet']}" for _, row in worse.iterrows())
    sheet.notes = [
        f"growth: last third of the time over the {EARLY} windows after the first, geometric mean over seeds; "
        f"intervals hold together with 95 %. worse: an interval lies above {RMS_MARGIN:g} (RMS) or "
        f"{LARGEST_MARGIN:g} (largest of windows of equal length); steady: both lie below; open: these seeds do not "
        "tell.",
        "later over first: largest error after the first window over that within it; grows by itself with time; "
        f"> {MOST:g}: there was almost none in the first. above: "
        "share of later windows whose largest error exceeds that of the first window of their run; 50 % without a "
        "trend.",
        f"> 50 µm, > 100 µm: windows with a larger error. bursts: windows above {BURST:g} µm and {TIMES:g} times the "
        "median of their run. lost: runs with a collision or another alarm; "
        "left out from then on.",
        f"Worse with time: {names or 'none'}.",
    ]
    return sheet


def promises(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """What is promised, what was measured, and whether it held; nothing about what was not run."""
    worse = frame["word"] == WORSE
    first = {"what": "controllers that get worse with time", "measured": float(worse.sum()), "promised": 0.0}
    found = [{**first, "held": not worse.any()}]
    for _, row in frame[(frame["controller"] == SUBJECT) & ~frame["drawing"]].iterrows():
        for what, measured, most in (
            ("largest error later over first", row["ratio"], LIMIT),
            ("bursts", row["bursts"], 0.0),
            ("lost runs", row["lost"], 0.0),
        ):
            found.append(_promise(f"{SUBJECT} on {row['sheet']}: {what}", measured, most))
    for name, part in frame[frame["drawing"]].groupby("sheet", sort=False):
        own = part.set_index("controller")
        if SUBJECT not in own.index:
            continue
        for what in ("lost",) if name == TURNS else ("lost", "bursts"):
            words = "lost runs" if what == "lost" else what
            found.append(_promise(f"{SUBJECT} along {name}: {words}", own.at[SUBJECT, what], 0.0))
        if name != TURNS and REFERENCE in own.index and not own.at[REFERENCE, "lost"]:  # a lost one is no reference
            largest = own[["largest_first", "largest_later"]].max(axis=1)
            most = float(largest[REFERENCE])
            found.append(_promise(f"{SUBJECT} along {name}: largest error, µm", largest[SUBJECT], round(most, 1)))
    return found


def _promise(what: str, measured: float, most: float) -> dict[str, Any]:
    return {"what": what, "measured": float(measured), "promised": float(most), "held": bool(measured <= most)}


def promised(found: list[dict[str, Any]]) -> TextTable:
    """The same as a table."""
    rows = [[p["what"], _number(p["measured"]), f"≤ {p['promised']:g}", "yes" if p["held"] else "no"] for p in found]
    return TextTable("What is promised", ["", "measured", "promised", "held"], [rows])


def _row(row: Any) -> list[str]:
    ratio = f"> {MOST:g}" if row["ratio"] > MOST else _number(row["ratio"])
    above = "–" if math.isnan(row["above"]) else f"{row['above']:.0%}"
    rms = [_number(row["rms_first"]), _number(row["rms_later"]), _growth(row, "rms_growth")]
    largest = [_number(row["largest_first"]), _number(row["largest_later"]), ratio, above]
    counts = [_growth(row, "largest_growth"), *(str(row[key]) for key in ("over_50", "over_100", "bursts"))]
    return [row["controller"], row["sheet"], *rms, *largest, *counts, f"{row['lost']}/{row['seeds']}", row["word"]]


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"


def _growth(row: Any, name: str) -> str:
    if row["drawing"]:
        return "–"
    value, low, high = row[name], row[f"{name}_low"], row[f"{name}_high"]
    return "–" if math.isnan(value) else f"{value:.2f}" + ("" if math.isnan(low) else f" ({low:.2f} … {high:.2f})")
