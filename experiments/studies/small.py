"""Studies that take seconds: the cut's calibration, what it shows of a following error, and the shipped policies."""

from typing import Any

import pandas as pd

from ...envs.control import stack as stacks
from ...envs.safety import files
from ...envs.scenarios.material import material
from ..report import cut_quality
from ..reproduce import fit_cut
from ..store.stamp import LOADED, trained
from .registry import Trial, study
from .ship import TRAINED, suite_of

SHEETS = (("c45-10", None), ("thin-sheet", None))
"""Materials, and their thickness where there are several."""


@study(
    "calibration",
    "Huang2024's Table 2 beside the cut's model that was fitted to it",
    "python -m kerfgym.experiments.reproduce.fit_cut",
    0.1,
    LOADED,
)
def calibration(trial: Trial) -> dict[str, Any]:
    """The table with the shipped coefficients; nothing is fitted here."""
    steel = material("c45-10")
    rows = fit_cut.table(steel.params, steel.power).set_index("method")
    return {"numbers": {"rows": rows.T.to_dict(), "coefficients": len(fit_cut.COEFFICIENTS) + 1}}


@study(
    "quality",
    "from which following error on dross or roughness change by 1 %",
    "python -m kerfgym.experiments.manual quality",
    0.2,
    (*LOADED, "experiments/report/cut_quality.py"),
)
def of_quality(trial: Trial) -> dict[str, Any]:
    """The thresholds that reports draw."""
    found = {}
    for name, thickness in SHEETS:
        steel = material(name, thickness)
        found[name] = {"thickness": steel.thickness, "threshold": cut_quality.threshold(cut_quality.table(steel))}
    return {"numbers": found}


@study(
    "policies",
    "what the shipped policies' trainings cost, and what other seeds come to",
    "python -m kerfgym.experiments.manual policies",
    0.1,
    (*trained(), "agents/trained/*/run.json", "agents/trained/*/*.csv"),
)
def policies(trial: Trial) -> dict[str, Any]:
    """Read from the records beside the policies; nothing is trained here."""
    return {"numbers": {name: _policy(name) for name in stacks.shelved() if (TRAINED / name).is_dir()}}


def _policy(name: str) -> dict[str, Any]:
    folder = TRAINED / name
    record = files.json_(folder / "run.json")
    document = files.json_(folder / "policy.json")
    ledger, settings = record["ledger"], record["settings"]
    found = {"environment": record["env"], "suite": suite_of(name), "algorithm": record["algorithm"]}
    found |= {"seed": record["seed"]}
    found |= {"steps": ledger["training_steps"], "simulated_steps": ledger["simulated_steps"]}
    found |= {"cpu_seconds": ledger["cpu_seconds"], "layers": settings["policy.net_arch"]}
    found |= {"base": settings.get("environment.base"), "control": settings.get("environment.control")}
    found["commit"] = (document.get("provenance") or {}).get("git", {}).get("commit")
    if (folder / "seeds.csv").is_file():
        frame = pd.read_csv(folder / "seeds.csv")
        columns = [c for c in frame if c in ("score", "ratio") or c.endswith("_over")]
        found["seeds"] = {
            column: {"median": frame[column].median(), "best": frame[column].min(), "worst": frame[column].max()}
            for column in columns
        } | {"count": len(frame), "each": frame["score"].tolist()}
    return found
