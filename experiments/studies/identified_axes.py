"""Are identified X and Y axes true? Machines from wide ranges are recorded on a square, and identified blind.

For each number: how often the 95 % interval holds the truth, and the median error::

    python -m kerfgym.experiments.studies.identified_axes --machines 60 --first 0
"""

import time

import numpy as np

from ...envs import scenarios
from ...envs.scenarios.machines import load
from ..identify import slides, square
from ..store import script

WIDE = {
    "name": "wide",
    "gantry": {
        "x_plus": {"uniform": [0.7, 1.4]},
        "x_minus": {"uniform": [0.7, 1.4]},
        "y_plus": {"uniform": [0.7, 1.4]},
        "y_minus": {"uniform": [0.7, 1.4]},
        "slower": {"log_uniform": [0.3, 3.0]},
    },
}
"""What the machines are drawn from; presets take turns."""


def main(machines: int = 60, first: int = 0) -> int:
    """Tell how often intervals of identified X and Y axes hold the truth.

    Args:
        machines: how many.
        first: seed of the first of them.
    """
    inside: dict[str, list[bool]] = {}
    off: dict[str, list[float]] = {}
    for seed in range(first, first + machines):
        started, preset = time.monotonic(), ("wu", "modern")[seed % 2]
        machine = load({**WIDE, "gantry": {**WIDE["gantry"], "preset": preset}})  # type: ignore[dict-item]
        found = slides.identify(square.record(machine, seed), scenarios.axes_of(machine.gantry), seed)
        missed = []
        for key, true in square.truth(machine, seed).items():
            if key == "acceleration" and not found.limited:
                continue
            low, middle, high = np.percentile(found.draws[key], [2.5, 50, 97.5])
            inside.setdefault(key, []).append(bool(low <= true <= high))
            off.setdefault(key, []).append(abs(float(middle) / true - 1))
            missed += [] if inside[key][-1] else [key]
        print(
            f"{seed}: {preset}, {found.left:.3f} µm left, {time.monotonic() - started:.0f} s, missed {missed}",
            flush=True,
        )
    for key, held in inside.items():
        print(f"{key:13s} {sum(held)} of {len(held)}, median error {1e6 * np.median(off[key]):.2f} ppm")
    return 0


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.studies.identified_axes")
