"""Is the search any good? The filter that ``kerfgym tune filter`` finds, against the best of a full grid.

``python -m kerfgym.experiments.studies.filter_grid`` writes ``runs/filter-grid/``. Search and grid have the same base
(``xi2023-improved``), the same tune seeds, the same aim (geometric mean over the core of the RMS of the true error) and
the same limits (Ms, no collision). The grid holds every kind with every window and trim that the search may choose, all
else as it is by default; a finer one beyond it also takes a few values of what kinds read beside these. The results are
compared on test seeds, in pairs.

Then the filter's purpose: what 20 impulses a second do to the 99th percentile of the true error.
"""

import itertools
import math
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...envs import scenarios
from ...envs.control.stack import Stack
from ...envs.figures import metrics
from ...envs.plant.filters import KINDS, Params
from ..measure import rollout
from ..measure.stability import LIMIT_MS
from ..statistics.bootstrap import log_score, replicate
from ..statistics.intervals import Interval, Sample
from ..store import runs
from ..store.progress import progress
from ..tune import tune
from ..tune.evaluate import Evaluator
from ..tune.goals import Limits, score
from ..tune.space import NARROW, READS
from ..tune.study import Task

CONTROLLER, TRIALS = "xi2023-improved", 300

WINDOWS = range(int(NARROW["filter.window"][0]), int(NARROW["filter.window"][1]) + 1)

VALUES: dict[str, tuple[float, ...]] = {
    "ratio": (0.3, 0.5, 0.7, 0.8, 0.9),
    "tau": (0.25, 0.5, 1.0, 2.0, 4.0),
    "jump": (0.02, 0.03, 0.04, 0.06, 0.1),
    "hold": (1.0, 2.0, 4.0),
    "trust": (0.03, 0.1, 0.3, 1.0, 3.0),
}
"""What the finer grid has of the settings beside window and trim; the defaults are among them."""

IMPULSES = 20.0
"""1/s"""


