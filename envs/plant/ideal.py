"""Idealised stages: a machine one stage of which is without fault, to ask what that stage costs.

=============  ========================================================================================================
stage          without fault
=============  ========================================================================================================
``sensor``     no noise, jitter, drift, impulses, bursts or plasma; counting and the width of the sensor stay
``table``      heights are read from the head's own equations instead of its calibration run
``filter``     keeps what it does to noise, delays nothing (:mod:`plant.prompt`)
``servo``      the head has the commanded speed within 0.1 ms; no limits, friction, backlash, resonance, encoder or D/A
               steps
``dead time``  a command acts in the period after its reading, as early as a loop of 1 kHz can
``matching``   of jobs: the drives of X and Y have the same gain in all directions
``axes``       of jobs: their slides have the commanded speeds at once; no limits, encoder or D/A steps
=============  ========================================================================================================

Followers travel an ideal path, so the last two are stages of jobs only. What is left with all of them idealised is the
law's, the limits' of its supervisor, and the sampling's.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..engine.quantity import InvalidInput, check_choice
from . import heads, prompt
from .fleet import Fleet
from .machine import DT


def _sensor(fleet: Fleet, machines: Any) -> None:
    for fault in ("noise", "jitter", "drift", "impulses", "bursts", "plasma"):
        fleet.set(f"sensor.{fault}", machines, 0.0)


def _table(fleet: Fleet, machines: Any) -> None:
    which = heads.carried(np.stack([fleet.column(f"sensor.{name}")[machines] for name in heads.FIELDS]))
    index = {head: heads.exact(head) for head in set(which.tolist())}
    fleet.set("start.head", machines, np.array([index[head] for head in which.tolist()], float))


SERVO = {
    # With these two the drive's sampled equations are deadbeat: a step of the command is there after two substeps.
    "omega": np.sqrt(2.0) / DT,
    "zeta": np.sqrt(0.125),
    "speed": 1e4,
    "acceleration": 1e12,
    "jerk": 1e18,
    **dict.fromkeys(("dac", "encoder", "friction", "backlash", "compliance"), 0.0),
}
"""Parameters of a Z axis without fault but for its dead time."""


def _servo(fleet: Fleet, machines: Any) -> None:
    for name, value in SERVO.items():
        fleet.set(f"z.{name}", machines, value)


def _dead_time(fleet: Fleet, machines: Any) -> None:
    fleet.set("z.dead_time", machines, 0.0)


MATCHING = {"x_plus": 1.0, "x_minus": 1.0, "y_plus": 1.0, "y_minus": 1.0}
"""Relative gains of the directions."""

AXES = {"t1": 2e-6, "t2": 1e-6, "tau": 0.0, "speed": 1e4, "acceleration": 1e6, "dac": 0.0, "encoder": 0.0}
"""Parameters of X and Y axes without fault; the time constants are as nothing beside a control period."""


def _on_axes(values: dict[str, float]) -> Callable[[Fleet, Any], None]:
    def put(fleet: Fleet, machines: Any) -> None:
        if fleet.gantries is None:
            raise InvalidInput("axes are of jobs; a follower's path is ideal already")
        for name, value in values.items():
            fleet.gantries.set(f"xy.{name}", machines, value)

    return put


STAGES: dict[str, Callable[[Fleet, Any], None]] = {
    "sensor": _sensor,
    "table": _table,
    "filter": prompt.install,
    "servo": _servo,
    "dead time": _dead_time,
    "matching": _on_axes(MATCHING),
    "axes": _on_axes(AXES),
}
"""What idealises each stage."""

JOBS = tuple(STAGES)
FOLLOWING = tuple(stage for stage in STAGES if stage not in ("matching", "axes"))
"""Stages of machines that do jobs, and of those that only follow the sheet."""


def idealise(fleet: Fleet, stage: str, machines: Any) -> None:
    """Idealises a stage of ``machines``, which have been prepared and have their stack, but have not begun.

    A stage is idealised for all machines that need it at once: a second call takes the place of the first.

    Raises:
        InvalidInput: unknown stage; the nearest is offered.
    """
    check_choice(stage, STAGES, "stage")
    m = np.atleast_1d(machines)
    if len(m):
        STAGES[stage](fleet, m)
