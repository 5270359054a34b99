"""What one reading is worth: noise of the gap in µm, at the set height or at any other gap.

Only what is random for good makes the bound: capacitance noise and oscillator jitter. Counting acts on a reading that
has these in it already, so it can take information away and never add any; likewise impulses, which a controller may
recognise, and the quantisation of encoder and D/A, since who knows machine and commands knows where the head is.
Leaving them out keeps a bound a bound.
"""

from functools import partial

import numpy as np

from ...envs.plant import sensor
from ...envs.plant.fleet import Fleet
from .lowering import DEEP, DIPS, Sight

_RELATIVE = 1e-4
"""Of a gap, for a slope."""


def gaussian(fleet: Fleet) -> np.ndarray:
    """Sigma of each machine's readings at its set height, µm: capacitance noise and jitter, shape (machines,)."""
    return at(fleet, fleet.column("job.set_height"))


def finest(fleet: Fleet) -> np.ndarray:
    """The same at the least gap that the sensor resolves (:data:`sensor.LEAST_GAP`): no reading has less noise."""
    return at(fleet, np.full(fleet.size, sensor.LEAST_GAP))


def at(fleet: Fleet, gaps: np.ndarray) -> np.ndarray:
    """Sigma of each machine's readings at ``gaps`` (mm, one a machine), µm, shape (machines,)."""
    return 1e3 * np.hypot(*_all(fleet, gaps)[:2])


def sights(fleet: Fleet) -> list[Sight]:
    """What the readings of each machine are worth, at the set height and below it."""
    finest_, out = finest(fleet), []
    for i, height in enumerate(fleet.column("job.set_height").tolist()):
        depth = DEEP * height * np.linspace(0.0, 1.0, DIPS) ** 2  # most of them shallow
        sigma = np.array([np.hypot(*_parts(fleet, i, height - d)[:2]) for d in depth.tolist()])
        out.append(Sight(1e3 * float(sigma[0]), float(finest_[i]), 1e3 * depth, (sigma[0] / sigma) ** 2 - 1.0))
    return out


def ingredients(fleet: Fleet) -> dict[str, float]:
    """RMS over the machines of what disturbs a reading, µm, by name; those that the bound leaves out as well."""
    capacitance, jitter, counting = 1e3 * _all(fleet, fleet.column("job.set_height"))
    encoder, step = 1e3 * fleet.column("z.encoder"), 1e3 * fleet.column("z.dac")
    held = step * 1e-3  # mm/s over a control period of 1 ms
    parts = {"capacitance": capacitance, "jitter": jitter, "counting": counting}
    parts |= {"encoder": encoder / np.sqrt(12.0), "d/a": held / np.sqrt(12.0)}
    return {name: float(np.sqrt(np.mean(np.square(part)))) for name, part in parts.items()}


def _capacitance(p: sensor.Params, gap: float) -> float:
    return float(sensor.capacitance(p, gap, 1.0))


def _frequency(p: sensor.Params, gap: float) -> float:
    return float(sensor.oscillator(p, sensor.capacitance(p, gap, 1.0), 0.0))


def _all(fleet: Fleet, gaps: np.ndarray) -> np.ndarray:
    """Capacitance noise, jitter and counting of every machine at its gap, sigma in mm, shape (3, machines)."""
    return np.array([_parts(fleet, i, gap) for i, gap in enumerate(np.asarray(gaps).tolist())]).T


def _parts(fleet: Fleet, i: int, gap: float) -> tuple[float, float, float]:
    """Capacitance noise, jitter and counting of machine ``i``, sigma in mm."""
    p, gate, small = fleet.get("sensor", i), fleet.get("gate", i), _RELATIVE * gap
    per_mm, faster = (
        (each(gap + small) - each(gap - small)) / (2 * small)
        for each in (partial(_capacitance, p), partial(_frequency, p))
    )
    relative = _frequency(p, gap) / faster  # mm for each unit of relative frequency
    counted = 1.0 / (np.sqrt(6.0) * sensor.CLOCK * gate.length * 1e-3)
    return p.noise / abs(per_mm), p.jitter * relative, counted * relative
