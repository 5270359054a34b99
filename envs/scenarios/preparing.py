"""From a scenario to machines: every number is drawn for each seed and written where the plant reads it."""

import functools
from typing import Any

import numpy as np

from ..plant import heads, sensor, spot, xy_axes, z_axis
from ..plant.controller import PERIOD
from ..plant.fleet import Fleet
from .distributions import Draws, draw
from .hardware import Head
from .laying import put_sheet
from .measured import measured_head, signal
from .schema import Scenario, journey
from .section import Section
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

    def value(section: Section, name: str, label: str) -> Any:
        return draw(getattr(section, name), draws, label + name)

    with fleet.writing(m, again):
        _prepare_axis(fleet, m, functools.partial(value, scenario.axis, label="axis."))
        _prepare_head(fleet, scenario.head, m, draws, functools.partial(value, scenario.head, label="head."))
        put_sheet(fleet, scenario, m, draws)
        if fleet.gantries is not None:
            _prepare_gantry(fleet, scenario, m, draws)
        travelled = journey(scenario)
        if travelled:
            fleet.put_contours([travelled], np.zeros(len(m), int), m)
        else:
            fleet.set("path.contour", m, -1.0)
        fleet.set("path.lap", m, scenario.circle.length if scenario.circle else 0.0)
        set_height = value(scenario, "set_height", "")
        fleet.set("path.feed", m, value(scenario, "feed", ""))
        _prepare_corners(fleet, scenario.corners, m, draws)
        _prepare_turns(fleet, scenario.turns, m)
        fleet.set("job.set_height", m, set_height)
        fleet.set("job.hole_guard", m, float(scenario.guard))
        fleet.set("start.gap", m, set_height + value(scenario, "start_above", ""))


def _prepare_axis(fleet: Fleet, m: np.ndarray, value: Any) -> None:
    bits, speed = value("dac_bits"), value("speed")
    columns = {
        "omega": 2 * np.pi * value("bandwidth"),
        "zeta": value("zeta"),
        "speed": speed,
        "acceleration": value("acceleration"),
        "jerk": value("jerk"),
        "dead_time": (value("dead_time") + value("latency")) / PERIOD,
        "dac": np.where(bits > 0, speed / 2.0 ** np.maximum(bits - 1, 0), 0.0),
        "encoder": value("encoder"),
        "friction": value("friction"),
        "bristle": value("bristle"),
        "stiction": value("stiction"),
        "stribeck": value("stribeck"),
        "backlash": value("backlash"),
        "omega_r": 2 * np.pi * value("resonance"),
        "zeta_r": value("resonance_zeta"),
        "compliance": value("compliance"),
    }
    assert set(columns) <= set(z_axis.Params._fields)
    for name, column in columns.items():
        fleet.set(f"z.{name}", m, column)


def _prepare_head(fleet: Fleet, head: Head, m: np.ndarray, draws: Draws, value: Any) -> None:
    which = np.zeros(len(m), int) if head.nominal else (draws.fraction("head") * heads.HEADS).astype(int)
    which = which + heads.HEADS * heads.OSCILLATORS.index(head.oscillator)
    for index in set(which.tolist()):
        heads.table(index)
    index = np.full(len(m), measured_head(head.table)) if head.table else which
    fleet.set("start.head", m, index.astype(float))
    fleet.set("job.most_frequency", m, heads.beyond(index))
    fleet.replay(signal(head.signal) if head.signal else None)
    for name, column in zip(heads.FIELDS, heads.fields()[:, which], strict=True):
        fleet.set(f"sensor.{name}", m, column)
    columns = {
        "noise": value("noise"),
        "jitter": value("jitter"),
        "drift": value("drift"),
        "warming": 1 - np.exp(-PERIOD / value("warming")),
        "impulses": value("impulses") * PERIOD,
        "longest": value("impulse_samples"),
        "impulse": value("impulse_height"),
        "falloff": value("impulse_falloff"),
        "spread": value("impulse_spread"),
        "bursts": value("bursts") * PERIOD,
        "burst": value("burst"),
        "burst_end": 1 - np.exp(-PERIOD / value("burst_length")),
        "plasma": value("plasma"),
    }
    assert {*columns, *heads.FIELDS} == set(sensor.Params._fields)
    for name, column in columns.items():
        fleet.set(f"sensor.{name}", m, column)


GANTRIES = {
    "wu": xy_axes.Params(),
    # A machine of today: servo and interpolation every millisecond, 100 m/min, 1.5 g [A].
    "modern": xy_axes.Params(
        servo=1.0, interpolation=1.0, t1=0.003, t2=0.001, gain=1.0, speed=1666.7, acceleration=15000.0,
        dac=1666.7 / 32768.0, encoder=1e-3,
    ),
}  # fmt: skip
"""Axes by name."""


def _prepare_gantry(fleet: Fleet, scenario: Scenario, m: np.ndarray, draws: Draws) -> None:
    assert fleet.gantries
    g, shape = scenario.gantry, scenario.optics
    base = GANTRIES[g.preset]
    slower = draw(g.slower, draws, "gantry.slower")
    fleet.gantries.put("xy", m, base._replace(literal=g.literal))
    for name in ("x_plus", "x_minus", "y_plus", "y_minus"):
        fleet.gantries.set(f"xy.{name}", m, draw(getattr(g, name), draws, f"gantry.{name}"))
    for name in ("t1", "t2", "tau"):
        fleet.gantries.set(f"xy.{name}", m, getattr(base, name) * slower)
    for name in ("galvo", "galvo_range", "piezo", "piezo_range", "hysteresis", "highest"):
        fleet.gantries.set(f"optics.{name}", m, draw(getattr(shape, name), draws, f"optics.{name}"))
    fleet.gantries.set("optics.shape", m, float(spot.SHAPES.index(shape.shape)))
    fleet.gantries.set("optics.along", m, float(shape.along))
    if scenario.job:
        fleet.gantries.set("cut.pressure", m, draw(scenario.job.pressure, draws, "job.pressure"))
        fleet.gantries.set("recipe.offset", m, draw(scenario.job.standoff, draws, "job.standoff"))


def _prepare_corners(fleet: Fleet, corners: Corners | None, m: np.ndarray, draws: Draws) -> None:
    fleet.set("path.corner", m, draw(corners.pitch, draws, "corners.pitch") if corners else 0.0)
    if corners:
        fleet.set("path.corner_feed", m, draw(corners.feed, draws, "corners.feed"))
        fleet.set("path.corner_acceleration", m, draw(corners.acceleration, draws, "corners.acceleration"))
        fleet.set("path.corner_phase", m, draws.fraction("corners.phase"))


def _prepare_turns(fleet: Fleet, turns: Turns | None, m: np.ndarray) -> None:
    fleet.set("turns.length", m, turns.length if turns else 0.0)
    if turns:
        fleet.set("turns.many", m, float(turns.count))
        for name in ("waves", "random", "vibrations", "impulses"):
            fleet.set(f"turns.{name}", m, turns.mask(name))
        fleet.use_turns()
