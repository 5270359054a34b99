"""``python -m kerfgym.experiments.studies.endurance``; see the package's text."""

from pathlib import Path
from typing import Annotated

import tyro

from ...measure import grids
from ...store import runs, script
from .endured import DRAWN, MODULE, PAGE, made
from .sheets import sheets as sheets_of

QUICK = (("xi2023-tuned", "self-tuning"), 4, 60.0)
"""Controllers, seeds and seconds of ``--quick``."""


def main(
    controllers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (),
    sheets: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (),
    seeds: int = 24,
    split: str = "test",
    duration: float = 300.0,
    path: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    quick: bool = False,
    name: str = "endurance",
    jobs: int = 1,
    docs: bool = False,
) -> None:
    """Run every follower for minutes, and tell whether it gets worse.

    Args:
        controllers: names; without any, all that are shipped, policies too.
        sheets: some of wavy, rough, rough+flutter+impulses, chatter, random-k2, random-k3, shift and path; without any,
            all.
        seeds: of each sheet.
        split: of the seeds.
        duration: seconds of each run; a drawing takes what it takes.
        path: a drawing (DXF, SVG, G-code) that is cut whole, as a job of the suite contour.
        quick: two controllers, four seeds, one minute.
        name: of the folder in runs/.
        jobs: processes.
        docs: write the tables into docs/endurance.md, too; those of a drawing alone have a place of their own there.
    """
    chosen = controllers or (QUICK[0] if quick else tuple(grids.shipped("following")))
    seeds, duration = (min(seeds, QUICK[1]), min(duration, QUICK[2])) if quick else (seeds, duration)
    found = sheets_of(sheets, duration, path)
    which = grids.split_seeds(seeds, split)
    words = [*(["--quick"] if quick else []), "--seeds", str(seeds)]
    words += ["--duration", f"{duration:g}", *(["--sheets", *sheets] if sheets else [])]
    words += [*(["--controllers", *controllers] if controllers else []), *(["--path", path.name] if path else [])]
    folder = runs.open_folder(runs.named(name), overwrite=True)
    drawn = all(scenario.job for scenario in found.values())
    made(chosen, found, which, folder, words, jobs, (DRAWN if drawn else PAGE) if docs else None)


if __name__ == "__main__":
    script.run(main, MODULE)
