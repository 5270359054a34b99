"""Parts that stand proud: how many runs any controller with only the sensor must lose.

The first that tells of such a part is the sheet under the plate's rim. A controller that knows it in that very moment,
and can do no better than climb with all that the drive has, clears the part or does not: nobody who follows at the set
height until then can. :func:`lost` lets the machines do so. :func:`hopeless` says the same in closed form, with a drive
that lacks nothing but acceleration and dead time. Both hold for each part before which the head is back at the set
height; for the first one that is so.

    python -m kerfgym.experiments.studies.tip_up [FIRST:LAST]
"""

import sys

import numpy as np

from ...envs import scenarios
from ...envs.control import stack
from ...envs.engine.lanes import rows
from ...envs.plant import machine, sheet
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from ..measure import rollout

PARTS = 4
"""In the scenario."""

AWAY = 3.0
"""mm behind a part at which the head may come down again."""

GAIN, DOWN = 25.0, 200.0
"""1/s and mm/s, at which it then returns to the set height: in less than half the way to the next part."""

HIGH = 16.0
"""mm, above which it need not climb."""

CLIMBER = "idle:guard.rise=5"
"""With a guard that does not take a part's end for an edge, and so does not keep the head high until the next part."""

STEP = 0.05
"""ms of the closed form."""


def parts(fleet: Fleet) -> np.ndarray:
    """Start, end and height of each part, mm, shape (machines, parts, 3)."""
    each = np.uint64(rows(sheet.Feature) * machine.W)
    at = [machine.FEATURES + np.uint64(k) * each for k in range(PARTS)]
    return np.array([[fleet.slots(a, len(sheet.Feature._fields), i)[:3] for a in at] for i in range(fleet.size)])


def lost(scenario: Scenario, seeds: np.ndarray, late: float = 0.0) -> np.ndarray:
    """Whether a run collides that climbs as soon as the plate has been over a part for ``late`` mm; shape (seeds,)."""
    idle = stack.resolve(CLIMBER)
    fleet = rollout.fleet_for(scenario, idle, seeds)
    there, above = parts(fleet), fleet.column("job.set_height").copy()
    hands = [fleet.row("hand.residual", i) for i in range(fleet.size)]

    def climb(period: int) -> None:
        along, head = fleet.column("journey.here")[:, None], fleet.column("signals.head_position")
        over = ((along > there[:, :, 0] - sheet.PLATE + late) & (along < there[:, :, 1] + AWAY)).any(axis=1)
        wish = np.where(over, np.where(head < HIGH, 1e3, 0.0), np.maximum(GAIN * (above - head), -DOWN))
        for hand, speed in zip(hands, wish, strict=True):
            hand[0] = speed

    return rollout.run(fleet, scenario, idle, seeds, climb).collided


def clearable(fleet: Fleet) -> np.ndarray:
    """mm, the highest part that acceleration and dead time let a head clear from the set height, shape (machines,)."""
    feed, ready = fleet.column("path.feed")[:, None], fleet.column("z.dead_time")[:, None]
    time = np.arange(0.0, 2.0 * sheet.PLATE / feed.min() * 1e3, STEP)[None, :]
    climbed = 0.5 * fleet.column("z.acceleration")[:, None] * (PERIOD * np.maximum(time - ready, 0.0)) ** 2
    under = (feed * PERIOD * time - sheet.PLATE) / sheet.FOOTPRINT
    share = np.array([[sheet.share(u) for u in row] for row in under])
    return np.min((fleet.column("job.set_height")[:, None] + climbed) / np.maximum(share, 1e-9), axis=1)


def hopeless(scenario: Scenario, seeds: np.ndarray) -> np.ndarray:
    """Whether a part is higher than what is :func:`clearable`; shape (seeds, parts)."""
    fleet = rollout.fleet_for(scenario, stack.resolve(CLIMBER), seeds)
    return parts(fleet)[:, :, 2] > clearable(fleet)[:, None]


def main(asked: str = "200:400") -> None:
    """Prints both."""
    seeds, scenario = np.arange(*map(int, asked.split(":"))), scenarios.suite("following")["tip-up"]
    high = hopeless(scenario, seeds)
    print(f"a part higher than acceleration and dead time allow: {high.any(axis=1).sum()} of {len(seeds)} runs")
    print(f"the first part is, which nothing announces: {high[:, 0].sum()} of {len(seeds)} runs")
    for late in (0.0, 0.5, 1.0):
        print(f"lost, climbing {late:g} mm after the plate's rim: {lost(scenario, seeds, late).sum()} of {len(seeds)}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
