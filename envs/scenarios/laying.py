"""The sheets of machines: waves, vibrations, random sheets, steps, holes, bulges and measured surfaces."""

from typing import Any

import numpy as np

from ..plant import sheet
from ..plant.controller import PERIOD
from ..plant.fleet import Fleet
from .distributions import Drawn, Draws
from .measured import height_map, profile
from .schema import Scenario
from .splits import pairs_of
from .surface import Holes, Random, Steps


def put_sheet(fleet: Fleet, scenario: Scenario, m: np.ndarray, draws: Draws) -> None:
    """Writes the sheet of ``scenario`` into the columns of machines ``m``, one draw each."""
    shape, own = scenario.sheet, Drawn(scenario.sheet, draws, "sheet")
    plate = scenario.head.plate
    fleet.put_plate(m, plate)
    for i in range(sheet.WAVES):
        if i < len(shape.waves):
            w, label = Drawn(shape.waves[i], draws, f"sheet.waves.{i}"), f"sheet.waves.{i}."
            angle = np.deg2rad(w.direction)
            k, phase = 2 * np.pi / w.wavelength, 2 * np.pi * draws.fraction(label + "phase")
            amplitude = w.amplitude * (w.wavelength / w.reference) ** w.exponent
            fleet.put_wave(m, i, amplitude, k * np.cos(angle), k * np.sin(angle), phase, plate)
        elif i < fleet.waves:
            fleet.put_wave(m, i, 0.0, 0.0, 0.0, 0.0)
    for i in range(sheet.VIBRATIONS):
        if i < len(shape.vibrations):
            v, label = Drawn(shape.vibrations[i], draws, f"sheet.vibrations.{i}"), f"sheet.vibrations.{i}."
            phase = 2 * np.pi * draws.fraction(label + "phase")
            fleet.put_vibration(m, i, v.amplitude, v.frequency, phase, v.zeta)
        elif i < fleet.vibrations:
            fleet.put_vibration(m, i, 0.0, 0.0, 0.0)
    _put_random(fleet, shape.random, plate, m, draws)
    fleet.clear_features(m)
    if shape.steps:
        _put_steps(fleet, shape.steps, m, draws)
    if shape.holes:
        _put_holes(fleet, shape.holes, m, draws)
    bulge: dict[str, Any] = {"bulge": 0.0}
    if shape.bulge:
        b = Drawn(shape.bulge, draws, "sheet.bulge")
        growth = 1 - np.exp(-PERIOD / b.growth)
        bulge = {"bulge": b.height, "bulge_width": b.width, "bulge_growth": growth, "bulge_x": b.x, "bulge_y": b.y}
        fleet.use_bulges()
    own.into(fleet, "sheet", m, tilt_x=own.tilt, **bulge)
    if shape.map:
        fleet.put_map(*height_map(shape.map), m)
    elif shape.profile:
        fleet.put_profile(profile(shape.profile), shape.profile.spacing, m)
    else:
        fleet.set("path.profile", m, -1.0)


def _put_random(fleet: Fleet, random: Random | None, plate: float, m: np.ndarray, draws: Draws) -> None:
    if random is None:
        fleet.put_random(m, None)
        return
    rms, angle = Drawn(random, draws, "sheet.random").rms, 2 * np.pi * draws.fraction("sheet.random.share")
    begin = [
        n * sheet.RANDOM_SPACING * draws.fraction(f"sheet.random.begin.{i}")
        for i, n in enumerate((sheet.RANDOM_ONE, sheet.RANDOM_TWO))
    ]
    source, sizes = (random.exponent, random.rolloff, plate), (rms * np.cos(angle), rms * np.sin(angle))
    fleet.put_random(m, source, pairs_of(draws.seeds), (*sizes, *begin))


def _put_steps(fleet: Fleet, steps: Steps, m: np.ndarray, draws: Draws) -> None:
    at = np.zeros(len(m))
    for i in range(steps.count):
        own = Drawn(steps, draws, f"sheet.steps.{i}")
        at = at + own.spacing
        fleet.put_feature(m, i, at, sheet.FAR, own.height, 0.0)


def _put_holes(fleet: Fleet, holes: Holes, m: np.ndarray, draws: Draws) -> None:
    pitch, previous = Drawn(holes, draws, "sheet.holes").pitch, np.full(len(m), -sheet.SPACING)
    for i in range(holes.count):
        own = Drawn(holes, draws, f"sheet.holes.{i}")
        middle = (i + 0.5) * pitch + own.jitter
        start = np.maximum(middle - own.length / 2, previous + sheet.SPACING)
        previous = start + own.length
        # A round hole is as wide across as its mean chord; slots and edges are wider than any sensor.
        across = np.where(own.rise > 0, 0.0, own.length * np.pi / 4 if holes.round else sheet.FAR)
        fleet.put_feature(m, i, start, previous, own.rise, across)
