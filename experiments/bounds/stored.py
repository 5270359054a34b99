"""The recorded bounds, which docs and report read: ``recorded.json``, made by ``python -m kerfgym.experiments.bounds``.

A figure belongs to a scenario's physics: it is found by a hash of all that the scenario says of them (its name and
summary are not among them), so a scenario that was changed has none, and scenarios of one name in several suites have
their own. Hashes of the sources that bounds are made from tell whether the record must be made anew; a test fails when
it must.
"""

import functools
import hashlib
import json
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path

from ...envs import scenarios
from ...envs.scenarios import Scenario
from ..store import stamp
from ..store.runs import atomic
from . import known

HERE = Path(__file__).parent
FILE = HERE / "recorded.json"

LABEL = "bound (causal, sensor only)"
LINEAR = "fixed linear, at the set height"
"""What tables and figures call them."""

_PLANT = ("calibration", "controller", "fleet", "heads", "machine", "path", "sensor", "sheet", "z_axis")
SOURCES = (
    "experiments/bounds/*.py",
    *(f"!experiments/bounds/{name}.py" for name in ("stored", "estimates", "__main__")),
    *("envs/scenarios/*.py", "!envs/scenarios/material.py", "envs/engine/lanes.py", "envs/engine/quantity.py"),
    *(f"envs/plant/{name}.py" for name in _PLANT),
)
"""What bounds are made from, beside the scenarios, as :mod:`store.stamp` takes it."""

_WORDS = ("name", "summary", "version", "cut_by")
"""What a scenario says that is not physics."""


@dataclass(frozen=True)
class Bound:
    """Bounds of a scenario: RMS of the true gap error over the benchmark's seeds, µm.

    Attributes:
        bound: for any causal controller with only the sensor; 0 where all that a sheet has can be learned.
        learned: an estimate of what is left to one that keeps the set height from the start and learns phases,
            amplitudes, frequencies and slopes while it lasts.
        linear: for a fixed linear predictor of the sheet that is tuned to the ensemble; None where none was made.
        parts: RMS of the sheet's prediction and of steps, which make ``bound``, µm; then what disturbs a reading.
    """

    bound: float
    learned: float
    linear: float | None
    parts: dict[str, float]


def physics(scenario: Scenario) -> str:
    """Hash of all that a scenario says of machine, sheet and journey."""
    said = {key: value for key, value in tomllib.loads(scenario.to_toml()).items() if key not in _WORDS}
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:20]


def sources() -> dict[str, str]:
    """Hashes of :data:`SOURCES`."""
    return stamp.stamp(SOURCES)


def wanted() -> dict[str, Scenario]:
    """The scenarios of which bounds are recorded, by ``suite/scenario``: all cores of height followers, where known."""
    found = {}
    for name in scenarios.suites():
        if scenarios.rules(name).get("slot") == "z" and name != "drawing":  # whose journey is the user's
            core = {f"{name}/{each}": scenarios.suite(name)[each] for each in scenarios.core(name)}
            found.update({each: s for each, s in core.items() if not known.unknown(s)})
    return found


def write(bounds: dict[str, Bound], seeds: range, file: Path = FILE) -> None:
    """Writes the record of ``bounds``, by ``suite/scenario``."""
    each = sorted(bounds.items())
    entries = {name: {"physics": physics(scenarios.load(name)), **asdict(bound)} for name, bound in each}
    record = {"sources": sources(), "seeds": [seeds.start, seeds.stop], "scenarios": entries}
    with atomic(file) as part:
        part.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


@functools.cache
def _record(file: Path = FILE) -> dict:
    read: dict = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {"sources": {}, "scenarios": {}}
    return read


def recorded(scenario: Scenario) -> Bound | None:
    """The bounds of a scenario from the record; None if it has none, or if its physics are not those recorded."""
    this = physics(scenario)
    for entry in _record()["scenarios"].values():
        if entry["physics"] == this:
            return Bound(**{key: value for key, value in entry.items() if key != "physics"})
    return None


def stale() -> list[str]:
    """What the record is not up to date with: sources, or names of scenarios."""
    found = _record()
    missing = [name for name, scenario in wanted().items() if recorded(scenario) is None]
    before = found["sources"] if isinstance(found["sources"], dict) else {}
    return stamp.changed(before, sources()) + missing


def table() -> str:
    """The page's tables in Markdown."""
    from ..store.markdown import table as markdown

    text = []
    for suite in scenarios.suites():
        if scenarios.rules(suite).get("slot") != "z":
            continue
        rows = []
        for name in scenarios.core(suite):
            if bound := recorded(scenarios.suite(suite)[name]):
                shown = [bound.learned, bound.linear, *(bound.parts[k] for k in ("prediction", "steps", "capacitance"))]
                rows.append([f"`{name}`", f"**{_shown(bound.bound)}**", *map(_shown, shown)])
        if rows:
            parts = ("of the bound: prediction", "of the bound: steps", "noise of a reading")
            titles = ("scenario", "bound", "learned at the set height (estimate)", "fixed linear", *parts)
            text += [f"Suite `{suite}`, µm RMS:\n", markdown(titles, rows)]
    return "\n".join(text)


ESTIMATES = {
    "tilt": (0.5, 0.5),
    "wavy": (1.2, 1.4),
    "rough": (2.2, 2.7),
    "step": (0.0, 20.0),
    "impulses": (0.5, 0.5),
    "flutter": (1.8, 2.1),
    "chatter": (3.2, 3.9),
}
"""Independent estimates of what is possible in the core of ``following-v1``, µm RMS, from to."""


def comparison() -> str:
    """Independent estimates of suite ``following-v1`` beside its bounds, in Markdown."""
    from ..store.markdown import table as markdown

    rows = []
    for name, (low, high) in ESTIMATES.items():
        if bound := recorded(scenarios.load(f"following-v1/{name}")):
            given = f"≤ {high:g}" if low == 0.0 else (f"{low:g}" if low == high else f"{low:g}–{high:g}")
            away = "–" if low == 0.0 or not bound.linear else f"{100.0 * (bound.linear / low - 1.0):+.0f} %"
            rows.append([f"`{name}`", given, _shown(bound.linear), away, _shown(bound.learned), _shown(bound.bound)])
    others = ("independent estimate", "fixed linear", "to the estimate's lower end")
    titles = ("`following-v1`, µm RMS", *others, "learned at the set height (estimate)", "bound")
    return markdown(titles, rows) if rows else ""


def _shown(value: float | None) -> str:
    return "–" if value is None else ("0" if value == 0.0 else f"{value:.2f}")


def noise_table() -> str:
    """What disturbs a reading, RMS over the machines of the first scenario of each suite, µm."""
    from ..store.markdown import table as markdown

    for name in scenarios.core("following"):
        if bound := recorded(scenarios.load(name)):
            parts = {key: value for key, value in bound.parts.items() if key not in ("prediction", "steps")}
            return markdown([f"`{name}`, µm RMS", *parts], [["", *(f"{value:.3f}" for value in parts.values())]])
    return ""
