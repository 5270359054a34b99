"""``python -m kerfgym.experiments.studies.corpus FOLDER``; see the package's text."""

from pathlib import Path
from typing import Annotated

import tyro

from ....envs.engine.quantity import InvalidInput
from ...store import runs, script
from ...store.progress import progress
from .. import pages
from .accepted import farthest, list_of, summary
from .each import TIME_LIMIT, files, verdicts
from .judged import FAILED, REFUSED

MODULE = "kerfgym.experiments.studies.corpus"


def main(
    folder: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FOLDER")]],
    limit: float = TIME_LIMIT,
    name: str = "corpus",
    docs: str = "",
) -> None:
    """Read every drawing and programme of a folder, and tell what became of each.

    Args:
        folder: DXF, SVG and G-code files, also in folders within it.
        limit: seconds for a file.
        name: of the folder in runs/.
        docs: marks of docs/corpus.md between which the tables are written, too.
    """
    paths = files(folder)
    if not paths:
        raise InvalidInput(f"{folder}: no DXF, SVG or G-code file in it")
    out = runs.open_folder(runs.named(name), overwrite=True)
    campaign, found = pages.Campaign(MODULE, [folder.name], out), []
    with progress("files") as told:
        for verdict in verdicts(paths, limit):
            found.append(verdict)
            told(len(found), len(paths), verdict.path.name)
    records = [{**vars(v), "path": str(v.path), "box": list(v.box) if v.box else None} for v in found]
    runs.write_json(out / "verdicts.json", records)
    shown = [summary(found), list_of(found, folder, REFUSED), list_of(found, folder, FAILED), farthest(found, folder)]
    shown = [sheet for sheet in shown if sheet.sections and sheet.sections[0]]
    campaign.publish(shown, {}, "corpus.md", docs, documented=2)


if __name__ == "__main__":
    script.run(main, MODULE)
