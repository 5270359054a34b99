"""``python -m kerfgym.experiments.studies.leads``; see the package's text."""

import time
from pathlib import Path
from typing import Annotated

import pandas as pd
import tyro

from ....envs.engine.quantity import InvalidInput
from ...store import runs, script
from ...store.progress import progress
from .. import pages
from .sheets_of_parts import files, random, sheet_of

MODULE = "kerfgym.experiments.studies.leads"


def main(
    folders: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FOLDER …")] = (),
    contours: int = 6000,
    seed: int = 0,
    name: str = "leads",
    docs: bool = False,
) -> None:
    """Plan lead-ins into contours made at random, and those of drawings, and look for any that is not in the scrap.

    Args:
        folders: with drawings (DXF, SVG), which are read too.
        contours: made at random, at least so many.
        seed: of the sheets.
        name: of the folder in runs/.
        docs: write the table into docs/jobs.md, too.
    """
    if contours < 1:
        raise InvalidInput(f"--contours {contours} is out of range; at least 1")
    for folder in folders:
        if not folder.is_dir():
            raise InvalidInput(f"no folder '{folder}'")
    place = runs.open_folder(runs.named(name), overwrite=True)
    words = [*(folder.name for folder in folders), "--contours", contours, "--seed", seed]
    started, campaign = time.process_time(), pages.Campaign(MODULE, words, place)
    frames: list[pd.DataFrame] = []
    with progress("contours") as told:
        done = 0
        for frame in random(contours, seed):
            frames.append(frame.assign(source=f"seed {seed}, sheet {len(frames)}"))
            done += len(frame)
            told(min(done, contours), contours, frame["kind"].iloc[0])
    refused = drawn = 0
    for file, found in files(folders):
        if isinstance(found, str):
            refused += 1
        elif len(found):
            drawn += 1
            frames.append(found.assign(source=str(file)))
    everything = pd.concat(frames, ignore_index=True)
    wrong = everything[everything["wrong"] != ""]
    facts = {"cpu_seconds": round(time.process_time() - started, 1), "seed": seed, "contours": len(everything)}
    facts |= {"wrong": len(wrong), "on_the_contour": int((everything["how"] == "on the contour").sum())}
    runs.write_table(place, "leads", everything)
    lines = (f"{row.source}, contour {row.contour + 1}: {row.wrong}" for row in wrong.head(20).itertuples())
    campaign.publish([sheet_of(everything, refused, drawn)], facts, "jobs.md", "leads" if docs else None, told=lines)


if __name__ == "__main__":
    script.run(main, MODULE)
