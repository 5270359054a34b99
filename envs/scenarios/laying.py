"""The sheets of machines: waves, vibrations, random sheets, steps, holes, bulges and measured surfaces."""

import numpy as np

from ..plant import sheet
from ..plant.controller import PERIOD
from ..plant.fleet import Fleet
from .distributions import Draws, draw
from .measured import height_map, profile
from .schema import Scenario
from .splits import pairs_of
from .surface import Holes, Random, Steps


def put_sheet(fleet: Fleet, scenario: Scenario, m: np.ndarray, draws: Draws) -> None:
    """Writes the sheet of ``scenario`` into the columns of machines ``m``, one draw each."""
    shape = scenario.sheet
    plate = scenario.head.plate
    fleet.put_plate(m, plate)
    fleet.set("sheet.tilt_x", m, draw(shape.tilt, draws, "sheet.tilt"))
    fleet.set("sheet.length", m, shape.length)
    fleet.set("sheet.tilt_y", m, draw(shape.tilt_y, draws, "sheet.tilt_y"))
    for i in range(sheet.WAVES):
        if i < len(shape.waves):
            w, label = shape.waves[i], f"sheet.waves.{i}."
            length = draw(w.wavelength, draws, label + "wavelength")
            relative = (length / draw(w.reference, draws, label + "reference")) ** draw(
                w.exponent, draws, label + "exponent"
            )
            angle = np.deg2rad(draw(w.direction, draws, label + "direction"))
            k, phase = 2 * np.pi / length, 2 * np.pi * draws.fraction(label + "phase")
            amplitude = draw(w.amplitude, draws, label + "amplitude") * relative
            fleet.put_wave(m, i, amplitude, k * np.cos(angle), k * np.sin(angle), phase, plate)
        elif i < fleet.waves:
            fleet.put_wave(m, i, 0.0, 0.0, 0.0, 0.0)
    for i in range(sheet.VIBRATIONS):
        if i < len(shape.vibrations):
            v, label = shape.vibrations[i], f"sheet.vibrations.{i}."
            fleet.put_vibration(
                m, i, draw(v.amplitude, draws, label + "amplitude"), draw(v.frequency, draws, label + "frequency"),
                2 * np.pi * draws.fraction(label + "phase"), draw(v.zeta, draws, label + "zeta"),
            )  # fmt: skip
        elif i < fleet.vibrations:
            fleet.put_vibration(m, i, 0.0, 0.0, 0.0)
    _put_random(fleet, shape.random, plate, m, draws)
    fleet.clear_features(m)
    if shape.steps:
        _put_steps(fleet, shape.steps, m, draws)
    if shape.holes:
        _put_holes(fleet, shape.holes, m, draws)
    b = shape.bulge
    fleet.set("sheet.bulge", m, draw(b.height, draws, "sheet.bulge.height") if b else 0.0)
    if b:
        fleet.set("sheet.bulge_width", m, draw(b.width, draws, "sheet.bulge.width"))
        fleet.set("sheet.bulge_growth", m, 1 - np.exp(-PERIOD / draw(b.growth, draws, "sheet.bulge.growth")))
        fleet.set("sheet.bulge_x", m, draw(b.x, draws, "sheet.bulge.x"))
        fleet.set("sheet.bulge_y", m, draw(b.y, draws, "sheet.bulge.y"))
        fleet.use_bulges()
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
    rms, angle = draw(random.rms, draws, "sheet.random.rms"), 2 * np.pi * draws.fraction("sheet.random.share")
    begin = [
        n * sheet.RANDOM_SPACING * draws.fraction(f"sheet.random.begin.{i}")
        for i, n in enumerate((sheet.RANDOM_ONE, sheet.RANDOM_TWO))
    ]
    source, sizes = (random.exponent, random.rolloff, plate), (rms * np.cos(angle), rms * np.sin(angle))
    fleet.put_random(m, source, pairs_of(draws.seeds), (*sizes, *begin))


def _put_steps(fleet: Fleet, steps: Steps, m: np.ndarray, draws: Draws) -> None:
    at = np.zeros(len(m))
    for i in range(steps.count):
        at = at + draw(steps.spacing, draws, f"sheet.steps.{i}.spacing")
        fleet.put_feature(m, i, at, sheet.FAR, draw(steps.height, draws, f"sheet.steps.{i}.height"), 0.0)


def _put_holes(fleet: Fleet, holes: Holes, m: np.ndarray, draws: Draws) -> None:
    previous = np.full(len(m), -sheet.SPACING)
    for i in range(holes.count):
        label = f"sheet.holes.{i}."
        length, rise = draw(holes.length, draws, label + "length"), draw(holes.rise, draws, label + "rise")
        middle = (i + 0.5) * draw(holes.pitch, draws, "sheet.holes.pitch") + draw(holes.jitter, draws, label + "jitter")
        start = np.maximum(middle - length / 2, previous + sheet.SPACING)
        previous = start + length
        # A round hole is as wide across as its mean chord; slots and edges are wider than any sensor.
        across = np.where(rise > 0, 0.0, length * np.pi / 4 if holes.round else sheet.FAR)
        fleet.put_feature(m, i, start, start + length, rise, across)
