"""``python -m kerfgym.experiments.kills``: kill −9 at many moments, then the same command once more.

It must then end well, with the same figures as one that was let alone, and leave nothing behind.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional, arg

from ...envs.engine.quantity import InvalidInput, did_you_mean
from ..markdown import table
from .campaign import campaign
from .commands import COMMANDS


def kills(
    commands: Annotated[Positional[tuple[str, ...]], arg(metavar="COMMAND")] = (),
    moments: int = 50,
    seed: int = 0,
    folder: Path | None = None,
) -> int:
    """Kills commands and prints what came of it, a row for each.

    Args:
        commands: names such as benchmark or 'tune gp'. Default: all.
        moments: of each.
        seed: of the moments.
        folder: to work in; kept where something went wrong. Default: a temporary one.

    Returns:
        how many kills had a bad end.
    """
    for name in commands:
        if name not in COMMANDS:
            raise InvalidInput(f"unknown command '{name}'; {did_you_mean(name, COMMANDS)}")
    rows, bad = [], 0
    with tempfile.TemporaryDirectory(prefix="kerfgym-kills-") as temporary:
        for name in commands or COMMANDS:
            met: Counter[str] = Counter()
            wrong = 0
            for kill in campaign(COMMANDS[name], (folder or Path(temporary)) / name.replace(" ", "-"), moments, seed):
                met[kill.found] += 1
                if kill.trouble:
                    wrong += 1
                    print(f"{name}, killed after {kill.moment:.2f} s ({kill.found}): {kill.trouble}", flush=True)
                elif sys.stderr.isatty():
                    print(f"\r{name} {met.total()}/{moments} ", end="", file=sys.stderr, flush=True)
            bad += wrong
            found = [str(met[kind]) for kind in ("nothing", "begun", "record", "over")]
            rows.append([name, str(met.total()), *found, str(wrong)])
            print(f"{name}: {met.total()} kills, {wrong} with a bad end", file=sys.stderr, flush=True)
    print(table(["command", "kills", "met nothing", "a run begun", "its record written", "it was over", "bad ends"],
                   rows))  # fmt: skip
    return bad


def main() -> None:
    """Entry point."""
    try:
        raise SystemExit(min(tyro.cli(kills, prog="python -m kerfgym.experiments.kills"), 100))
    except InvalidInput as error:
        print(f"kills: error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
