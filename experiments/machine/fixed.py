"""One machine of many: every number of what a seed draws, fixed."""

from dataclasses import replace
from typing import Any

import numpy as np

from ...envs.control.stack import get
from ...envs.plant.sensor import Params
from ...envs.scenarios import Scenario, machines
from ...envs.scenarios.distributions import Draws, as_number, draw
from ...envs.scenarios.machines import Machine
from ..measure import rollout

HEAD = {"face": ("radius", 2.0), "bore": ("bore", 2.0), "body": ("body", 1.0), "inductance": ("inductance", 1.0)}
"""Keys of a head, with the sensor's field and the factor on it."""


def fixed(machine: Machine, seed: int) -> Machine:
    """The machine that a seed draws from distributions and from the pool of heads.

    The same seed rolled out with the one and with the other has the same machine; only the error of its calibration
    run is another.
    """
    draws = Draws(np.array([seed], np.uint64), {})
    made = {table: _of(getattr(machine, table), draws, table) for table in machines.TABLES}
    flat = Scenario(name="fixed", duration=1.0, settle=0.0, feed=0.0, set_height=1.0)
    own: Params = rollout.fleet_for(machines.put_on(flat, machine), get("idle"), [seed]).get("sensor")
    carried = {key: factor * float(getattr(own, field)) for key, (field, factor) in HEAD.items()}
    made["head"] = replace(made["head"], nominal=True, **carried)
    summary = f"what seed {seed} draws from {machine.name}"
    return replace(machine, name=f"{machine.name} {seed}", summary=summary, **made)


def _of(section: Any, draws: Draws, table: str) -> Any:
    """A table with its distributions drawn."""
    found = {}
    for key, value in vars(section).items():
        if not isinstance(value, str | bool | int | float | None) and not isinstance(as_number(value), float):
            found[key] = float(draw(value, draws, f"{table}.{key}")[0])
    return replace(section, **found)
