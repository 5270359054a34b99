"""Whether policies beat their base: both, and the best classical controller, on test seeds that no training saw."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from ...agents.evaluation import Evaluator
from ...agents.settings import TASKS, Settings
from ...envs import scenarios
from ...envs.figures import job_metrics, metrics
from ...envs.scenarios import Machine, machines
from ..benchmark import benchmarking
from ..measure import grids
from ..results.conclusions import Results
from ..statistics import comparison
from ..store.plain import plain

SEEDS = 24
"""Test seeds of each scenario unless told otherwise: enough to tell a tenth, and a small part of a training."""


CLASSICAL = {
    "kerfgym/HeightFollowing-v0": "forecast",
    "kerfgym/ContourFollowing-v0": "wu-inverse",
    "kerfgym/Cutting-v0": "huang2024-static-quality",
}
"""By environment, the controller without learning with the best score in the recorded study of its suite, of those that
know no more than the sensor."""


def suite_of(env: str) -> str:
    """The suite that tells how well an environment's task is done."""
    return next(suite for suite in grids.SHOWN if scenarios.rules(suite)["environment"] == env)


def cut_by(settings: Settings) -> Machine | None:
    """The machine that a training was told to be on; None: as the scenarios say, with or without changes."""
    given = settings.environment.get("machine")
    return machines.load(given) if given and not (isinstance(given, dict) and "name" not in given) else None


def compared(settings: Settings, policies: Sequence[str], seeds: int, workers: int = 1) -> Results:
    """The policies, their base, which is the reference, and the best classical controller, on the first test seeds of
    the scenarios by which the training is evaluated, whole.

    Args:
        settings: of the training.
        policies: folders of artefacts.
        seeds: of each scenario.
        workers: processes.

    Raises:
        InvalidInput: more seeds than the split has.
    """
    batch = Evaluator(replace(settings, evaluation={**settings.evaluation, "episodes": 1})).env.batch
    suite, base, best = suite_of(settings.env), base_of(settings), CLASSICAL.get(settings.env)
    others = [name for name in (base, best) if name]
    cases = list({s.name: s for s in batch.scenarios}.values())
    names = tuple(dict.fromkeys([*policies, *others]))
    seen = grids.split_seeds(seeds, "test")
    grid = grids.Grid(suite, names, tuple(cases), seen, machine=cut_by(settings))
    found = benchmarking.unwritten(grid, workers)
    return replace(found, reference=base or best or names[0])


def base_of(settings: Settings) -> str | None:
    """Words that name the base on which a training's policy stands; None if it decides alone."""
    given = settings.environment
    task = TASKS[settings.env]
    if given.get("control") == "direct" and not task.with_job:
        return None
    return str(given.get("base") or task.base)


def unit(results: Results) -> str:
    """What the score is, in words."""
    metric = (job_metrics.METRICS if results.jobs else metrics.METRICS)[results.metric]
    return f"{metric.label}, {metric.unit}"


def rows(results: Results) -> pd.DataFrame:
    """One row a controller, by its name: ``score`` with its interval over test seeds, ``ratio``, that of the base over
    it on the same seeds, with interval, and ``failed`` of ``runs``."""
    found = comparison.figures(results, typical=False)
    wanted = [f"{figure}{end}" for figure in ("score", "ratio") for end in ("", "_low", "_high")]
    return found[wanted].assign(failed=found["lost"].astype(int), runs=found["tried"].astype(int))


def verdict(low: float, high: float, base: str) -> str:
    """What the interval of base ÷ policy says."""
    if math.isnan(low) or math.isnan(high):
        return f"not comparable with {base}: they have no runs that neither failed"
    if low > 1.0:
        return f"better than {base}"
    return f"worse than {base}" if high < 1.0 else f"not distinguishable from {base}"


def told(results: Results, policies: Sequence[str], names: Sequence[str]) -> list[str]:
    """Lines for the terminal: a table, and for a single policy whether it beats its base."""
    table, named = rows(results), dict(zip(policies, names, strict=True))
    width, base = max(len(named.get(name, name)) for name in table.index), results.reference
    on = f" on machine {results.meta['cut_by']['name']}" if results.meta.get("cut_by") else ""
    count = results.runs["seed"].nunique()
    lines = [f"{unit(results)}, on {count} test seeds a scenario{on}, 95 % intervals over seeds:"]
    for name, row in table.iterrows():
        score = f"{row['score']:.3f} ({row['score_low']:.3f} … {row['score_high']:.3f})"
        ratio = f"{base} ÷ it {row['ratio']:.3f} ({row['ratio_low']:.3f} … {row['ratio_high']:.3f})"
        failed = f", {row['failed']} of {row['runs']} runs failed" if row["failed"] else ""
        lines.append(f"  {named.get(str(name), name):{width}}  {score}{'' if name == base else f'   {ratio}'}{failed}")
    if len(policies) == 1 and policies[0] != base:
        at = table.loc[policies[0]]
        lines.append(f"the policy is {verdict(at['ratio_low'], at['ratio_high'], base)}")
    return lines


def record(results: Results, policies: Sequence[str], names: Sequence[str]) -> dict[str, Any]:
    """As ``run.json`` keeps it: ``seeds`` of test, ``scenarios``, the ``base``, the ``metric``, simulated steps, and
    the rows by controller."""
    table, named = rows(results), dict(zip(policies, names, strict=True))
    by_name = {named.get(str(name), str(name)): row for name, row in table.to_dict("index").items()}
    steps = sum(entry["simulated_steps"] for entry in results.meta["ledger"].values())
    about = {"seeds": results.meta["seeds"], "scenarios": results.meta["scenarios"], "simulated_steps": steps}
    return {**about, "metric": results.metric, "base": results.reference, "controllers": plain(by_name)}


def method(results: Results, policies: Sequence[str]) -> dict[str, Any]:
    """Several trainings as runs of one method: ``median``, ``best`` and ``worst`` of their scores, and ``score`` and
    ``ratio`` (the base's over it) with intervals over trainings and seeds."""
    scores = rows(results).loc[list(policies), "score"].to_numpy()
    out = {"trainings": len(policies), "median": float(np.median(scores))}
    out |= {"best": float(scores.min()), "worst": float(scores.max())}
    found = comparison.methods(results)
    mine = [row for row in found.to_dict("records") if set(row["members"]) == set(policies)]
    for row in mine:
        out |= {f"{name}{end}": row[f"{name}{end}"] for name in ("score", "ratio") for end in ("", "_low", "_high")}
    return out
