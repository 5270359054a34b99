"""Study of speed."""

import shutil
from typing import Any

from ..speed.timing import speed
from ..store.progress import status
from ..store.stamp import LAWS, trained
from .registry import Trial, study

ROUNDS = 5


@study(
    "speed",
    "how fast all of this is, as ratios within one process; the cores should be idle",
    "kerfgym speed",
    8.0,
    (*LAWS, *trained()),
)
def of_speed(trial: Trial) -> dict[str, Any]:
    """Ratios, promises, and the kernel's stages."""
    if trial.folder.exists():
        shutil.rmtree(trial.folder)
    trial.folder.mkdir(parents=True)
    with status() as told:
        tables = speed(trial.folder, ROUNDS, True, 1, told)
    ratios = tables["ratios"].set_index("ratio")
    stages = tables["stages"].set_index("stage")[["ns", "share"]]
    numbers = {"ratios": ratios.to_dict("index"), "stages": stages.to_dict("index")}
    numbers["startup"] = tables["startup"].set_index("program").to_dict("index")
    return {"numbers": numbers | {"failed": int((ratios["held"] == 0).sum())}, "rounds": ROUNDS}
