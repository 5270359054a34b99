"""A run of minutes with everything that is kept of it: tables in its folder, and on the manual's page."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ....envs.scenarios import Scenario
from ...store import runs
from ...store.progress import progress
from .. import pages
from .minutes import endurance
from .windows import promised, promises, table

MODULE = "kerfgym.experiments.studies.endurance"

PAGE, DRAWN = "endurance", "endurance-drawing"
"""Marks of the manual's page: sheets, and the drawing that a user gives."""


def made(
    controllers: Sequence[str],
    found: dict[str, Scenario],
    seeds: Sequence[int],
    folder: Path,
    words: list[str],
    jobs: int = 1,
    mark: str | None = None,
) -> pd.DataFrame:
    """Runs controllers over sheets, keeps and shows the verdicts, and writes them between ``mark``, if one is named."""
    campaign = pages.Campaign(MODULE, words, folder, jobs)
    with progress("runs") as told:
        frame, windows = endurance(controllers, found, seeds, jobs=jobs, told=told)
    kept = promises(frame)
    seconds = {name: scenario.duration for name, scenario in found.items() if not scenario.job}
    facts = {"seeds": f"{seeds[0]}-{seeds[-1]}", "controllers": list(controllers), "seconds": seconds, "promises": kept}
    runs.write_table(folder, "verdicts", frame)
    runs.write_table(folder, "windows", windows)
    campaign.publish([promised(kept), table(frame)], facts, f"{PAGE}.md", mark)
    return frame
