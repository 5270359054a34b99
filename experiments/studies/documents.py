"""Study of the five documents."""

from typing import Any

from ..reproduce import claims, claims_page
from ..reproduce.carry_out import reproduce
from ..store.progress import progress
from ..store.stamp import LAWS, LOADED, PLANNED
from .registry import Trial, study

SEEDS = 24


@study(
    "reproduction",
    "every claim of the five documents, with its verdict",
    f"kerfgym reproduce --seeds {SEEDS}",
    6.0,
    (*LOADED, *PLANNED, *LAWS, "experiments/reproduce/*.py", "experiments/reproduce/*.toml", "envs/suites/*/*.toml"),
)
def of_documents(trial: Trial) -> dict[str, Any]:
    """Rows by document and verdict."""
    finished = (trial.folder / "run.json").is_file()
    with progress("studies") as told:
        parts = reproduce((), trial.folder, SEEDS, trial.workers, finished, not finished, told)
    failed = [part["study"] for part in parts if part["error"]]
    if failed:
        raise RuntimeError(f"{', '.join(failed)} failed; see {trial.folder / 'parts'}")
    found = {name: claims_page.counts([p for p in parts if p["document"] == name]) for name in claims.DOCUMENTS}
    rows = sum(len(p["rows"]) for p in parts)
    return {"numbers": {"documents": found, "all": claims_page.counts(parts), "rows": rows}}
