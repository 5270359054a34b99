"""The protocol *square and circle* on simulated X and Y axes: both figures both ways round, at two feeds.

A host sends velocity commands at the servo instants and sees the encoders, as a motion controller would: the velocity
of the path, and a little for how far the axes are off it. The corners are not rounded and the velocity jumps there, so
that drives show their time constants.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.control.stack import get
from ...envs.plant import gantry, heads
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario, machines
from .log import Log

FEEDS = (0.1, 0.4)
"""Of the axes' highest speed."""

FASTEST, SIDE = 400.0, (20.0, 150.0)
"""mm/s of a feed, and mm that a side has at least and at most; it takes half a second at the higher feed."""

GAIN = 2.0
"""1/s, with which the host goes back to its path; slow enough for drives of long time constants [A]."""

DITHER = 0.5
"""mm/s, added to the commands on the move, so that counts of the encoder fall at random."""

PAUSE = 0.6
"""s of rest before each figure."""


def path(fastest: float, travel: float) -> np.ndarray:
    """Places of the path, mm, one each millisecond, shape (periods, 2).

    Args:
        fastest: mm/s, highest speed of the axes.
        travel: mm, of the shorter axis.
    """
    feeds = [min(share * fastest, FASTEST * share / FEEDS[-1]) for share in FEEDS]
    side = min(float(np.clip(0.5 * feeds[-1], *SIDE)), 0.5 * travel)
    here, rest, pieces = np.array([0.4 * side, 0.0]), round(PAUSE / PERIOD), []
    for feed in feeds:
        for way in (1.0, -1.0):
            for corners in (_square(side, way), _circle(side, way)):
                at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
                s = np.arange(0.0, at[-1], feed * PERIOD)
                line = np.stack([np.interp(s, at, corners[:, k]) for k in (0, 1)], axis=1)
                pieces += [np.tile(here, (rest, 1)), line]
    return np.concatenate([*pieces, np.tile(here, (rest, 1))]) - here


def _square(side: float, way: float) -> np.ndarray:
    """A square that begins and ends on its lower side."""
    corners = np.array([[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]])
    around = corners[[1, 2, 3, 0] if way > 0 else [0, 3, 2, 1]]
    begin = [0.4 * side, 0.0]
    return np.array([begin, *around, begin])


def _circle(side: float, way: float) -> np.ndarray:
    """A circle that touches the square's lower side where that begins."""
    angle = way * np.linspace(0.0, 2 * np.pi, 721) - 0.5 * np.pi
    return np.array([0.4 * side, 0.4 * side]) + 0.4 * side * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def record(machine: Any, seed: int = 0) -> Log:
    """The log of the protocol on a machine, see :func:`protocols.record`."""
    cuts, rng = machines.load(machine), np.random.default_rng(seed)
    fleet, look, sent = _begun(cuts, seed)
    wanted = path(scenarios.axes_of(cuts.gantry).speed, min(cuts.gantry.travel_x, cuts.gantry.travel_y))
    velocity = np.diff(wanted, axis=0, append=wanted[-1:]) / PERIOD
    due = fleet.gantries.slots(gantry.DUE, 1) if fleet.gantries else np.zeros(1)
    rows, now, asked = [], np.zeros(2), np.zeros(2)
    for place, pace in zip(wanted, velocity, strict=True):
        if due[0] > 0.5:  # a servo instant: what is sent now comes into force
            asked = pace + GAIN * (place - now)
            asked = asked + DITHER * rng.uniform(-1, 1, 2) * (np.hypot(*pace) > 0)
        sent(asked)
        fleet.advance()
        now = look()
        rows.append([*asked, *now])
    vx, vy, x, y = np.array(rows).T
    columns = {"time": np.arange(len(rows)) * PERIOD, "x": x, "y": y, "x_command": vx, "y_command": vy}
    return Log("square.csv", "square", columns)


def _begun(cuts: machines.Machine, seed: int) -> tuple[Fleet, Callable[[], np.ndarray], Callable[[np.ndarray], None]]:
    """Axes at rest, what their encoders read, and where their commands are written."""
    # Only a scenario with a job has X and Y axes; the job itself is never begun.
    flat = Scenario(name="square", job=scenarios.Job(part="square", material="mild-steel", thickness=3.0))
    fleet, seeds = Fleet(1, get("idle").law, heads.POOL), np.array([seed], np.uint64)
    g = fleet.use_gantries(get("wu").law, get("recipe").law)  # the host's commands take the place of that law's
    scenarios.prepare(fleet, machines.put_on(flat, cuts), [0], seeds)
    get("idle").install(fleet, np.arange(1))
    fleet.begin([0], scenarios.noise_keys(seeds))
    p = g.get("xy")
    seen = [g.row(f"{axis}.{'summed' if p.literal else 'position'}") for axis in "xy"]
    wish = [g.row(f"velocities.{axis}") for axis in "xy"]

    def look() -> np.ndarray:
        at = np.array([float(each[0]) for each in seen])
        return np.rint(at / p.encoder) * p.encoder if p.encoder > 0 else at

    def send(command: np.ndarray) -> None:
        for place, value in zip(wish, command, strict=True):
            place[0] = value

    return fleet, look, send


def truth(machine: Any, seed: int) -> dict[str, float]:
    """What the axes of a drawn machine are, by the keys of a machine's ``[gantry]``."""
    fleet, _, _ = _begun(machines.load(machine), seed)
    assert fleet.gantries is not None
    p = fleet.gantries.get("xy")
    names = ("x_plus", "x_minus", "y_plus", "y_minus", "t1", "t2", "acceleration")
    return {name: float(getattr(p, name)) for name in names}
