"""Kill −9 at many moments and steps of writing, then the same command: ``python -m kerfgym.experiments.studies.kills``.

It must then end well, with the same figures as one that was let alone, and leave nothing behind.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ...store import script
from ...store.markdown import table
from .commands import COMMANDS
from .killing import campaign


def kills(
    commands: Annotated[Positional[tuple[str, ...]], arg(metavar="COMMAND")] = (),
    moments: int = 50,
    steps: int = 16,
    seed: int = 0,
    folder: Path | None = None,
) -> int:
    """Kills commands and prints what came of it, a row for each.

    Args:
        commands: names such as benchmark or 'tune gp'. Default: all.
        moments: of each, at every other of which its worker processes are killed too.
        steps: of writing at which each is killed: before or after a file takes its name, is begun, cut or removed.
        seed: of the moments and steps.
        folder: to work in; kept where something went wrong. Default: a temporary one.

    Returns:
        how many kills had a bad end.
    """
    wanted = script.known(commands, COMMANDS, "command")
    rows, bad = [], 0
    with tempfile.TemporaryDirectory(prefix="kerfgym-kills-") as temporary:
        for name in wanted:
            met: Counter[str] = Counter()
            wrong = 0
            place = (folder or Path(temporary)) / name.replace(" ", "-")
            for kill in campaign(COMMANDS[name], place, moments, seed, steps):
                met[kill.found] += 1
                if kill.trouble:
                    wrong += 1
                    print(f"{name}, killed {kill.moment} ({kill.found}): {kill.trouble}", flush=True)
                elif sys.stderr.isatty():
                    print(f"\r{name} {met.total()}/{moments + steps} ", end="", file=sys.stderr, flush=True)
            bad += wrong
            found = [str(met[kind]) for kind in ("nothing", "begun", "record", "over")]
            rows.append([name, str(met.total()), *found, str(wrong)])
            print(f"{name}: {met.total()} kills, {wrong} with a bad end", file=sys.stderr, flush=True)
    moments_met = ["met nothing", "a run begun", "its record written", "it was over"]
    print(table(["command", "kills", *moments_met, "bad ends"], rows))
    return bad


if __name__ == "__main__":
    script.run(kills, "kerfgym.experiments.studies.kills")
