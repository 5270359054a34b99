"""Makes the recorded bounds: ``python -m kerfgym.experiments.bounds [--check]``."""

import sys
import time
from collections.abc import Iterable

import numpy as np

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.quantity import InvalidInput
from ...envs.figures import metrics
from ...envs.scenarios import SPLITS
from ..measure import rollout
from ..measure.grids import shipped
from ..store import script
from . import scenario as suite
from . import stored

CHUNK = 20
"""Machines that are rolled out at a time; episodes may be long."""


def closest(names: Iterable[str], seeds: range) -> dict[str, tuple[str, float]]:
    """Who of all shipped followers with only the sensor is closest in each scenario, and its RMS, µm; by
    ``suite/scenario``."""
    found: dict[str, tuple[str, float]] = {}
    for name in names:
        scenario = scenarios.load(name)
        for stack in map(stacks.resolve, shipped(name.split("/")[0])):
            if stack.information != "sensor":
                continue
            squares = []
            for some in rollout.chunks(scenario.some(seeds), CHUNK):
                run = rollout.roll(scenario, stack, some)
                squares.append(np.where(metrics.failed(run), np.inf, metrics.METRICS["rms_true"].function(run) ** 2))
            rms = float(np.sqrt(np.mean(np.concatenate(squares))))
            found[name] = min(found.get(name, ("", np.inf)), (stack.name, rms), key=lambda each: each[1])
    return found


def main(check: bool = False, seeds: int = 0) -> bool:
    """Make the recorded bounds, and print them.

    Args:
        check: roll out all shipped followers in every scenario: none may be below.
        seeds: with --check: of so many seeds, nothing is recorded.
    """
    if seeds and not check:
        raise InvalidInput("--seeds goes with --check; the record is of all test seeds")
    some, started = SPLITS["test"][: seeds or None], time.process_time()
    found = {name: suite.of(scenario, some) for name, scenario in stored.wanted().items()}
    if some == SPLITS["test"]:
        stored.write(found, some)
    cost = time.process_time() - started
    best = closest(found, some) if check else {}
    wrong = []
    print(f"{'scenario':28} {'bound':>8} {'learned':>8} {'linear':>8}   µm RMS, {len(some)} seeds")
    for name, bound in found.items():
        linear = "–" if bound.linear is None else f"{bound.linear:.3f}"
        who = f"   {best[name][1]:8.3f} {best[name][0]}" if name in best else ""
        print(f"{name:28} {bound.bound:8.3f} {bound.learned:8.3f} {linear:>8}{who}")
        if name in best and best[name][1] < bound.bound:
            wrong.append(name)
    print(f"{cost:.0f} CPU-seconds" + f"; {stored.FILE.name} written" * (some == SPLITS["test"]))
    if wrong:
        print(f"below its bound, so the bound is wrong: {', '.join(wrong)}", file=sys.stderr)
    return bool(wrong)


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.bounds")
