"""Which protocol to record next: the one whose numbers move a controller's score most.

Machines are drawn from what is known, and from the priors where a log is missing; all run one short scenario with the
same sheet and noise. The share of the score's variance that a protocol's numbers make alone is their first-order index
(«Saltelli et al. 2010»), found from pairs of machines that have these numbers in common: the covariance of their scores
over the variance («Janon et al. 2014»). Were the numbers known, the rest of the variance would remain, on average.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.control.stack import Stack, asked, resolve
from ...envs.figures.metrics import rms_true
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario, machines
from ...envs.scenarios.machines import Machine
from ...envs.tasks import workshop
from ..measure import rollout
from . import drive, head, mounting
from .identifying import Identified, Number

MACHINES = 200
"""Drawn of what is known; once more so many for each protocol."""

HEADS = 12
"""Faces, bodies and coils among them: each needs a calibration table of its own."""

CAP = 1000.0
"""µm that a run which touches the sheet, or leaves it, counts as: the set height of the scenario."""

TELLS = {"sweep": tuple(f"head.{key}" for key in head.RANGES), "rest": ("head.noise", "head.jitter"),
         "motion": tuple(f"axis.{key}" for key in (*drive.PRIOR, "dead_time")),
         "motion near the plate": tuple(f"axis.{key}" for key in mounting.PRIOR)}  # fmt: skip
"""Numbers that each protocol tells; the third needs the frequency, and the sweep."""

RANGES = {
    "head": {**head.RANGES, "noise": head.NOISE, "jitter": head.JITTER},
    "axis": {**drive.PRIOR, **mounting.PRIOR, "dead_time": (5e-5, 0.02)},
}
"""Where a number lies that no log tells: uniform in the logarithm, but for the dead time."""


@dataclass(frozen=True)
class Gain:
    """A protocol with the score's SD now and were its numbers known, µm; whether a log of it is there already."""

    protocol: str
    now: float
    after: float
    recorded: bool


def first_order(y: np.ndarray, frozen: np.ndarray) -> float:
    """First-order index from scores of machines, and of others that have a group of numbers in common with each."""
    middle = 0.5 * (y + frozen)
    mean = float(middle.mean())
    total = float(np.mean(0.5 * (y**2 + frozen**2)) - mean**2)
    return float(np.clip((np.mean(y * frozen) - mean**2) / total, 0.0, 1.0)) if total > 0 else 0.0


def indices(score: Callable[[dict[str, np.ndarray]], np.ndarray], groups: dict[str, int], n: int, rng: Any) -> Any:
    """Scores of machines, and each group's first-order index.

    Args:
        score: of machines, given the draw that each has of each group, of shape (machines,).
        groups: number of draws by group; draws of different groups are independent.
        n: machines.
        rng: draws.
    """
    first = {name: rng.integers(0, size, n) for name, size in groups.items()}
    others = {name: rng.integers(0, size, n) for name, size in groups.items()}
    y = score(first)
    return y, {name: first_order(y, score({**others, name: first[name]})) for name in groups}


def draws_of(numbers: tuple[Number, ...], rng: Any, most: int = 1000) -> dict[str, dict[str, np.ndarray]]:
    """Draws by protocol and key: those that logs gave, joint, and the priors' of what has no log."""
    known, out = {n.key: n.draws for n in numbers}, {}
    ranges = {f"{table}.{key}": ends for table, of in RANGES.items() for key, ends in of.items()}
    for protocol, keys in TELLS.items():
        there = [key for key in keys if key in known]
        if there:
            out[protocol] = {key: known[key] for key in there}
            continue
        out[protocol] = {k: np.exp(rng.uniform(*np.log(ranges[k]), most)) for k in keys}
        if "axis.dead_time" in keys:
            out[protocol]["axis.dead_time"] = rng.uniform(*ranges["axis.dead_time"], most)
    few = rng.integers(0, len(next(iter(out["sweep"].values()))), HEADS)
    out["sweep"] = {key: values[few] for key, values in out["sweep"].items()}
    return out


def machine_of(base: Machine, draws: dict[str, dict[str, np.ndarray]], which: dict[str, int]) -> Machine:
    """The machine that has draw ``which`` of each protocol, and the rest of ``base``."""
    tables: dict[str, dict[str, Any]] = {"head": {"nominal": True}, "axis": {}}
    for protocol, columns in draws.items():
        for key, values in columns.items():
            table, name = key.split(".")
            tables[table][name] = float(values[which[protocol]])
    if "dead_time" in tables["axis"]:
        tables["axis"] |= {"latency": 0.0, "dead_time": min(tables["axis"]["dead_time"], 0.02)}
    return replace(base, head=replace(base.head, **tables["head"]), axis=replace(base.axis, **tables["axis"]))


def fleet_of(scenario: Scenario, stack: Stack, cuts: list[Machine], seed: int) -> tuple[Fleet, np.ndarray]:
    """One fleet of different machines, all with the sheet and noise of one seed, begun; and the seed of each."""
    fleet = workshop.empty_fleet(len(cuts), asked(stack))
    every, seeds = np.arange(len(cuts)), np.full(len(cuts), seed, np.uint64)
    for i, one in enumerate(cuts):
        scenarios.prepare(fleet, machines.put_on(scenario, one), every[i : i + 1], seeds[i : i + 1])
    stack.install(fleet, every)
    fleet.begin(every, scenarios.noise_keys(seeds))
    return fleet, seeds


def gains(
    found: Identified, like: Any, controller: str = "xi2023-improved", n: int = MACHINES, seed: int = 0
) -> list[Gain]:
    """Every protocol, that which helps most first."""
    rng, stack, base = np.random.default_rng(seed), resolve(controller), machines.load(like)
    scenario = scenarios.load("wavy").varied(duration=3.0)
    draws = draws_of(found.numbers, rng)

    def score(which: dict[str, np.ndarray]) -> np.ndarray:
        cuts = [machine_of(base, draws, {k: int(v[i]) for k, v in which.items()}) for i in range(n)]
        fleet, seeds = fleet_of(scenario, stack, cuts, seed)
        recording = rollout.run(fleet, scenario, stack, seeds)
        made = np.where(recording.collided, CAP, rms_true(recording))
        return np.minimum(np.where(np.isfinite(made), made, CAP), CAP)

    sizes = {protocol: len(next(iter(columns.values()))) for protocol, columns in draws.items()}
    y, share = indices(score, sizes, n, rng)
    now, there = float(np.std(y)), {key.key for key in found.numbers}
    out = [Gain(p, now, now * float(np.sqrt(1 - s)), bool(there & set(TELLS[p]))) for p, s in share.items()]
    return sorted(out, key=lambda gain: gain.after)
