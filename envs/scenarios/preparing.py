"""From a scenario to machines: every number is drawn for each seed and written where the plant reads it."""

import functools
from typing import Any

import numpy as np

from ..plant import heads, spot, xy_axes
from ..plant.controller import PERIOD
from ..plant.fleet import Fleet
from ..plant.gantries import Gantries
from .distributions import Drawn, Draws, draw, middle
from .hardware import Gantry, Head
from .laying import put_sheet
from .measured import measured_head, signal
from .schema import Scenario, journey
from .travel import Corners, Turns


def prepare(fleet: Fleet, scenario: Scenario, machines: Any, seeds: Any, again: bool = False) -> None:
    """Writes the physics of ``scenario`` into the columns of ``machines``, one seed each.

    Args:
        fleet: whose tables are the pool of :mod:`plant.heads`.
        machines: indices, shape (n,).
        seeds: scenario seeds, shape (n,).
        again: the machines have been prepared for this very scenario before, so what is fixed is there already.
    """
    m, draws = np.atleast_1d(machines), Draws(np.atleast_1d(np.asarray(seeds, np.uint64)), scenario.labels)

    with fleet.writing(m, again):
        _prepare_axis(fleet, Drawn(scenario.axis, draws, "axis"), m)
        _prepare_head(fleet, scenario.head, m, draws)
        put_sheet(fleet, scenario, m, draws)
        if fleet.gantries is not None:
            _prepare_gantry(fleet.gantries, scenario, m, draws)
        travelled = journey(scenario)
        if travelled:
            fleet.put_contours([travelled], np.zeros(len(m), int), m)
        else:
            fleet.set("path.contour", m, -1.0)
        own = Drawn(scenario, draws, "")
        fleet.set("path.lap", m, scenario.circle.length if scenario.circle else 0.0)
        fleet.set("path.feed", m, own.feed)
        _prepare_corners(fleet, scenario.corners, m, draws)
        _prepare_turns(fleet, scenario.turns, m, draws)
        fleet.set("job.set_height", m, own.set_height)
        fleet.set("job.hole_guard", m, own.guard)
        fleet.set("start.gap", m, own.set_height + own.start_above)


def _prepare_axis(fleet: Fleet, axis: Drawn, m: np.ndarray) -> None:
    late = (axis.dead_time + axis.latency) / PERIOD
    fleet.allow_delay(late)
    axis.into(
        fleet,
        "z",
        m,
        omega=2 * np.pi * axis.bandwidth,
        dead_time=late,
        dac=np.where(axis.dac_bits > 0, axis.speed / 2.0 ** np.maximum(axis.dac_bits - 1, 0), 0.0),
        omega_r=2 * np.pi * axis.resonance,
        zeta_r=axis.resonance_zeta,
    )


def _prepare_head(fleet: Fleet, head: Head, m: np.ndarray, draws: Draws) -> None:
    which = np.zeros(len(m), int) if head.nominal else (draws.fraction("head") * heads.HEADS).astype(int)
    which = which + (family(head) if head.geometry else heads.HEADS * heads.OSCILLATORS.index(head.oscillator))
    for index in set(which.tolist()):
        heads.table(index)
    index = np.full(len(m), measured_head(head.table)) if head.table else which
    fleet.set("start.head", m, index.astype(float))
    fleet.set("job.most_frequency", m, heads.beyond(index))
    fleet.replay(signal(head.signal) if head.signal else None)
    own = Drawn(head, draws, "head")
    own.into(
        fleet,
        "sensor",
        m,
        **dict(zip(heads.FIELDS, heads.fields(which), strict=True)),
        warming=1 - np.exp(-PERIOD / own.warming),
        impulses=own.impulses * PERIOD,
        longest=own.impulse_samples,
        impulse=own.impulse_height,
        falloff=own.impulse_falloff,
        spread=own.impulse_spread,
        bursts=own.bursts * PERIOD,
        burst_end=1 - np.exp(-PERIOD / own.burst_length),
    )


