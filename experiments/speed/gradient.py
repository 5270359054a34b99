"""What gradients cost: a roll-out of drive and loop there and back, over the way there alone.

``python -m kerfgym.experiments.speed.gradient`` prints CPU-ns per control period of one machine, medians of interleaved
rounds, and ratios within a round. The way there is that of :mod:`kerfgym.envs.plant.rollout` that keeps nothing.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from ...envs.plant import weighed
from ...envs.plant.rollout import Loop, Surface
from ...envs.plant.z_axis import Params

LARGEST_RATIO = 4.0
"""What is promised of there and back over there."""


def _cost(call: Callable[[], object], count: int) -> float:
    """CPU-ns per period of a machine."""
    began = time.process_time()
    call()
    return (time.process_time() - began) / count * 1e9


def measured(machines: int, periods: int, rounds: int, bristle: float) -> dict[str, np.ndarray]:
    """CPU-ns of each round: the way ``there``, ``there, kept``, ``back``, and ``back, axis too``."""
    rng, shape = np.random.default_rng(0), (periods, machines)
    wave = 0.3 * np.sin(0.03 * np.arange(periods)[:, None] + rng.uniform(0, 2 * np.pi, machines))
    numbers = (np.zeros(shape), wave, np.full(shape, 60.0), np.full(shape, 0.5), np.full(shape, 5.0))
    recorded, surface = weighed.Recorded._make(numbers), Surface._make((wave, 0.0, 0.0))
    loop, axis, params = Loop(), Params(dead_time=2.3, bristle=bristle), weighed.Params()
    there = loop.forward(axis, params, recorded, surface, keep=False)
    run = loop.forward(axis, params, recorded, surface)
    weight = run.gap - 1.0
    calls: dict[str, Callable[[], object]] = {
        "there": lambda: loop.forward(axis, params, recorded, surface, keep=False, into=there),
        "there, kept": lambda: loop.forward(axis, params, recorded, surface, into=run),
        "back": lambda: loop.backward(run, gap=weight),
        "back, axis too": lambda: loop.backward(run, gap=weight, axis=True),
    }
    for call in calls.values():
        call()  # compiled, and its memory is there
    costs = [[_cost(call, machines * periods) for call in calls.values()] for _ in range(rounds)]
    return dict(zip(calls, np.array(costs).T, strict=True))


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=512)
    parser.add_argument("--periods", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=15)
    given = parser.parse_args()
    print(f"{given.machines} machines, {given.periods} periods, {given.rounds} rounds; CPU-ns per machine and period")
    for name, bristle in (("viscous friction", 0.0), ("bristles", 0.005)):
        costs = measured(given.machines, given.periods, given.rounds, bristle)
        ratio = (costs["there, kept"] + costs["back"]) / costs["there"]
        print(name + ": " + ", ".join(f"{key} {np.median(ns):.0f}" for key, ns in costs.items()))
        found = f"{np.median(ratio):.2f} ({ratio.min():.2f}–{ratio.max():.2f})"
        print(f"  there and back ÷ there: {found}; at most {LARGEST_RATIO:g}")


if __name__ == "__main__":
    main()
