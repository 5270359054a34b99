"""Budgets: what tuning or training each stack of a comparison had, and which of them were not equal.

A ratio between two controllers says something of their laws only if both were tuned with the same effort. The measure
is that of the reference, or without it the smallest of the run: simulated steps, or trials where steps are unknown.
"""

import math
from collections.abc import Iterable
from typing import Any

import pandas as pd

SLACK = 1.1
"""Budgets up to this ratio count as equal: searches skip what they see to be impossible, which costs no steps."""

NONE, LARGER, EDITED = "none", "larger", "edited"
MARKS = {
    NONE: "no budget recorded: not tuned, or by other means",
    LARGER: f"more than {SLACK:g} times the budget of the reference (without it, of the smallest)",
    EDITED: "parameters changed since they were tuned",
}
"""What makes a ratio one that is not at equal budgets."""


def budgets(tuning: dict[str, Any], controllers: Iterable[str], reference: str) -> pd.DataFrame:
    """One row per controller: ``trials`` and ``tuning_steps`` (NaN if unknown), and ``budget``, a key of
    :data:`MARKS` or empty.

    Args:
        tuning: provenance of each stack, or of each slot of a team (``run.json``'s table of that name).
        controllers: names as they were asked for, with overrides.
        reference: name of the one against which ratios are taken.
    """
    names = list(controllers)
    found = {name: _of(tuning.get(name) or {}) for name in names}
    rows = []
    for name in names:
        mine = found[name]
        known = [k for k in ("tuning_steps", "trials") if not math.isnan(mine[k])]
        mark = "" if known else NONE
        for key in known[:1]:
            others = [found[n][key] for n in names if not math.isnan(found[n][key])]
            base = found[reference][key] if reference in found else math.nan
            if mine[key] > SLACK * (min(others) if math.isnan(base) else base):
                mark = LARGER
        if known and not mark and "=" in name.rpartition(":")[2]:
            mark = EDITED
        rows.append({**mine, "budget": mark})
    return pd.DataFrame(rows, index=names, columns=["trials", "tuning_steps", "budget"])


def _of(record: dict[str, Any]) -> dict[str, float]:
    """Trials and steps of a provenance; those of a team's slots add up."""
    slots = [r for r in record.values() if isinstance(r, dict) and ({"trials", "simulated_steps", "steps"} & set(r))]
    if slots and "trials" not in record and "simulated_steps" not in record:
        parts = [_of(slot) for slot in slots]
        return {key: sum(p[key] for p in parts) for key in parts[0]}
    steps = record.get("simulated_steps", record.get("steps"))
    trials = record.get("trials")
    return {
        "trials": math.nan if trials is None else float(trials),
        "tuning_steps": math.nan if steps is None else float(steps),
    }


def in_words(row: Any) -> str:
    """A row of :func:`budgets` for a table: ``400 · 634 M``, with its mark."""
    parts = []
    if not math.isnan(row["trials"]):
        parts.append(f"{row['trials']:.0f}")
    if not math.isnan(row["tuning_steps"]):
        million = 1e-6 * row["tuning_steps"]
        parts.append(f"{million:.0f} M" if million >= 100 else f"{million:.3g} M")
    mark = row["budget"]
    return " · ".join(parts) + (f" {mark}" if parts and mark else mark)
