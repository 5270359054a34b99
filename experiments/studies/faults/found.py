"""A fault campaign with everything that is kept of it: tables in its folder, and on the manual's page."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ....envs import scenarios
from ...store import runs
from ...store.progress import progress
from .. import pages
from .campaign import SCENARIOS, campaign
from .losses import MODULE, harmed, sheets

PAGE = "faults"


def made(
    controllers: Sequence[str],
    faults: int,
    seed: int,
    folder: Path,
    words: list[str],
    jobs: int = 1,
    mark: str | None = None,
) -> pd.DataFrame:
    """Puts faults into controllers, keeps and shows the tables, and writes them between ``mark``, if one is named."""
    kept = pages.Campaign(MODULE, words, folder, jobs)
    with progress("faults") as told:
        frame = campaign(controllers, faults, seed, jobs, told)
    found = {"seed": seed, "controllers": list(controllers), "scenarios": list(SCENARIOS), "faults": len(frame)}
    found |= {"seeds": f"test, from {scenarios.SPLITS['test'].start} on", "lost": int(frame["lost"].sum())}
    found["lost_by"] = frame["cause"].value_counts().drop("", errors="ignore").to_dict()
    found["harmed"] = len(harmed(frame))
    runs.write_table(folder, "faults", frame)
    kept.publish(sheets(frame, seed), found, f"{PAGE}.md", mark)
    return frame
