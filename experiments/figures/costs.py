"""Studies that take minutes: speed, the search of filters against a grid, coverage of intervals, the documents."""

import shutil
from typing import Any

from .. import coverage, filter_grid
from ..bars import progress, status
from ..reproduce import claims, page
from ..reproduce.run import reproduce
from ..speed.run import speed
from .stamp import LAWS, MACHINE, suite
from .study import Trial, study

ROUNDS, REPEATS, SEEDS = 5, 1000, 24


@study(
    "filter-grid", "the filter that a search finds, against the best of a full grid",
    "python -m kerfgym.experiments.filter_grid", 8.0,
    (*MACHINE, "baselines/xi2023.py", *suite("following"), "experiments/filter_grid.py", "experiments/stability.py",
     "experiments/tune/*.py"),
)  # fmt: skip
def of_filters(trial: Trial) -> dict[str, Any]:
    """An interrupted one begins anew: the search is a small part of it."""
    if trial.folder.exists():
        shutil.rmtree(trial.folder)
    found = filter_grid.compare(trial.folder, filter_grid.TRIALS, trial.workers)
    for name, ratio in found["search_over"].items():
        found["search_over"][name] = {end: 100.0 * (value - 1.0) for end, value in ratio.items()}
    return {"numbers": found}


@study(
    "coverage", "how often 95 % intervals hold the truth",
    f"python -m kerfgym.experiments.coverage --repeats {REPEATS}", 10.0,
    ("experiments/coverage.py", "experiments/inference.py", "experiments/resampling.py"),
)  # fmt: skip
def of_intervals(trial: Trial) -> dict[str, Any]:
    """One row for each cell of the table, in percent."""
    lines = coverage.table(coverage.KINDS, REPEATS, trial.workers).strip().split("\n")
    titles, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in (lines[0], *lines[2:]))
    found: dict[str, Any] = {}
    for kind, figure, count, *shares in rows:
        cells = {title: _percent(share) for title, share in zip(titles[3:], shares, strict=True)}
        found.setdefault(kind, {}).setdefault(figure, {})[count] = cells
    return {"numbers": found, "repeats": REPEATS}


def _percent(text: str) -> float | None:
    return float(text.removesuffix("%")) if text.endswith("%") else None


@study(
    "speed", "how fast all of this is, as ratios within one process; the cores should be idle", "kerfgym speed", 8.0,
    ("envs/*.py", "envs/plant/*.py", "baselines/*.py", "agents/*.py", "experiments/speed/*.py"),
)  # fmt: skip
def of_speed(trial: Trial) -> dict[str, Any]:
    """Ratios, promises, and the kernel's stages."""
    if trial.folder.exists():
        shutil.rmtree(trial.folder)
    trial.folder.mkdir(parents=True)
    with status() as told:
        tables = speed(trial.folder, ROUNDS, True, 1, told)
    ratios = tables["ratios"].set_index("ratio")
    return {
        "numbers": {
            "ratios": ratios.to_dict("index"),
            "stages": tables["stages"].set_index("stage")[["ns", "share"]].to_dict("index"),
            "startup": tables["startup"].set_index("program").to_dict("index"),
            "failed": int((ratios["held"] == 0).sum()),
        },
        "rounds": ROUNDS,
    }  # fmt: skip


@study(
    "reproduction", "every claim of the five documents, with its verdict", f"kerfgym reproduce --seeds {SEEDS}", 6.0,
    (*MACHINE, *LAWS, "experiments/reproduce/*.py", "experiments/reproduce/*.toml", "experiments/calibrate.py",
     "envs/panel.py"),
)  # fmt: skip
def of_documents(trial: Trial) -> dict[str, Any]:
    """Rows by document and verdict."""
    finished = (trial.folder / "run.json").is_file()
    with progress("studies") as told:
        parts = reproduce((), trial.folder, SEEDS, trial.workers, finished, not finished, told)
    failed = [part["study"] for part in parts if part["error"]]
    if failed:
        raise RuntimeError(f"{', '.join(failed)} failed; see {trial.folder / 'parts'}")
    found = {name: page.counts([p for p in parts if p["document"] == name]) for name in claims.DOCUMENTS}
    return {"numbers": {"documents": found, "all": page.counts(parts), "rows": sum(len(p["rows"]) for p in parts)}}
