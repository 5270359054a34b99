"""Out of distribution: how much of a controller's advantage is left where nothing was tuned or trained."""

from typing import Any

import numpy as np

from ..statistics.pooling import over_scenarios
from .numbers import number, part, times
from .suite import Suite

NAME = "ood"

SHIFTS = {
    "fast": "400 mm/s",
    "noisy": "3 × noise",
    "late": "dead time 3 ms",
    "soft": "drive 40 Hz",
    "stiff": "drive 150 Hz",
    "low": "set height 0.3 mm",
    "spatter": "3 × impulses",
}
"""First word of a scenario's name, and what lies beyond the range there."""


def table(suites: list[Suite], labels: dict[str, str]) -> dict[str, Any] | None:
    """Rows for the page: within and beyond the distribution, and the factor of each shift; None without the suite."""
    beyond = next((s for s in suites if s.name == NAME), None)
    if beyond is None:
        return None
    within = next((s for s in suites if s.name == "following"), None)
    here = beyond.pooled("rms_true")
    there = within.pooled("rms_true") if within else None
    summary, rows = beyond.summary, []
    shifts = [shift for shift in SHIFTS if any(s.split("-")[0] == shift for s in beyond.scenarios)]
    for name in beyond.ranked:
        score = float(summary.at[name, "score"])
        base = float(within.summary["score"].get(name, np.nan)) if within else np.nan
        cells = []
        for shift in shifts:
            of_shift = [s for s in beyond.scenarios if s.split("-")[0] == shift]
            value = over_scenarios("rms_true", here.loc[name, of_shift])
            lost, tried = (int(t.loc[name, of_shift].sum()) for t in (beyond.lost, beyond.count))
            plain = np.nan
            if there is not None and name in there.index:
                twins = [s.split("-", 1)[1] for s in of_shift]
                if set(twins) <= set(there.columns):
                    plain = over_scenarios("rms_true", there.loc[name, twins])
            ratio = value / plain
            cell = {"text": number(value) if np.isfinite(value) else "failed", "value": value}
            cell |= {"worse": f"× {times(ratio)}" if np.isfinite(ratio) else "", "bad": bool(ratio > 3 or lost)}
            cells.append(cell | {"lost": f"{part(lost, tried)} failed" if lost else ""})
        against = float(summary["ratio"].get(name, np.nan))
        row = {"name": name, "label": labels[name], "within": number(base), "within_value": base}
        row |= {"beyond": number(score) if np.isfinite(score) else "failed", "beyond_value": score}
        row |= {"worse": f"× {times(score / base)}" if np.isfinite(score / base) else "–", "ratio": number(against)}
        of = summary.loc[name]
        row |= {"cells": cells, "failed": part(of["failed"], of["runs"]), "lost": bool(of["failed"] > 0)}
        rows.append(row | {"information": of["information"], "rank": float(of["rank"])})
    out = {"rows": rows, "shifts": [SHIFTS[s] for s in shifts], "paired": within is not None, "unit": "µm"}
    return out | {"reference": beyond.reference, "said": _said(beyond, within, rows)}


def _said(beyond: Suite, within: Suite | None, rows: list[dict[str, Any]]) -> str:
    """Who is first here, and whether it is the same as within the distribution."""
    fair = [row for row in rows if row["information"] == "sensor" and np.isfinite(row["rank"])]
    fair = [row for row in fair if np.isfinite(row["beyond_value"])]
    if not fair:
        return "No controller that uses the sensor only is ranked and has a figure here."
    best = fair[0]  # they are in the order of their ranks
    text = f"Where nothing was tuned or trained, {best['label']} comes first of those that use the sensor only"
    both = [row for row in fair if np.isfinite(row["within_value"])]
    if within is None or not both:
        return text + "."
    known = {row["name"]: row["label"] for row in both}
    ranked = within.summary["rank"].notna()
    first = next((name for name in within.ranked if name in known and ranked[name]), None)
    if first is None:
        return text + "."
    if first == best["name"]:
        return text + ", as within the distribution."
    return f"{text}; within the distribution it is {known[first]}."
