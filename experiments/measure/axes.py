"""The X/Y axes alone: journeys given as points, travelled by the machine's position loops and seen every period."""

from collections.abc import Iterable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from ...baselines import wu
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.plant import heads, xy_axes
from ...envs.plant.fleet import Fleet

Floats = npt.NDArray[np.float64]

IDEAL: dict[str, Any] = {"dac": 0.0, "encoder": 0.0, "acceleration": 1e9, "speed": 1e9}
"""Axes without quantisation and limits: what Wu's difference equations describe."""

_LEFT = 20  # ms of a journey that are not travelled: interpolation and buffer are ahead


def journey(x: Floats, y: Floats) -> Any:
    """A job that passes the points (x, y), mm, one per millisecond, whatever the axes can do."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    way = np.hypot(np.diff(x), np.diff(y))
    s = np.concatenate([[0.0], np.cumsum(way)])
    tx, ty = np.gradient(x), np.gradient(y)
    length, none = np.maximum(np.hypot(tx, ty), 1e-12), np.zeros(len(x))
    way = np.append(way, way[-1]) * 1e3
    along = {"x": x, "y": y, "s": s, "feed": way, "tx": tx / length, "ty": ty / length, "cut_s": s}
    unused = {"beam": none, "phase": none, "lift": none, "most": none + 2.0, "patience": 0.0}
    return SimpleNamespace(**along, **unused, cut_feed=float(max(way.max(), 1.0)))


def line(speeds: Floats, angle: float = 0.0) -> Any:
    """A straight journey at ``speeds`` (mm/s, one each millisecond) under ``angle`` rad from x."""
    along = np.cumsum(speeds) * 1e-3
    return journey(along * np.cos(angle), along * np.sin(angle))


def circle(radius: float, speeds: Floats, sense: float = 1.0) -> Any:
    """A circle about the origin from (radius, 0) at ``speeds``; ``sense`` 1: counter-clockwise, −1: clockwise."""
    angle = sense * np.cumsum(speeds) * 1e-3 / radius
    return journey(radius * np.cos(angle), radius * np.sin(angle))


def from_rest(speed: float, rise: int, periods: int) -> Floats:
    """Speeds that rise evenly over ``rise`` ms and then stay, mm/s."""
    return speed * np.minimum(np.arange(periods) / rise, 1.0)


def gain(kv: float, p: xy_axes.Params) -> float:
    """Kp for a velocity gain in 1/s at Kn = 0.2."""
    return kv * p.servo * 1e-3 / (wu.Params().kn * p.gain)


def fleet_of(journeys: Sequence[Any], axes: Sequence[xy_axes.Params], laws: Sequence[wu.Params]) -> Fleet:
    """One machine per journey, at rest at its first point."""
    size = len(journeys)
    fleet, every = Fleet(size, stacks.get("idle").law, heads.POOL), np.arange(size)
    g = fleet.use_gantries(stacks.get("wu").law, stacks.get("recipe").law)
    scenarios.prepare(fleet, scenarios.Scenario(name="axes"), every, every)
    for i in range(size):
        g.put_job(journeys[i], [i])
        g.put_axes([i], axes[i])
        g.put_law("xy", [i], laws[i])
    fleet.begin(every, every)
    return fleet


def travelled(
    runs: Iterable[tuple[Any, xy_axes.Params, wu.Params]], fields: Sequence[str], every: int = 1
) -> dict[str, Floats]:
    """Fields of the gantries, arrays (periods / ``every``, machines), see ``gantry.PLACES`` for their names.

    A run is a journey, its axes and its law. The last 20 ms of a journey are not travelled, since the interpolator is
    ahead of the axes.
    """
    journeys, axes, laws = zip(*runs, strict=True)
    fleet = fleet_of(journeys, axes, laws)
    assert fleet.gantries
    seen: dict[str, list[Floats]] = {name: [] for name in fields}
    for _ in range((max(len(j.x) for j in journeys) - _LEFT) // every):
        fleet.advance(every)
        for name in fields:
            seen[name].append(fleet.gantries.column(name))
    return {name: np.array(values) for name, values in seen.items()}
