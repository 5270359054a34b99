"""One run of every shipped controller and policy, filter and sequence, as ``figures.csv`` keeps it."""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.figures import metrics
from kerfgym.envs.plant import filters
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.results import jobs
from kerfgym.tests.recorded import panel_runs

FILE = Path(__file__).with_name("figures.csv")

SEED = 1000
"""Of the scenarios."""

SCENARIOS = {
    "z": (
        "rough",
        "impulses",
        "step-flutter",
        "corners",
        "holes",
        "edge",
        "descent",
        "long-hole",
        "spatter-rough",
        "spatter-field",
        "laps-rough",
    ),
    "xy": ("contour-corners", "contour-one-way"),
    "process": ("cut-bulge", "cut-low-gas"),
}
"""By what the controller drives: each disturbance that a law or the supervisor has something against."""

METRICS = {
    "z": ("rms_true", "max_true", "rms_reported", "jitter", "z_travel", "min_gap", "dross", "roughness"),
    "xy": ("contour_rms", "contour_max", "gap_rms", "time", "mean_feed"),
    "process": ("contour_rms", "gap_rms", "time", "energy", "dross", "roughness", "kerf", "taper", "through"),
}

FILTERS = tuple(f"pid:filter.kind={kind},filter.window=9,filter.trim=2" for kind in filters.KINDS)

NAMES = [*sorted({*stack.names(), *stack.shelved()} - {"idle"}), *FILTERS, *panel_runs.EVERY]


def of(name: str) -> Iterator[dict[str, object]]:
    """Rows of one of them: itself, its scenario, and a figure with its name."""
    for scenario, metric, value in _of_sequence(name) if name in panel_runs.EVERY else _of_controller(name):
        yield {"name": name, "scenario": scenario, "metric": metric, "value": value}


def _of_sequence(name: str) -> Iterator[tuple[str, str, float]]:
    for metric, value in panel_runs.EVERY[name]().items():
        yield "panel", metric, value


def _of_controller(name: str) -> Iterator[tuple[str, str, float]]:
    team = stack.team(name)
    slot = stack.resolve(name.partition(":")[0]).slot
    for scenario in map(scenarios.load, SCENARIOS[slot]):
        if slot == "z":
            values = metrics.evaluate(rollout.roll(scenario, team.z, SEED))
        else:
            values = jobs.measured(scenario, team, (SEED,))[0].to_dict("list")
        for metric in METRICS[slot]:
            yield scenario.name, metric, float(values[metric][0])


def every() -> pd.DataFrame:
    """All rows."""
    return pd.DataFrame([row for name in NAMES for row in of(name)])
