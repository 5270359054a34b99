"""Budgets: what tuning or training each stack of a comparison had, and which of them were larger than the others'.

A ratio between two controllers says something of their laws only if both were tuned with the same effort. Slot by slot
the measure is what the reference was tuned with; where it was not tuned, or is not there, it is the smallest budget of
those that were. A stack that was not tuned at all, such as a document's law with its printed gains, is no measure, and
is fair at any: its record says zero trials.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

SLACK = 1.1
"""Budgets up to this ratio count as equal: searches skip what they see to be impossible, which costs no steps."""

CPU_SLACK = 2.0
"""The same for CPU-seconds, in which searches of equally many steps differ by about as much on one machine. They are
the measure of learning itself, whose effort is not in simulated steps alone, and where nothing else is known of
both."""

NONE, LARGER, EDITED = "none", "larger", "edited"
MARKS = {
    NONE: "no budget recorded",
    LARGER: (
        f"more than {SLACK:g} times the simulated steps (or trials) of the reference, where that was not tuned of the "
        f"smallest, or more than {CPU_SLACK:g} times its CPU-seconds in training alone"
    ),
    EDITED: "parameters changed since they were tuned, or by hand",
}
"""What makes a ratio one that is not at equal budgets."""

_SUMS = ("trials", "steps", "cpu_seconds")
_UNITS = {"steps": "simulated steps", "trials": "trials", "cpu_seconds": "CPU-seconds"}


@dataclass(frozen=True)
class Spent:
    """What the stack of one slot was tuned or trained with; NaN where that is not recorded.

    Attributes:
        trials: candidates of a search.
        steps: simulated control periods.
        cpu_seconds: of search and training together.
        learning: CPU-seconds of the training alone; NaN if no policy was trained.
        learns: whether one was.
        edited: parameters changed by hand, in words; empty if none was.
        recorded: whether there is a record at all.
        name: of whose measure it is, if it is one.
    """

    trials: float = math.nan
    steps: float = math.nan
    cpu_seconds: float = math.nan
    learning: float = math.nan
    learns: bool = False
    edited: str = ""
    recorded: bool = False
    name: str = ""

    @property
    def tuned(self) -> bool:
        """Whether anything was spent."""
        return any(value > 0 for value in (self.trials, self.steps, self.cpu_seconds))

    def beyond(self, measure: "Spent") -> str:
        """By how much, and in what, this is larger than a measure; empty if it is not."""
        known = [k for k in _UNITS if not math.isnan(getattr(self, k) + getattr(measure, k))]
        for key in known[:1]:
            times = getattr(self, key) / (getattr(measure, key) or math.nan)
            if times > (CPU_SLACK if key == "cpu_seconds" else SLACK):
                return f"{times:.2g} times the {_UNITS[key]} of {measure.name}"
        times = self.learning / (measure.cpu_seconds or math.nan)
        if times > CPU_SLACK:  # never so if one of them is not known
            return f"{times:.2g} times the CPU-seconds of {measure.name} in training alone"
        return ""


def slots(record: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """A provenance by slot; a single stack's has the slot ``""``."""
    nested = {slot: body for slot, body in record.items() if slot in ("z", "xy", "process") and isinstance(body, dict)}
    return nested or {"": record}


def spent(record: dict[str, Any]) -> Spent:
    """What the provenance of one stack says; what it started from counts."""
    trials, cpu = _number(record, "trials"), _number(record, "cpu_seconds")
    steps = _number(record, "simulated_steps", "steps")
    if trials == 0:  # then nothing was simulated or computed either, unless it is said
        steps, cpu = _zero(steps), _zero(cpu)
    trained, learning = record.get("policy"), math.nan
    if isinstance(trained, dict):  # its steps are in the total already, its CPU-seconds are not
        learning = _number(trained.get("ledger", trained), "cpu_seconds")
        cpu = _zero(cpu) + learning
    known = bool({"trials", "simulated_steps", "steps", "policy"} & set(record))
    own = Spent(trials, steps, cpu, learning, isinstance(trained, dict), str(record.get("edited", "")), known)
    start = record.get("start")
    if isinstance(start, dict) and start:
        for first in map(spent, slots(start).values()):
            own = replace(own, **{key: getattr(own, key) + _zero(getattr(first, key)) for key in _UNITS})
    return own


