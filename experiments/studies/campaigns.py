"""Studies of minutes and of faults, whose tables have pages of their own."""

from typing import Any

from ..measure import grids
from ..store import runs
from ..store.stamp import LAWS, LOADED, POLICIES, suite, trained
from .endurance import endured as of_endurance
from .endurance import sheets
from .faults import found as of_faults
from .registry import Trial, study

SEEDS, SECONDS = 24, 300.0

FAULTS = 12000

_ALL = (*LOADED, *LAWS, *POLICIES, *trained("height-"), *suite("following"))


@study(
    "endurance",
    "whether followers get worse in minutes",
    f"python -m {of_endurance.MODULE} --seeds {SEEDS} --duration {SECONDS:g} --docs",
    14.0,
    _ALL,
)
def of_minutes(trial: Trial) -> dict[str, Any]:
    """What is promised, and whether it held."""
    words = ["--seeds", str(SEEDS), "--duration", f"{SECONDS:g}"]
    seeds, found = grids.split_seeds(SEEDS), sheets.sheets(duration=SECONDS)
    folder = runs.open_folder(trial.folder, overwrite=True)
    controllers = grids.shipped("following")
    frame = of_endurance.made(controllers, found, seeds, folder, words, trial.workers, of_endurance.PAGE)
    return {"seeds": f"{seeds[0]}-{seeds[-1]}", "numbers": {"promises": of_endurance.promises(frame)}}


@study(
    "faults",
    "who is to blame for what followers do when one thing goes wrong for a moment",
    f"python -m {of_faults.MODULE} --faults {FAULTS} --seed 0 --docs",
    2.0,
    _ALL,
)
def of_moments(trial: Trial) -> dict[str, Any]:
    """Lost runs by cause."""
    words = ["--faults", str(FAULTS), "--seed", "0"]
    folder = runs.open_folder(trial.folder, overwrite=True)
    controllers = grids.shipped("following")
    frame = of_faults.made(controllers, FAULTS, 0, folder, words, trial.workers, of_faults.PAGE)
    causes = frame["cause"].value_counts().drop("", errors="ignore").to_dict()
    return {"numbers": {"faults": len(frame), "lost": int(frame["lost"].sum()), "lost_by": causes}}
