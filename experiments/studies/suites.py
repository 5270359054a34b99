"""Studies of suites: everything that is shipped, compared as ``kerfgym benchmark --shipped`` does."""

import hashlib
import json
from dataclasses import asdict, replace
from typing import Any

from ...envs import scenarios
from ..benchmark import benchmarking
from ..measure.grids import Grid, plan
from ..report.terminal import WEIGHED, sheets
from ..results import archive
from ..results.conclusions import Results
from ..statistics import comparison
from ..store import runs
from ..store.stamp import LAWS, LOADED, PLANNED, POLICIES, ROOT, changed, suite, trained, with_imports
from .registry import Trial, study

RUN = ("experiments/results/tasks.py",)
"""What makes a run; what is concluded from runs is not among what it imports."""

MADE_FROM = "made-from.json"
"""File of a run folder: what the run depended on."""

MINUTES = {"following": 6.0, "ood": 5.0, "repeated": 2.0, "contour": 1.0, "cutting": 1.0}
"""CPU time of those whose cost is known."""

_ENVIRONMENTS = {"z": "height-", "xy": "contour-", "process": "cutting-"}


def benchmarked(trial: Trial, grid: Grid, words: list[str], **options: Any) -> Results:
    """Results of a benchmark. A run that is finished and was made from the same is read back; one that was interrupted
    goes on."""
    folder, of = trial.folder, _of_runs(trial) | {"asked": asked(grid, options)}
    mark, finished = folder / MADE_FROM, (folder / "run.json").is_file()
    if finished and mark.is_file() and not changed(json.loads(mark.read_text(encoding="utf-8")), of):
        print(f"  {folder} was made from the same sources; it is read back", flush=True)
        return next(iter(archive.load(folder).grids.values()))
    found = benchmarking.run_grids(
        [grid], folder, workers=trial.workers, overwrite=finished, resume=not finished, command=words, **options
    )
    runs.write_json(mark, of)
    return next(iter(found.values()))


def asked(grid: Grid, options: dict[str, Any]) -> str:
    """A hash of what is run, in words of scenarios, controllers and seeds."""
    texts = [case.to_toml() for case in grid.scenarios]
    whole = json.dumps([grid.suite, grid.controllers, texts, list(grid.seeds), grid.core, sorted(options.items())])
    return hashlib.sha256(whole.encode()).hexdigest()[:16]


def _of_runs(trial: Trial) -> dict[str, str]:
    """What the runs themselves depend on, not what is concluded from them."""
    return with_imports([ROOT / each for each in RUN], trial.study.depends)


def concluded(results: Results) -> dict[str, Any]:
    """What is stored of a benchmark: its tables in words as the command prints them, and every figure as a number.

    ``numbers`` has for each controller the columns of its summary, ``rms`` and ``collided`` by scenario, and of jobs
    ``over``, figures over the reference's.
    """
    summary, pooled = results.summary(), results.pooled(results.metric)
    hit = results.runs.groupby(["controller", "scenario"], sort=False)["collision"].sum().unstack()
    numbers: dict[str, dict[str, Any]] = {str(name): dict(row) for name, row in summary.iterrows()}
    for name, row in numbers.items():
        row["rms"], row["collided"] = dict(pooled.loc[name]), dict(hit.loc[name])
    if results.jobs and results.reference in results.controllers and len(numbers) > 1:
        whole = comparison.relative(results, WEIGHED)
        apart = {metric: comparison.by_scenario(replace(results, metric=metric)) for metric in WEIGHED}
        for name, row in whole.iterrows():
            there = {key: table[table["controller"] == name].set_index("scenario") for key, table in apart.items()}
            numbers[str(name)]["over"] = dict(row) | {
                "in": {s: {m: 1.0 / t.at[s, "ratio"] for m, t in there.items()} for s in results.scenarios}
            }
    shown = {"numbers": numbers, "sheets": [asdict(sheet) for sheet in sheets(results)]}
    own = {name: getattr(results, name) for name in ("scenarios", "scored", "reference", "metric")}
    return {"seeds": results.meta["seeds"], "wall_seconds": results.meta.get("wall_seconds", 0.0), **own, **shown}


def compared(name: str) -> Any:
    """The study of a suite."""
    words = ["kerfgym", "benchmark", "--suite", name, "--shipped", "--no-cost", "--no-blame", "--no-detuned"]

    def make(trial: Trial) -> dict[str, Any]:
        (grid,) = plan([name], everything=True)
        return concluded(benchmarked(trial, grid, words, with_ms=name.startswith("following")))

    return make


def _depends(name: str) -> tuple[str, ...]:
    slot = scenarios.rules(name)["slot"]
    drawn = any(each.job or each.path for each in scenarios.suite(name).values())
    cuts = PLANNED if drawn else ()
    return *LOADED, *cuts, *LAWS, *POLICIES, *suite(name), *trained(_ENVIRONMENTS[slot])


for _name in scenarios.suites():
    if _name != "drawing":  # it is for a drawing of the user's
        study(
            _name,
            f"everything shipped on the suite {_name}",
            f"kerfgym benchmark --suite {_name} --shipped",
            MINUTES.get(_name, 6.0),
            _depends(_name),
        )(compared(_name))
