"""How often intervals of impulses and drift hold the truth, on machines that are drawn from their priors::

python -m kerfgym.experiments.studies.identified_disturbances --machines 60 --first 0
"""

from collections import defaultdict

import numpy as np

from ..identify import disturbances, head, protocols
from ..store import script

TRUTHS = {
    "impulses": (0.2, 50.0),
    "impulse_samples": (1.0, 7.0),
    "impulse_height": (0.05, 0.3),
    "impulse_falloff": (0.3, 3.0),
    "impulse_spread": (0.0, 1.0),
    "drift": (-0.01, 0.01),
    "warming": (30.0, 3000.0),
    "noise": (5e-4, 5e-3),
}
"""Ranges of the machines, in the units of their files; in the logarithm, but for lengths, spread and drift."""

EVEN = ("impulse_samples", "impulse_spread", "drift")


def drawn(rng: np.random.Generator) -> dict[str, float]:
    """A head's disturbances and noise."""
    out = {}
    for key, (low, high) in TRUTHS.items():
        out[key] = float(rng.uniform(low, high) if key in EVEN else np.exp(rng.uniform(np.log(low), np.log(high))))
    return {**out, "impulse_samples": float(np.floor(out["impulse_samples"]))}


def covered(machines: int, first: int = 0) -> dict[str, list[bool]]:
    """By key, whether the 95 % interval of each machine holds the truth; numbers without an interval are left out."""
    hits: dict[str, list[bool]] = defaultdict(list)
    for seed in range(first, first + machines):
        rng = np.random.default_rng([seed, 17])
        truth = drawn(rng)
        machine = {"name": "drawn", "head": truth}
        swept = head.swept(protocols.record(machine, "sweep", seed))
        found = disturbances.identify(protocols.record(machine, "rest", seed), swept, rng)
        for key, draws in found.draws.items():
            low, high = np.percentile(draws, [2.5, 97.5])
            hits[key].append(bool(low <= truth[key] <= high))
    return dict(hits)


def main(machines: int = 60, first: int = 0) -> int:
    """Tell how often intervals of impulses and drift hold the truth.

    Args:
        machines: how many.
        first: seed of the first of them.
    """
    for name, held in covered(machines, first).items():
        print(f"{name:18s}{sum(held):5d} of {len(held)}")
    return 0


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.studies.identified_disturbances")