def grid() -> Iterator[tuple[bool, dict[str, Any]]]:
    """Every point of the finer grid, as parameters of a stack, and whether the plain one is without it."""
    plain = Params()._asdict()
    for kind in KINDS:
        settings = [s for s in READS[kind] if s not in ("window", "trim")]
        for window in WINDOWS if "window" in READS[kind] else (0,):
            for trim in range((window + 1) // 2) if "trim" in READS[kind] else (0,):
                for values in itertools.product(*(VALUES[s] for s in settings)):
                    point: dict[str, Any] = {"window": float(window), "trim": float(trim)}
                    kept = {k: v for k, v in point.items() if k in READS[kind]}
                    point = kept | dict(zip(settings, values, strict=True))
                    finer = any(point[name] != plain[name] for name in settings)
                    yield finer, {"filter.kind": kind} | {f"filter.{k}": v for k, v in point.items()}


def search_grid(task: Task, threads: int, told: Any) -> pd.DataFrame:
    """Every candidate of the finer grid under the task's aim and limits, best first; those that break a limit last."""
    base, points = task.base, list(grid())
    evaluator = Evaluator(base, task.suite, range(task.seeds), threads)
    rows = []
    for i, (finer, point) in enumerate(points):
        candidate = base.varied(point)
        figures = evaluator.whole(candidate, task.wanted)
        broken = task.limits.check(figures, evaluator.core, task.jobs)
        ms = evaluator.exact_peak(candidate)
        value = score("rms_true", figures, evaluator.core)
        kept = ms <= task.limits.ms and max(broken.values()) <= 0 and np.isfinite(value)
        seen = {"rms_true": value, "ms": ms, "collisions": broken["collision"]}
        rows.append({**point, "finer": finer, **seen, "keeps": kept})
        told(i + 1, len(points), point["filter.kind"])
    return pd.DataFrame(rows).sort_values(["keeps", "rms_true"], ascending=[False, True], kind="stable")


def on_test_seeds(found: dict[str, Stack], threads: int) -> pd.DataFrame:
    """One row per controller, scenario of the core and test seed of it: ``rms_true``, µm; NaN if it failed."""
    cases, seeds = [scenarios.load(n) for n in scenarios.core("following")], scenarios.SPLITS["test"]
    frames = []
    for name, stack in found.items():
        for case in cases:
            for part in rollout.chunks(case.some(np.asarray(seeds))):
                record = rollout.roll(case, stack, part, threads)
                rms = np.where(metrics.failed(record), np.nan, metrics.METRICS["rms_true"].function(record))
                frames.append(pd.DataFrame({"controller": name, "scenario": case.name, "seed": part, "rms_true": rms}))
    return pd.concat(frames, ignore_index=True)


def ratio_of_scores(table: pd.DataFrame, one: str, other: str) -> Interval:
    """Score of ``one`` over that of ``other``, in pairs on the same seeds."""
    wide = table.pivot(index=["controller", "seed"], columns="scenario", values="rms_true")
    both = [Sample.of(wide.loc[name].to_numpy(), wide.loc[name].index) for name in (one, other)]
    return Interval(*map(math.exp, replicate(both, log_score).interval([1.0, -1.0])))


def with_impulses(stack: Stack, threads: int) -> pd.DataFrame:
    """One row per test seed of the scenario ``impulses``: the 99th percentile of the true error (µm) as it is, and on
    the same sheets without any impulse."""
    case = scenarios.load("impulses")
    assert case.head.impulses == IMPULSES
    seeds = np.asarray(scenarios.SPLITS["test"])
    columns = {
        name: metrics.METRICS["p99_true"].function(rollout.roll(which, stack, seeds, threads))
        for name, which in (("with", case), ("without", case.varied(head={"impulses": 0.0})))
    }
    return pd.DataFrame({"seed": seeds, **columns})


def compare(folder: Path, trials: int, threads: int) -> dict[str, Any]:
    """Searches, walks the grid, compares; writes the folder and gives what it found."""
    task = Task(CONTROLLER, ("filter",), limits=Limits(LIMIT_MS), trials=trials)
    wall, cpu = time.time(), time.process_time()
    with progress("trials") as told:
        searched = tune(task, folder / "tune", threads=threads, told=told).found.controller.z
    cost = {"wall_seconds": round(time.time() - wall, 1), "cpu_seconds": round(time.process_time() - cpu, 1)}
    with progress("grid") as told:
        points = search_grid(task, threads, told)
    known = {"search": searched, "grid": best(task, points[~points["finer"]]), "finer grid": best(task, points)}
    table, hit = on_test_seeds(known, threads), with_impulses(searched, threads)
    for name, frame in (("grid", points), ("test", table), ("impulses", hit)):
        runs.write_table(folder, name, frame)
    means = hit[["with", "without"]].mean()
    body: dict[str, Any] = {"found": {name: _settings(stack) for name, stack in known.items()}}
    body["points"] = {"grid": int((~points["finer"]).sum()), "finer grid": len(points)}
    body["search_over"] = {name: ratio_of_scores(table, "search", name)._asdict() for name in list(known)[1:]}
    body |= {"p99_with_impulses_um": means["with"], "p99_without_um": means["without"]}
    body |= {"p99_ratio": means["with"] / means["without"], "trials": trials, "threads": threads}
    body["cost_of_search"] = cost
    command = ["python", "-m", "kerfgym.experiments.studies.filter_grid"]
    runs.write_json(folder / "run.json", runs.record(command) | body)
    return body


def best(task: Task, points: pd.DataFrame) -> Stack:
    """The controller of the best point that keeps the limits."""
    base, first = task.base, points[points["keeps"]].iloc[0]
    return base.varied({k: v for k, v in first.items() if str(k).startswith("filter.") and v == v}).z


def _settings(stack: Stack) -> dict[str, Any]:
    """The filter's kind and what that kind reads."""
    p = stack.part("filter")
    kind = KINDS[int(p.kind)]
    return {"kind": kind} | {name: float(getattr(p, name)) for name in READS[kind]}


def main() -> None:
    """Prints the comparison."""
    folder = runs.open_folder(Path("runs") / "filter-grid", overwrite=True)
    found = compare(folder, TRIALS, threads=os.cpu_count() or 1)
    cost = found["cost_of_search"]
    print(f"search: {found['trials']} trials, {cost['wall_seconds']} s, {cost['cpu_seconds']} CPU-s")
    for name, settings in found["found"].items():
        print(f"{name}: {settings}")
    for name, ratio in found["search_over"].items():
        percent = [100.0 * (end - 1.0) for end in ratio.values()]
        print(
            f"RMS of search over that of {name} ({found['points'][name]} points), test seeds: {percent[0]:+.4f} % "
            f"[{percent[1]:+.4f}, {percent[2]:+.4f}]"
        )
    print(
        f"P99 of the true error with {IMPULSES:g} impulses/s: {found['p99_with_impulses_um']:.2f} µm, without: "
        f"{found['p99_without_um']:.2f} µm, × {found['p99_ratio']:.3f}\n\n{folder}"
    )


if __name__ == "__main__":
    main()
