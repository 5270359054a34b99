"""What one reading is worth: noise of the gap in µm, at the set height.

Only what is Gaussian makes the bound: capacitance noise and oscillator jitter. Counting acts on a reading that has
these in it already, so it can take information away and never add any; likewise impulses, which a controller may
recognise, and the quantisation of encoder and D/A, since who knows machine and commands knows where the head is.
Leaving them out keeps a bound a bound.
"""

import numpy as np

from ...envs.plant import sensor
from ...envs.plant.fleet import Fleet

_SMALL = 1e-4
"""mm, for a slope."""


def gaussian(fleet: Fleet) -> np.ndarray:
    """Sigma of each machine's readings, µm: capacitance noise and jitter, shape (machines,)."""
    return 1e3 * np.hypot(*_parts(fleet)[:2])


def ingredients(fleet: Fleet) -> dict[str, float]:
    """RMS over the machines of what disturbs a reading, µm, by name; those that the bound leaves out as well."""
    capacitance, jitter, counting = 1e3 * _parts(fleet)
    encoder, step = 1e3 * fleet.column("z.encoder"), 1e3 * fleet.column("z.dac")
    held = step * 1e-3  # mm/s over a control period of 1 ms
    parts = {
        "capacitance": capacitance, "jitter": jitter, "counting": counting, "encoder": encoder / np.sqrt(12.0),
        "d/a": held / np.sqrt(12.0),
    }  # fmt: skip
    return {name: float(np.sqrt(np.mean(np.square(part)))) for name, part in parts.items()}


def _parts(fleet: Fleet) -> np.ndarray:
    """Capacitance noise, jitter and counting of every machine, sigma in mm, shape (3, machines)."""
    out = []
    for i, height in enumerate(fleet.column("job.set_height").tolist()):
        p, gate = fleet.get("sensor", i), fleet.get("gate", i)

        def capacitance(gap: float, p: sensor.Params = p) -> float:
            return float(sensor.capacitance(p, gap, 1.0))

        def frequency(gap: float, p: sensor.Params = p) -> float:
            return float(sensor.oscillator(p, sensor.capacitance(p, gap, 1.0), 0.0))

        per_mm = [(each(height + _SMALL) - each(height - _SMALL)) / (2 * _SMALL) for each in (capacitance, frequency)]
        relative = frequency(height) / per_mm[1]  # mm for each unit of relative frequency
        counted = 1.0 / (np.sqrt(6.0) * sensor.CLOCK * gate.length * 1e-3)
        out.append((p.noise / abs(per_mm[0]), p.jitter * relative, counted * relative))
    return np.array(out).T
