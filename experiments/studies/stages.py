"""Study of blame: what each stage of the machine costs a few followers."""

from typing import Any

import pandas as pd

from ...envs import scenarios
from ..blame import blame
from ..measure.grids import Grid, split_seeds
from ..store.stamp import LAWS, LOADED
from .registry import Trial, study

SEEDS = 24

CONTROLLERS, SCENARIOS = ("xi2023-improved", "xi2023-tuned", "observer"), ("rough", "impulses")
"""A shape in which delays are felt, and a disturbed sensor."""

_CONTROLLERS, _SCENARIOS = ((w for n in names for w in (o, n)) for o, names in (("-c", CONTROLLERS), ("-s", SCENARIOS)))
_WORDS = ["kerfgym", "blame", *_CONTROLLERS, *_SCENARIOS, "--seeds", str(SEEDS)]


@study(
    "blame",
    "what each stage of the machine costs a follower",
    " ".join(_WORDS),
    1.0,
    (*LOADED, *LAWS, *(f"envs/suites/following/{name}.toml" for name in SCENARIOS)),
)
def of_stages(trial: Trial) -> dict[str, Any]:
    """Shares and headroom; what an interrupted run has done is kept."""
    seeds = split_seeds(SEEDS)
    grid = Grid("blame", CONTROLLERS, tuple(map(scenarios.load, SCENARIOS)), seeds)
    finished = (trial.folder / "run.json").is_file()
    shares, headroom = blame(
        grid, trial.folder, threads=trial.workers, overwrite=finished, resume=not finished, command=_WORDS
    )
    return {
        "seeds": f"{seeds[0]}-{seeds[-1]}",
        "numbers": {"shares": nested(shares, "stage"), "headroom": nested(headroom, "informed")},
    }


def nested(frame: pd.DataFrame, last: str) -> dict[str, Any]:
    """Rows by scenario, controller and a third column."""
    out: dict[str, Any] = {}
    for row in frame.to_dict("records"):
        at = out.setdefault(row.pop("scenario"), {}).setdefault(row.pop("controller"), {})
        at[row.pop(last)] = row
    return out
