"""Are identified machines true? Machines from wide ranges are recorded, and identified without being known.

For each number: how often the 95 % interval holds the truth, and the median error::

    python -m kerfgym.experiments.studies.identified --machines 24 --first 0
"""

import argparse
import time
from typing import Any

import numpy as np

from ...envs.control.stack import get
from ...envs.scenarios import Scenario, machines
from ..identify import drive, head
from ..identify.protocols import record
from ..measure import rollout

WIDE = {
    "name": "wide",
    "head": {
        "noise": {"log_uniform": [5e-4, 5e-3]},
        "face": {"uniform": [8.0, 12.0]},
        "body": {"uniform": [8.0, 14.0]},
        "inductance": {"uniform": [140.0, 200.0]},
    },
    "axis": {
        "bandwidth": {"uniform": [25, 150]},
        "zeta": {"uniform": [0.5, 1.1]},
        "dead_time": {"uniform": [0.0005, 0.012]},
        "acceleration": {"uniform": [6000, 20000]},
        "jerk": {"log_uniform": [1e6, 5e6]},
        "speed": {"uniform": [250, 500]},
        "friction": {"uniform": [400, 1500]},
        "backlash": {"uniform": [0.002, 0.03]},
        "compliance": {"uniform": [0.05, 0.2]},
    },
}
"""What the machines are drawn from."""


def truth(machine: Any, seed: int) -> dict[str, float]:
    """What a drawn machine is, by the keys of what is identified."""
    flat = Scenario(name="truth", duration=1.0, settle=0.0, feed=0.0, set_height=1.0)
    fleet = rollout.fleet_for(machines.put_on(flat, machine), get("idle"), [seed])
    z, s = fleet.get("z"), fleet.get("sensor")
    known = {name: float(getattr(z, name)) for name in drive.NAMES if name != "bandwidth"}
    known |= {"bandwidth": z.omega / (2 * np.pi), "dead_time": z.dead_time * 1e-3}
    return known | {"noise": s.noise, "face": 2 * s.radius, "body": s.body, "inductance": s.inductance}


def identified(machine: Any, seed: int) -> tuple[dict[str, np.ndarray], float]:
    """Draws of its numbers from three logs, and µm that are left of the encoder."""
    swept = head.swept(record(machine, "sweep", seed))
    rng = np.random.default_rng(seed)
    noise = head.noise(record(machine, "rest", seed), swept, rng)
    spread = rng.multivariate_normal(np.log(list(swept.values.values())), swept.covariance, 1000)
    motion = record(machine, "motion", seed)
    found = drive.identify(motion["command"], motion["encoder"])
    geometry = dict(zip(swept.values, np.exp(spread).T, strict=True))
    return {**found.draws, "noise": noise["noise"], **geometry}, found.left


def main() -> None:
    """Prints a line for each machine, and then the table so far."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    machine = machines.load(WIDE)
    held: dict[str, list[bool]] = {}
    off: dict[str, list[float]] = {}
    for seed in range(asked.first, asked.first + asked.machines):
        began, known = time.perf_counter(), truth(machine, seed)
        draws, left = identified(machine, seed)
        for key, values in draws.items():
            low, middle, high = np.percentile(values, [2.5, 50, 97.5])
            held.setdefault(key, []).append(bool(low <= known[key] <= high))
            off.setdefault(key, []).append(abs(middle - known[key]) / (1.0 if key == "dead_time" else known[key]))
        missed = [key for key, values in held.items() if not values[-1]]
        lasted = time.perf_counter() - began
        print(f"machine {seed}: {left:.2f} µm left, {lasted:.0f} s; missed {', '.join(missed) or 'none'}", flush=True)
        for key, values in held.items():
            error = f"{1e3 * np.median(off[key]):.4f} ms" if key == "dead_time" else f"{np.median(off[key]):.3%}"
            worst = f"{1e3 * max(off[key]):.4f} ms" if key == "dead_time" else f"{max(off[key]):.3%}"
            print(f"  {key:14s}held {sum(values)} of {len(values)}, median error {error}, largest {worst}", flush=True)


if __name__ == "__main__":
    main()
