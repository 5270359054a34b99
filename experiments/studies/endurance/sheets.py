"""What the machines travel over for minutes."""

from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

from ....envs import scenarios
from ....envs.engine.quantity import InvalidInput, check_choice
from ....envs.scenarios import Scenario
from ...measure.grids import along

MIXED = "rough+flutter+impulses"
"""The waves of ``rough``, the vibration of ``flutter``, the sensor of ``impulses``."""

CONTINUOUS = ("random-k2", "random-k3")
"""Sheets of continuous spectrum."""

TURNS = "shift"
"""Everything in turn; the later parts are harder, so only lost runs are judged. A window with a step is far above the
median of its run whatever the controller does, and steps do not come in the same windows of all runs."""

LEVEL = {"tilt": 0.0, "tilt_y": 0.0}
"""60 m up a slope of 3 mm/m lead out of the travel of the head."""

DRAWN = "path"
"""A drawing that the user gives."""

NAMES = ("wavy", "rough", MIXED, "chatter", *CONTINUOUS, TURNS)

JOB = "contour-square"
"""The scenario whose part the drawing replaces: mild steel of 3 mm, axes and pierces and rapids and all."""


def sheets(names: tuple[str, ...] = (), duration: float = 300.0, path: Path | None = None) -> dict[str, Scenario]:
    """Scenarios by name.

    Args:
        names: some of :data:`NAMES`, and ``path``; none: all there are.
        duration: s of each, except of a drawing, which is cut whole.
        path: the drawing.

    Raises:
        InvalidInput: an unknown name, a drawing that cannot be read, ``path`` without one, or a duration out of range.
    """
    known = (*NAMES, DRAWN)
    for name in names:
        check_choice(name, known, "sheet")
    if DRAWN in names and path is None:
        raise InvalidInput("--sheets path needs a drawing: --path FILE")
    wanted = names or (*NAMES, *([DRAWN] if path else []))
    found = {}
    for name in wanted:
        if name == DRAWN and path is not None:
            found[path.stem] = along(path, [scenarios.load(JOB)], "contour")[0]
        else:
            base = mixed() if name == MIXED else scenarios.load(name)
            found[name] = base.varied(duration=duration, name=name, sheet=LEVEL)
    return found


def mixed() -> Scenario:
    """All of :data:`MIXED` at once."""
    sheet, head = scenarios.load("flutter").sheet, scenarios.load("impulses").head
    return scenarios.load("rough").varied(name=MIXED, sheet=_own(sheet), head=_own(head))


def _own(section: Any) -> dict[str, Any]:
    """What differs from a section's defaults."""
    plain = {f.name: f.default for f in fields(section) if f.default is not MISSING}
    return {key: value for key, value in asdict(section).items() if getattr(section, key) != plain.get(key)}
