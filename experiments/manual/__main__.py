"""The command: ``python -m kerfgym.experiments.manual``, see :mod:`experiments.studies`::

    python -m kerfgym.experiments.manual --list               # studies, what they cost, which are stale
    python -m kerfgym.experiments.manual following blame      # these anew, and what the pages show of them
    python -m kerfgym.experiments.manual --stale              # all that are not as old as the code
    python -m kerfgym.experiments.manual --write              # only the pages, from stored results

A study that fails does not stop the others. One that was killed goes on, or begins anew, with the same command; those
that are done are no longer stale.
"""

import argparse
import sys
import traceback

from ...envs.engine.quantity import InvalidInput
from ..studies import marks, recorded
from ..studies.registry import Study, run, studies
from . import docs


def main(arguments: list[str] | None = None) -> int:
    """Does what the words say; 1 if a study or a page failed, or if ``--list`` found a stale one."""
    parser = argparse.ArgumentParser(
        prog="python -m kerfgym.experiments.manual",
        description="Measure what README and manual show, and write it into them.",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="studies to make anew; --list names them")
    parser.add_argument("--list", action="store_true", help="tell the studies, and which are stale")
    parser.add_argument("--stale", action="store_true", help="make anew what is stale")
    parser.add_argument("--all", action="store_true", help="make everything anew")
    parser.add_argument("--write", action="store_true", help="only write the pages, from stored results")
    parser.add_argument("--except", dest="without", action="append", default=[], metavar="NAME", help="not this study")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="worker processes (2)")
    asked = parser.parse_args(arguments)
    if asked.jobs < 1:
        parser.error(f"--jobs {asked.jobs} is out of range; at least 1")
    if not (asked.names or asked.list or asked.stale or asked.all or asked.write):
        parser.error("say what: NAME …, --list, --stale, --all or --write")
    try:
        known, named = studies(), studies(asked.names) if asked.names else []
        left_out = {each.name for each in studies(asked.without)} if asked.without else set()
        if asked.list:
            return tell(known)
        wanted = known if asked.all else [s for s in known if s in named or (asked.stale and s.outdated())]
    except InvalidInput as error:
        print(f"kerfgym: error: {error}", file=sys.stderr)
        return 2
    return int(not make([s for s in wanted if s.name not in left_out], asked.jobs))


def tell(known: list[Study]) -> int:
    """Prints a line for each study; 1 if one is stale."""
    stale = 0
    for each in known:
        why = each.outdated()
        stale += bool(why)
        state = "as old as the code" if not why else why[0] if why[0] == "never run" else f"stale: {in_words(why)}"
        print(f"{each.name:16s} {cost(each):>12s}  {each.about}\n{'':16s} {'':12s}  {state}")
    print(f"\n{stale} of {len(known)} are stale" if stale else f"\nall {len(known)} are as old as the code")
    return int(stale > 0)


def in_words(changed: list[str], most: int = 4) -> str:
    """What has changed, not more than a few."""
    more = f" and {len(changed) - most} more" if len(changed) > most else ""
    return ", ".join(changed[:most]) + more


def cost(study: Study) -> str:
    """What a study took last, or else what is expected."""
    found = recorded.read(study.name)
    if found and found.get("wall_seconds"):
        workers = found.get("workers", 1)
        return f"{found['wall_seconds'] / 60:.1f} min" + (f" × {workers}" if workers > 1 else "")
    return f"{study.minutes:g} CPU-min"


def make(wanted: list[Study], workers: int) -> bool:
    """Runs studies and writes the pages after each; whether all went well."""
    if wanted:
        print(f"to be made: {', '.join(f'{each.name} ({cost(each)})' for each in wanted)}", flush=True)
    failed, origin = [], recorded.origin()
    for i, each in enumerate(wanted, start=1):
        print(f"[{i}/{len(wanted)}] {each.name}: {each.about}", flush=True)
        try:
            print(f"  {run(each, workers, origin)}; {recorded.file(each.name)}", flush=True)
        except Exception as error:  # a study that fails must not take the others along
            traceback.print_exc()
            print(f"  failed: {type(error).__name__}: {error}", flush=True)
            failed.append(each.name)
    broken = write()
    if failed:
        print(f"failed: {', '.join(failed)}; the same command with these names makes them", file=sys.stderr)
    return not failed and not broken


def write() -> bool:
    """Writes the pages that have changed; whether one could not be made."""
    try:
        docs.main()
    except InvalidInput as error:
        print(f"kerfgym: error: pages not written: {error}", file=sys.stderr)
        return True
    for page in (docs.README, *sorted(docs.FOLDER.glob("*.md"))):
        for claim in marks.broken(page.read_text(encoding="utf-8")):
            print(f"kerfgym: {page.name} says what is no longer so: {claim}", file=sys.stderr)
    return False


if __name__ == "__main__":
    sys.exit(main())
