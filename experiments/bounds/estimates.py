"""An estimate of what is left to a controller that keeps the set height from the start and learns all that was drawn.

It knows the machine and the ensemble, and learns phases, amplitudes, frequencies and slopes from the readings. Sizes
are taken as normal with the mean square that was drawn, frequencies by the Cramér–Rao inequality (Cramér 1946)
linearised at those drawn. Both may be on either side of the truth: a normal prior is the one of its variance that knows
least, so where the readings do not outweigh it the truth is lower; and a linearised frequency is learned faster than
one that is not known well. So this is no bound.
"""

import numpy as np

from ...envs import scenarios
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from . import shapes
from .ingredients import Lines
from .shapes import Shapes


def drawn_part(lines: Lines, i: int, fleet: Fleet, scenario: Scenario, spread: np.ndarray) -> Shapes:
    """Shapes of machine ``i``: its slope and its sines, with ``spread`` (rad²/s², one a line) of unknown frequency."""
    t = np.arange(1, scenario.steps + 1) * PERIOD
    parts = []
    low, high = scenarios.bounds(scenario.sheet.tilt)
    if (low, high) != (0.0, 0.0):
        # Of a slope that is drawn evenly; its sign is not known either.
        mean = (low * low + low * high + high * high) / 3.0
        parts.append(shapes.ramp(1e3 * t * fleet.column("path.feed")[i], mean))
    for line in range(len(lines.omega)):
        amplitude, omega, phase, gain = (
            float(each[line, i]) for each in (lines.amplitude, lines.omega, lines.phase, lines.sensor)
        )
        if amplitude == 0.0:  # a band
            continue
        parts.append(shapes.sine(omega * t, amplitude**2 / 2.0, gain))
        parts.append(shapes.stretch(omega * t + phase, t, amplitude, float(spread[line]), gain))
    if scenario.sheet.bulge:
        low, high = scenarios.bounds(scenario.sheet.bulge.height)
        if high > low:  # evenly drawn between them, or known
            parts.append(shapes.ramp(1e3 * bulge(fleet, i, t), (high - low) ** 2 / 12.0))
    return shapes.joined(parts, scenario.steps)


def bulge(fleet: Fleet, i: int, t: np.ndarray) -> np.ndarray:
    """Course of machine ``i``'s thermal bulge, for a height of 1, at the times ``t``, shape (periods,)."""
    p = fleet.get("sheet", i)
    grown = 1.0 - (1.0 - p.bulge_growth) ** (t / PERIOD)
    away = np.hypot(t * fleet.column("path.feed")[i] - p.bulge_x, p.bulge_y) / p.bulge_width
    return np.asarray(grown * (0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1.0))))
