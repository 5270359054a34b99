"""The exported C in the loop beside the controller that it was made of: score, Ms and margins."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...envs import scenarios
from ...envs.control import exported
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.figures.metrics import rms_true
from ...envs.safety import files
from ..measure import margins, rollout
from ..statistics.pooling import over_scenarios, over_seeds

SEEDS = 20
"""Test seeds of each scenario."""


@dataclass(frozen=True)
class Compared:
    """Of controller and C.

    Attributes:
        same: whether the true gap has the same bits in all runs.
        score: RMS of the true gap error over the core of the suite, µm, as a benchmark pools it.
        collisions: runs with one.
        farthest: mm, largest difference of the true gap.
        margins: Ms, gain and delay margin on the corner plants of the standard machine.
    """

    same: bool
    score: tuple[float, float]
    collisions: tuple[int, int]
    farthest: float
    margins: tuple[margins.Margins, margins.Margins]

    @property
    def change(self) -> float:
        """Of the score, relative."""
        return self.score[1] / self.score[0] - 1.0


def compared(controller: Stack, code: Stack, suite: str = "following", seeds: int = SEEDS) -> Compared:
    """Both on the core of a suite."""
    those, scores, farthest, same = np.asarray(scenarios.SPLITS["test"][:seeds], np.uint64), [], 0.0, True
    collisions = np.zeros(2, int)
    for name in scenarios.core(suite):
        case = scenarios.load(name)
        runs = [rollout.roll(case, stack, case.some(those)) for stack in (controller, code)]
        one, other = (run["gap"] for run in runs)
        same = same and np.array_equal(one, other, equal_nan=True)
        farthest = max(farthest, float(np.nanmax(np.abs(one - other))))
        scores.append([over_seeds("rms_true", rms_true(run)) for run in runs])
        collisions += [int(run.collided.sum()) for run in runs]
    pooled = [over_scenarios("rms_true", column) for column in zip(*scores, strict=True)]
    room = (margins.margins(controller), margins.margins(code))
    return Compared(same, (pooled[0], pooled[1]), (int(collisions[0]), int(collisions[1])), farthest, room)


def told(folder: Path) -> list[str]:
    """What comparing an exported folder with the controller of its record says; that it is not there, if so."""
    name = str(files.json_(folder / exported.MANIFEST)["controller"])
    try:
        controller = stacks.resolve(name)
    except ValueError as error:
        return [f"in the loop: not compared, since '{name}' is not there ({error})"]
    found = compared(controller, stacks.resolve(str(folder)))
    one, other = found.margins
    how = "the same bits" if found.same else f"{found.change:+.3%}, gap at most {1e3 * found.farthest:.2g} µm apart"
    words = f"core of following, {SEEDS} test seeds: {name} {found.score[0]:.3f} µm, C {found.score[1]:.3f} µm: {how}"
    lines = [f"{words}; collisions {found.collisions[0]} and {found.collisions[1]}"]
    for title, a, b in (("Ms", one.ms, other.ms), ("gain margin", one.gain, other.gain),
                        ("delay margin, ms", one.delay_ms, other.delay_ms)):  # fmt: skip
        lines.append(f"{title}: {a:.4g}, C {b:.4g}")
    return lines
