"""Machines of another make are identified, and how closely they follow an unseen sheet is predicted.

``python -m kerfgym.tests.oracle.foreign_study [NAME …]`` takes about two minutes a machine and prints a line for each
controller: RMS of the true gap's error on the machine itself, and as predicted from its logs.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.figures import metrics
from kerfgym.envs.plant import calibration
from kerfgym.envs.scenarios import Scenario, machines
from kerfgym.experiments.identify import identifying
from kerfgym.experiments.identify.outside import Outside
from kerfgym.experiments.measure import rollout
from kerfgym.tests.oracle.foreign import FRESH, GOOD, WRONG, Foreign
from kerfgym.tests.oracle.foreign_logs import followed, recorded

CONTROLLERS = ("xi2023-tuned", "pid", "observer", "forecast")

FEED, SECONDS, SETTLE, HEIGHT, SPACING = 200.0, 6.0, 0.5, 1.0, 0.1
"""mm/s, s, s that are not scored, mm, mm between points of the sheet."""


def unseen(folder: Path, seed: int = 17) -> np.ndarray:
    """Heights of a sheet of twelve waves, 25 to 400 mm long, 0.35 mm RMS, which lie in ``profile.csv``, too."""
    rng, x = np.random.default_rng(seed), np.arange(0.0, 1500.0, SPACING)
    heights = np.zeros(len(x))
    for length in np.geomspace(25, 400, 12):
        heights += length * np.sin(2 * np.pi * x / length + rng.uniform(0, 2 * np.pi))
    heights *= 0.35 / heights.std()
    rows = [f"{at:.1f},{height:.6f}" for at, height in zip(x, heights, strict=True)]
    (folder / "profile.csv").write_text("\n".join(["position_mm,height_mm", *rows]), encoding="utf-8")
    return heights


def measured(make: Foreign, controller: str, table: Path, sheet: np.ndarray, seeds: Any = range(3)) -> float:
    """µm RMS of the machine itself, its heights read from the table of its own sweep."""
    squares = []
    for seed in seeds:
        outside = Outside(controller, table=table, set_height=HEIGHT, feed=FEED)
        gaps = followed(make, outside, sheet, SPACING, FEED, SECONDS, HEIGHT, seed)
        squares.append(np.mean((gaps[round(1e3 * SETTLE) :] - HEIGHT) ** 2))
    return float(1e3 * np.sqrt(np.mean(squares)))


def scenario_of(folder: Path) -> Scenario:
    """The same sheet for the model."""
    return scenarios.load("flat").varied(
        name="unseen", duration=SECONDS, settle=SETTLE, feed=FEED, set_height=HEIGHT,
        sheet={"profile": {"file": str(folder / "profile.csv"), "spacing": SPACING}},
    )  # fmt: skip


def predicted(machine: Any, controller: str, folder: Path, seeds: Any = range(24)) -> np.ndarray:
    """µm RMS of machines that are drawn from what was identified."""
    there = machines.put_on(scenario_of(folder), machines.load(machine))
    return metrics.rms_true(rollout.roll(there, resolve(controller), seeds))


def identified(make: Foreign, folder: Path, seed: int = 0) -> identifying.Identified:
    """What logs of rest, sweep and motion say; the calibration table lies in ``table.csv``."""
    logs = [recorded(make, protocol, folder, seed) for protocol in ("sweep", "rest", "motion")]
    found = identifying.identify(logs, "foreign")
    assert found.table
    calibration.write_csv(found.table, folder / "table.csv")
    return found


def _main() -> None:
    every = {**GOOD, **FRESH, **WRONG}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(every))
    parser.add_argument("--sheet", type=int, default=17, help="seed of the unseen sheet")
    asked = parser.parse_args()
    for name in asked.names:
        with tempfile.TemporaryDirectory() as place:
            folder, begun = Path(place), time.process_time()
            found, sheet = identified(every[name], folder), unseen(folder, asked.sheet)
            print(f"{name}, {time.process_time() - begun:.0f} s of CPU")
            for note in found.notes:
                print(f"    {note}")
            for number in found.numbers:
                low, middle, high = number.interval
                print(
                    f"    {number.key:22s}{middle:12.5g}   {low:.5g} to {high:.5g}{'' if number.found else ' (prior)'}"
                )
            for controller in CONTROLLERS:
                here = measured(every[name], controller, folder / "table.csv", sheet)
                there = predicted(found.machine, controller, folder)
                share = 100 * (float(np.mean(there)) / here - 1)
                print(f"  {controller:16s} {here:7.2f} µm, predicted {np.mean(there):7.2f} ± {np.std(there):.2f}, "
                      f"{share:+.1f} %", flush=True)  # fmt: skip


if __name__ == "__main__":
    _main()
