"""Study of blame: what each stage of the machine costs a few followers."""

import shutil
from typing import Any

import pandas as pd

from ...envs import scenarios
from ..blame import blame
from ..grids import Grid, split_seeds
from .stamp import LAWS, MACHINE
from .study import Trial, study

SEEDS = 24

PAIRS = {"rough": ("xi2023-improved", "xi2023-tuned", "observer"), "impulses": ("xi2023-tuned",)}
"""Controllers by scenario: a shape that delays are felt in, and a disturbed sensor."""


@study(
    "blame", "what each stage of the machine costs a follower",
    "kerfgym blame -c xi2023-improved -c xi2023-tuned -c observer -s rough", 2.0,
    (*MACHINE, *LAWS, "experiments/blame/game.py", "experiments/blame/tables.py", "experiments/resampling.py",
     *(f"envs/suites/following/{name}.toml" for name in PAIRS)),
)  # fmt: skip
def of_stages(trial: Trial) -> dict[str, Any]:
    """One run for each scenario; what an interrupted one has done is kept."""
    shares, headroom = [], []
    for name, controllers in PAIRS.items():
        grid = Grid("blame", controllers, (scenarios.load(name),), split_seeds(SEEDS))
        folder = trial.folder / name
        if (folder / "run.json").is_file():
            shutil.rmtree(folder)
        tables = blame(grid, folder, threads=trial.workers, resume=True, command=trial.study.command.split())
        shares.append(tables[0])
        headroom.append(tables[1])
    return {
        "seeds": f"{split_seeds(SEEDS)[0]}-{split_seeds(SEEDS)[-1]}",
        "numbers": {"shares": nested(pd.concat(shares), "stage"), "headroom": nested(pd.concat(headroom), "bound")},
    }  # fmt: skip


def nested(frame: pd.DataFrame, last: str) -> dict[str, Any]:
    """Rows by scenario, controller and a third column."""
    out: dict[str, Any] = {}
    for row in frame.to_dict("records"):
        at = out.setdefault(row.pop("scenario"), {}).setdefault(row.pop("controller"), {})
        at[row.pop(last)] = row
    return out
