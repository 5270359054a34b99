"""A follow log that was not used: its following error, and what machines drawn from the logs make on its sheet."""

from dataclasses import dataclass

import numpy as np

from ...envs.control.stack import resolve
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Scenario, machines
from ..measure import rollout
from .followed import followed
from .identifying import Identified
from .log import PERIOD, Log

DRAWS = 60
"""Machines that predict."""

SETTLE, LONGEST = 1.0, 60.0
"""s that do not count at the beginning, and s that are predicted at most."""


@dataclass(frozen=True)
class Checked:
    """RMS and 95th percentile of height − set height, µm: measured, and predicted by each drawn machine."""

    name: str
    controller: str
    measured: dict[str, float]
    predicted: dict[str, np.ndarray]
    touched: int

    @property
    def sentence(self) -> str:
        """Whether the prediction holds what was measured."""
        low, middle, high = np.percentile(self.predicted["RMS"], [2.5, 50, 97.5])
        off = middle / self.measured["RMS"] - 1
        inside = "inside" if low <= self.measured["RMS"] <= high else "outside"
        return (
            f"{self.name} under {self.controller}: measured {self.measured['RMS']:.3g} µm RMS, predicted {middle:.3g} "
            f"({low:.3g} to {high:.3g}) µm, {abs(off):.0%} {'more' if off > 0 else 'less'}; {inside} "
            "of the interval, which holds machines and noise but "
            "not what is unknown of the sheet."
        )


def fit_for(log: Log) -> None:
    """Refuses what cannot be predicted.

    Raises:
        InvalidInput: it is no follow log, lacks a column, or is too short.
    """
    lacks = [name for name in ("height", "set_height") if name not in log]
    if log.protocol != "follow" or lacks:
        raise InvalidInput(f"{log.name}: --check takes a follow log with height and set_height")
    if log.duration < 2 * SETTLE or not np.any(log["height"][round(SETTLE / PERIOD) :] > 0):
        raise InvalidInput(f"{log.name}: --check takes a follow log of more than {2 * SETTLE:g} s with valid heights")


def check(found: Identified, log: Log, controller: str, seed: int = 0, draws: int = DRAWS) -> Checked:
    """Predicts a follow log, from machines drawn from the machine's file.

    Raises:
        InvalidInput: it is no follow log, or lacks a column.
    """
    fit_for(log)
    stack = resolve(controller)
    sheet = followed(log, found.table, found.machine.axis, found.machine.head.plate)
    steps = min(len(log["height"]), round(LONGEST / PERIOD))
    wanted = float(np.median(log["set_height"]))
    scenario = Scenario(name="check", duration=steps * PERIOD, settle=SETTLE, feed=sheet.feed, set_height=wanted)
    every = np.arange(draws)
    recording = rollout.roll(
        machines.put_on(scenario, found.machine),
        stack,
        seed + every,
        change=lambda f: f.put_profile(sheet.height, sheet.spacing, every),
    )
    first = round(SETTLE / PERIOD)
    error, valid = log["height"] - log["set_height"], log["height"] > 0
    made = np.abs(1e3 * recording.reported_error[first:])
    real = np.abs(1e3 * error[first:steps][valid[first:steps]])
    return Checked(
        log.name,
        controller,
        {"RMS": float(np.sqrt(np.mean(real**2))), "95th percentile": float(np.percentile(real, 95))},
        {"RMS": np.sqrt(np.nanmean(made**2, axis=0)), "95th percentile": np.nanpercentile(made, 95, axis=0)},
        int(recording.collided.sum()),
    )