def _number(record: dict[str, Any], *keys: str) -> float:
    found = [record[key] for key in keys if record.get(key) is not None]
    return float(found[0]) if found else math.nan


def _zero(value: float) -> float:
    return 0.0 if math.isnan(value) else value


def measures(tuning: dict[str, Any], controllers: Iterable[str], reference: str) -> dict[str, Spent]:
    """Of each slot the budget that others are measured by."""
    found: dict[str, list[tuple[str, Spent]]] = {}
    for name in controllers:
        for slot, record in slots(tuning.get(name) or {}).items():
            own = spent(record)
            if own.tuned and not own.edited:
                found.setdefault(slot, []).append((name, own))
    out = {}
    for slot, tuned in found.items():
        mine = dict(tuned).get(reference)
        if mine:
            out[slot] = replace(mine, name=reference)
            continue
        known = [key for key in _UNITS if not any(math.isnan(getattr(own, key)) for _, own in tuned)]
        name, least = min(tuned, key=lambda each: _known(getattr(each[1], (known or list(_UNITS))[0])))
        out[slot] = replace(least, name=name)
    return out


def _known(value: float) -> float:
    return math.inf if math.isnan(value) else value


def faults(record: dict[str, Any], of_slots: dict[str, Spent]) -> Iterator[tuple[str, str]]:
    """Marks of a controller's provenance, each with its reason in words."""
    for slot, body in slots(record).items():
        own, where = spent(body), f"{slot}: " if slot else ""
        if not own.recorded:
            yield NONE, f"{where}no record of how it was tuned (a class of one's own has it in TUNING)"
            continue
        if own.learns and math.isnan(own.cpu_seconds):
            yield NONE, f"{where}the CPU-seconds of its training are not recorded"
        if own.edited:
            yield EDITED, f"{where}changed by hand, with no record of how that was chosen: {own.edited}"
        more = own.beyond(of_slots[slot]) if slot in of_slots else ""
        if more:
            yield LARGER, f"{where}tuned with {more}"


def budgets(tuning: dict[str, Any], controllers: Iterable[str], reference: str) -> pd.DataFrame:
    """One row per controller: ``trials``, ``tuning_steps`` and ``tuning_cpu`` (s) of all slots together (NaN if
    unknown), and ``budget``, a key of :data:`MARKS` or empty.

    Args:
        tuning: provenance of each stack, or of each slot of a team (``run.json``'s table of that name).
        controllers: names as they were asked for.
        reference: name of the one against which ratios are taken.
    """
    names = list(controllers)
    of_slots = measures(tuning, names, reference)
    rows = []
    for name in names:
        record = tuning.get(name) or {}
        marks = [mark for mark, _ in faults(record, of_slots)]
        parts: list[Spent] = []
        for body in slots(record).values():
            own = spent(body)
            if own.recorded and not ("study" in body and own in parts):  # one study may search several slots
                parts.append(own)
        totals = [sum(getattr(part, key) for part in parts) if parts else math.nan for key in _SUMS]
        rows.append([*totals, next((mark for mark in MARKS if mark in marks), "")])
    return pd.DataFrame(rows, index=names, columns=["trials", "tuning_steps", "tuning_cpu", "budget"])


def in_words(row: Any) -> str:
    """A row of :func:`budgets` for a table: ``400 · 634 M``, with its mark."""
    untuned = row["trials"] == 0 and not row["tuning_steps"] > 0
    parts = ["not tuned"] if untuned else []
    if not untuned and not math.isnan(row["trials"]):
        parts.append(f"{row['trials']:.0f}")
    if not untuned and not math.isnan(row["tuning_steps"]):
        million = 1e-6 * row["tuning_steps"]
        parts.append(f"{million:.0f} M" if million >= 100 else f"{million:.3g} M")
    mark = row["budget"]
    return " · ".join(parts) + (f" {mark}" if parts and mark else mark)
