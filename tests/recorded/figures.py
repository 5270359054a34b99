"""One run of every shipped controller and policy in a few scenarios, as ``figures.csv`` keeps it."""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.figures import metrics
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.results import jobs

FILE = Path(__file__).with_name("figures.csv")

SEED = 1000

SCENARIOS = {
    "z": ("rough", "impulses", "step-flutter", "corners", "holes", "edge", "descent", "spatter-rough", "laps-rough"),
    "xy": ("contour-corners", "contour-one-way"),
    "process": ("cut-bulge", "cut-low-gas"),
}
"""By what the controller drives: each disturbance that a law or the supervisor has something against."""

METRICS = {
    "z": ("rms_true", "max_true", "rms_reported", "jitter", "z_travel", "min_gap", "dross", "roughness"),
    "xy": ("contour_rms", "contour_max", "gap_rms", "time", "mean_feed"),
    "process": ("contour_rms", "gap_rms", "time", "energy", "dross", "roughness", "kerf", "taper", "through"),
}

NAMES = sorted({*stack.names(), *stack.shelved()} - {"idle"})


def of(name: str) -> Iterator[dict[str, object]]:
    """Rows of one controller: itself, its scenario, and a figure with its name."""
    found = stack.resolve(name)
    for scenario in map(scenarios.load, SCENARIOS[found.slot]):
        if found.slot == "z":
            values = metrics.evaluate(rollout.roll(scenario, found, SEED))
        else:
            values = jobs.measured(scenario, stack.team(name), (SEED,))[0].to_dict("list")
        for metric in METRICS[found.slot]:
            yield {
                "controller": name, "scenario": scenario.name, "seed": SEED, "metric": metric,
                "value": float(values[metric][0]),
            }  # fmt: skip


def every() -> pd.DataFrame:
    """All rows."""
    return pd.DataFrame([row for name in NAMES for row in of(name)])