@functools.lru_cache(maxsize=256)
def family(head: Head) -> int:
    """Index of the first of the heads that a head with a geometry of its own stands for.

    What it gives as a value all of them have; what it gives as a distribution each draws for itself, the nominal one
    has its middle; the rest is that of the preset's heads.

    Raises:
        InvalidInput: its calibration run is refused.
    """
    first = heads.HEADS * heads.OSCILLATORS.index(head.oscillator)
    draws = Draws(np.arange(heads.HEADS).astype(np.uint64), {})
    members = [heads.head(first + n) for n in range(heads.HEADS)]
    for name, number in head.geometry.items():
        values = np.broadcast_to(draw(number, draws, f"family.{name}"), heads.HEADS).copy()
        values[0] = middle(number)
        field, scale = _PARTS[name]
        members = [m._replace(**{field: scale * float(v)}) for m, v in zip(members, values, strict=True)]
    return heads.family(tuple(members))


def family_member(head: Head, key: str) -> float:
    """What the nominal one of the preset's heads has of a key of its geometry."""
    field, scale = _PARTS[key]
    return float(getattr(heads.head(heads.HEADS * heads.OSCILLATORS.index(head.oscillator)), field) / scale)


_PARTS = {"face": ("radius", 0.5), "bore": ("bore", 0.5), "body": ("body", 1.0), "inductance": ("inductance", 1.0)}
"""What each key of a head's geometry is in the sensor, and times what."""


GANTRIES = {
    "wu": xy_axes.Params(),
    # A machine of today: servo and interpolation every millisecond, 100 m/min, 1.5 g [A].
    "modern": xy_axes.Params(
        servo=1.0,
        interpolation=1.0,
        t1=0.003,
        t2=0.001,
        gain=1.0,
        speed=1666.7,
        acceleration=15000.0,
        dac=1666.7 / 32768.0,
        encoder=1e-3,
    ),
}
"""Axes by name."""


def axes_of(gantry: Gantry) -> xy_axes.Params:
    """The axes' limits and loops as far as they are not drawn: the preset's, but for what is said otherwise."""
    base = GANTRIES[gantry.preset]
    speed = base.speed if gantry.speed is None else gantry.speed
    return base._replace(speed=speed, acceleration=gantry.acceleration or base.acceleration)


def _prepare_gantry(gantries: Gantries, scenario: Scenario, m: np.ndarray, draws: Draws) -> None:
    base, own = axes_of(scenario.gantry), Drawn(scenario.gantry, draws, "gantry")
    gantries.put("xy", m, base)
    slowed = {name: getattr(base, name) for name in ("t1", "t2", "tau")}
    slowed |= {name: getattr(own, name) for name in ("t1", "t2") if getattr(scenario.gantry, name) is not None}
    limits = {name: getattr(base, name) for name in ("speed", "acceleration")}
    own.into(gantries, "xy", m, **{name: value * own.slower for name, value in slowed.items()}, **limits)
    shape = float(spot.SHAPES.index(scenario.optics.shape))
    Drawn(scenario.optics, draws, "optics").into(gantries, "optics", m, shape=shape)
    if scenario.job:
        job = Drawn(scenario.job, draws, "job")
        gantries.set("cut.pressure", m, job.pressure)
        gantries.set("recipe.offset", m, job.standoff)


def _prepare_corners(fleet: Fleet, corners: Corners | None, m: np.ndarray, draws: Draws) -> None:
    if corners is None:
        fleet.set("path.corner", m, 0.0)
        return
    own = Drawn(corners, draws, "corners")
    fleet.set("path.corner", m, own.pitch)
    fleet.set("path.corner_feed", m, own.feed)
    fleet.set("path.corner_acceleration", m, own.acceleration)
    fleet.set("path.corner_phase", m, draws.fraction("corners.phase"))


def _prepare_turns(fleet: Fleet, turns: Turns | None, m: np.ndarray, draws: Draws) -> None:
    if turns is None:
        fleet.set("turns.length", m, 0.0)
        return
    masks = {name: turns.mask(name) for name in ("waves", "random", "vibrations", "impulses")}
    Drawn(turns, draws, "turns").into(fleet, "turns", m, many=float(turns.count), **masks)
    fleet.use_turns()
