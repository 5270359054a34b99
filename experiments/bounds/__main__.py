"""Makes the recorded bounds: ``python -m kerfgym.experiments.bounds [--check]``."""

import argparse
import sys
import time

import numpy as np

from ...envs import metrics, scenarios
from ...envs import stack as stacks
from ...envs.scenarios import SPLITS
from .. import rollout
from ..grids import shipped
from . import record, suite


def closest(suite_name: str, seeds: range) -> dict[str, tuple[str, float]]:
    """Who of all shipped followers with only the sensor is closest in each core scenario, and its RMS, µm."""
    found: dict[str, tuple[str, float]] = {}
    for stack in map(stacks.resolve, shipped(suite_name)):
        if stack.information != "sensor":
            continue
        for name in scenarios.core(suite_name):
            squares = []
            for some in rollout.chunks(seeds):
                run = rollout.roll(scenarios.load(name), stack, some)
                squares.append(np.where(metrics.failed(run), np.inf, metrics.METRICS["rms_true"].function(run) ** 2))
            rms = float(np.sqrt(np.mean(np.concatenate(squares))))
            found[name] = min(found.get(name, ("", np.inf)), (stack.name, rms), key=lambda each: each[1])
    return found


def main() -> int:
    """Writes the record and prints it."""
    parser = argparse.ArgumentParser(
        prog="python -m kerfgym.experiments.bounds", description=(__doc__ or "").split(":")[0]
    )
    parser.add_argument("--check", action="store_true", help="roll out all shipped followers: none may be below")
    checks = parser.parse_args().check
    seeds, started = SPLITS["test"], time.process_time()
    found = {name: suite.of(scenario, seeds) for name, scenario in record.wanted().items()}
    record.write(found, seeds)
    cost = time.process_time() - started
    best = closest("following", seeds) if checks else {}
    wrong = []
    print(f"{'scenario':20} {'bound':>8} {'learned':>8} {'linear':>8}   µm RMS, {len(seeds)} seeds")
    for name, bound in found.items():
        linear = "–" if bound.linear is None else f"{bound.linear:.3f}"
        who = f"   {best[name][1]:8.3f} {best[name][0]}" if name in best else ""
        print(f"{name:20} {bound.bound:8.3f} {bound.learned:8.3f} {linear:>8}{who}")
        if name in best and best[name][1] < bound.bound:
            wrong.append(name)
    print(f"{cost:.0f} CPU-seconds; {record.FILE.name} written")
    if wrong:
        print(f"below its bound, so the bound is wrong: {', '.join(wrong)}", file=sys.stderr)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
