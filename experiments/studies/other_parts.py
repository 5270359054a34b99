"""Studies of jobs beyond their suites: other axes, other feeds, parts that nobody was trained or tuned on."""

from typing import Any

from ...envs import scenarios
from ...envs.scenarios import Scenario
from ...envs.tasks import workshop
from ..measure.grids import Grid, split_seeds
from ..store.stamp import LAWS, LOADED, PLANNED, POLICIES, suite, trained
from .registry import Trial, study
from .suites import benchmarked, concluded

SEEDS = 4

_GAINS = ("x_plus", "x_minus", "y_plus", "y_minus")
_NOMINAL = dict.fromkeys(("slower", *_GAINS), 1.0)

AXES: dict[str, tuple[str, dict[str, Any]]] = {
    "plain": ("as in the suite", {}),
    "nominal": ("the nominal drives, of which nothing is to be learnt", {"gantry": _NOMINAL}),
    "slower": ("drives with time constants 40 % longer", {"gantry": {"slower": 1.4}}),
    "stiffer": ("gains 20 % higher", {"gantry": {"x_plus": 1.2, "x_minus": 1.2, "y_plus": 1.2, "y_minus": 1.2}}),
    "unequal": (
        "gains 10 % off in opposite directions",
        {"gantry": {"x_plus": 1.1, "x_minus": 0.9, "y_plus": 0.9, "y_minus": 1.1}},
    ),
    "drawn": (
        "drawn: gains within 10 %, time constants within 20 %",
        {"gantry": {"slower": {"uniform": [0.8, 1.2]}, **{name: {"uniform": [0.9, 1.1]} for name in _GAINS}}},
    ),
    "half": ("half the feed", {"feed": 0.5}),
    "faster": ("one and a half times the feed", {"feed": 1.5}),
    "modern": ('the axes `gantry.preset = "modern"`', {"gantry": {"preset": "modern"}}),
}
"""Conditions under which contours are followed: in words, and what is changed; ``feed`` is a factor."""

JOBS = ("contour-gear", "contour-corners", "contour-slots")
CONTOUR = ("wu-tuned", "wu-feedforward", "wu-stiff", "wu-inverse", "contour-following-ppo")
CUTTING = ("huang2024-dynamic", "huang2024-adjusting", "huang2024-tuned", "cutting-ppo")
OTHERS = ("gear", "rosette", "slot-plate")


def beyond() -> list[Scenario]:
    """Every condition of :data:`AXES` on every job of :data:`JOBS`, named ``<job>-<condition>``."""
    found = []
    for job in JOBS:
        plain = scenarios.load(job)
        for name, (_, changes) in AXES.items():
            changes = dict(changes)
            if "feed" in changes:
                changes["job"] = {"feed": workshop.material_of(plain).feed * changes.pop("feed")}
            found.append(plain.varied(name=f"{job}-{name}", **changes))
    return found


@study(
    "contour-beyond",
    "axes and feeds that nobody was trained on",
    "python -m kerfgym.experiments.manual contour-beyond",
    2.0,
    (*LOADED, *PLANNED, *LAWS, *POLICIES, *suite("contour"), *trained("contour-")),
)
def contour_beyond(trial: Trial) -> dict[str, Any]:
    """On *tune* seeds, because it is no part of the suite."""
    cases = tuple(beyond())
    grid = Grid("contour", CONTOUR, cases, split_seeds(SEEDS, "tune"), tuple(case.name for case in cases))
    found = concluded(benchmarked(trial, grid, trial.study.command.split(), with_ms=False))
    numbers = {name: {"rms": row["rms"], "collided": row["collided"]} for name, row in found["numbers"].items()}
    return {"seeds": found["seeds"], "wall_seconds": found["wall_seconds"], "numbers": numbers}


@study(
    "cutting-parts",
    "parts that neither policy nor rules have seen",
    "python -m kerfgym.experiments.manual cutting-parts",
    2.0,
    (*LOADED, *PLANNED, *LAWS, *POLICIES, *suite("cutting"), *trained("cutting-")),
)
def cutting_parts(trial: Trial) -> dict[str, Any]:
    """The first scenario of the suite with other parts, on test seeds."""
    plain = scenarios.load(scenarios.rules("cutting")["along"])
    cases = tuple(plain.varied(name=f"cut-{part}", job={"part": part, "size": 0.0}) for part in OTHERS)
    grid = Grid("cutting", CUTTING, cases, split_seeds(SEEDS), tuple(case.name for case in cases))
    return concluded(benchmarked(trial, grid, trial.study.command.split(), with_ms=False))
