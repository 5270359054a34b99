"""Makes the recorded bounds: ``python -m kerfgym.experiments.bounds [--check]``."""

import argparse
import sys
import time
from collections.abc import Iterable

import numpy as np

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.figures import metrics
from ...envs.scenarios import SPLITS
from ..measure import rollout
from ..measure.grids import shipped
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


def main() -> int:
    """Writes the record and prints it."""
    parser = argparse.ArgumentParser(
        prog="python -m kerfgym.experiments.bounds", description=(__doc__ or "").split(":")[0]
    )
    parser.add_argument(
        "--check", action="store_true", help="roll out all shipped followers in every scenario: none may be below"
    )
    parser.add_argument(
        "--seeds", type=int, default=0, metavar="N", help="with --check: of N seeds, nothing is recorded"
    )
    given = parser.parse_args()
    if given.seeds and not given.check:
        parser.error("--seeds goes with --check; the record is of all test seeds")
    seeds, started = SPLITS["test"][: given.seeds or None], time.process_time()
    found = {name: suite.of(scenario, seeds) for name, scenario in stored.wanted().items()}
    if seeds == SPLITS["test"]:
        stored.write(found, seeds)
    cost = time.process_time() - started
    best = closest(found, seeds) if given.check else {}
    wrong = []
    print(f"{'scenario':28} {'bound':>8} {'learned':>8} {'linear':>8}   µm RMS, {len(seeds)} seeds")
    for name, bound in found.items():
        linear = "–" if bound.linear is None else f"{bound.linear:.3f}"
        who = f"   {best[name][1]:8.3f} {best[name][0]}" if name in best else ""
        print(f"{name:28} {bound.bound:8.3f} {bound.learned:8.3f} {linear:>8}{who}")
        if name in best and best[name][1] < bound.bound:
            wrong.append(name)
    print(f"{cost:.0f} CPU-seconds" + f"; {stored.FILE.name} written" * (seeds == SPLITS["test"]))
    if wrong:
        print(f"below its bound, so the bound is wrong: {', '.join(wrong)}", file=sys.stderr)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
