"""Makes mutants, runs the tests that can see them, and lists those that survive.

    python -m kerfgym.tests.mutations --count 120 --seed 0        # a random sample of all mutants
    python -m kerfgym.tests.mutations --again                     # those that survived, against the tests of now
    python -m kerfgym.tests.mutations --docs                      # docs/mutations.md from what is stored

Each mutant stands in a copy of the package, so this one is never changed, and its tests run in a process of their own,
forked after the libraries are loaded. One line of ``runs/mutations/results.jsonl`` tells each outcome as soon as it is
known: a run that was stopped goes on with the same command. A mutant whose file has changed since runs anew.

What survives is *equivalent* if no run could tell it from the original, with a reason in ``equivalent.toml``; else a
test is missing.
"""

import json
import os
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import tyro

from kerfgym.envs.engine import kernels
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.store import markdown
from kerfgym.experiments.studies import pages
from kerfgym.tests.mutations import child, tests_of
from kerfgym.tests.mutations.mutants import Mutant, mutants, sample

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = "mutations.md"
COPIED = ("__init__.py", "pyproject.toml", "envs", "baselines", "agents", "experiments", "tests", "docs", "README.md")


def main(
    count: int = 120,
    seed: int = 0,
    only: tuple[str, ...] = (),
    again: bool = False,
    limit: float = 900.0,
    folder: Path = ROOT / "runs" / "mutations",
    docs: bool = False,
) -> None:
    """Runs a random sample of all mutants of the plant and the laws against their tests.

    Args:
        count: how many.
        seed: of the sample.
        only: the sample is of mutants with one of these in their names, such as ``envs/plant/cut.py``, ``spot.py:118``.
        again: run those that survived once more.
        limit: s, after which a mutant counts as killed: it hangs.
        folder: where outcomes are kept.
        docs: only write docs/mutations.md from what is stored.
    """
    folder.mkdir(parents=True, exist_ok=True)
    store, reasons = folder / "results.jsonl", explained()
    every = [m for file in tests_of.modules(ROOT) for m in mutants(ROOT / file, file)]
    of = [m for m in every if not only or any(words in m.name for words in only)]
    wanted = sample(of, count, seed)
    if not wanted:
        raise InvalidInput(f"no mutant has {' or '.join(only)} in its name")
    known, words = outcomes(store), f"--count {count} --seed {seed}" + "".join(f" --only {each}" for each in only[:1])
    words += "".join(f" {each}" for each in only[1:])
    if docs:
        pages.put("mutations", report(wanted, known, reasons, words, len(of)), pages.manual(PAGE))
        return
    todo = [m for m in wanted if m.name not in known or known[m.name]["source"] != told(m)]
    if again:
        todo += [m for m in wanted if m not in todo and known[m.name]["by"] is None and key(m) not in reasons]
    todo.sort(
        key=lambda m: not tests_of.of(m.file)[0].startswith(tests_of.QUICK)
    )  # a run that is stopped has judged the more
    with tempfile.TemporaryDirectory(prefix="kerfgym-mutants-") as scratch:
        copy = Path(scratch) / "kerfgym"
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                copy.mkdir(exist_ok=True)
                shutil.copy(source, copy / name)
        if (compiled := ROOT / "envs" / "plant" / "__pycache__").exists():
            shutil.copytree(compiled, Path(scratch) / "kernels")
        sound: set[str] = set()
        for i, mutant in enumerate(todo):
            outcome = judged(mutant, copy, limit, sound)
            with store.open("a", encoding="utf-8") as out:
                out.write(json.dumps(outcome) + "\n")
            print(
                f"{i + 1}/{len(todo)} {outcome['by'] or 'SURVIVED'} {outcome['seconds']:.0f} s  {mutant.name}",
                flush=True,
            )
    known = outcomes(store)
    print(report(wanted, known, reasons, words, len(of)))


def key(mutant: Mutant) -> str:
    """Names a mutant in ``equivalent.toml``: with its line's text, which outlasts changes elsewhere in the file."""
    line = (ROOT / mutant.file).read_text(encoding="utf-8").splitlines()[mutant.line - 1].strip()
    return f"{mutant.file} | {line} | {mutant.name.partition(' ')[2]}"


def told(mutant: Mutant) -> str:
    """What an outcome is of: the mutant's line and those around it."""
    lines = (ROOT / mutant.file).read_text(encoding="utf-8").splitlines()
    return "\n".join(lines[max(0, mutant.line - 2) : mutant.line + 1])


def outcomes(store: Path) -> dict[str, dict[str, Any]]:
    """The latest outcome of each mutant by its name."""
    lines = store.read_text(encoding="utf-8").splitlines() if store.exists() else []
    return {outcome["name"]: outcome for outcome in map(json.loads, lines)}


def explained() -> dict[str, str]:
    """Reasons why survivors are equivalent, by :func:`key`."""
    return dict(tomllib.loads((HERE / "equivalent.toml").read_text(encoding="utf-8")))


def judged(mutant: Mutant, copy: Path, limit: float, sound: set[str]) -> dict[str, Any]:
    """The outcome of a mutant: the test file that kills it, or None.

    Raises:
        InvalidInput: that test file fails without a mutant, too. ``sound`` are those that are known not to.
    """
    path, begun, by = copy / mutant.file, time.time(), None
    source = path.read_bytes()
    path.write_bytes(mutant.applied(source))
    shutil.rmtree(copy.parent / "mutant", ignore_errors=True)
    try:
        for tests in tests_of.of(mutant.file):
            verdict = ran(copy, tests, limit, mutant.file)
            if verdict != "passed":
                by = f"{Path(tests).name}" + (f" ({verdict})" if verdict != "failed" else "")
                break
    finally:
        path.write_bytes(source)
    if by and tests not in sound:
        if ran(copy, tests, 2.0 * limit, "") != "passed":
            raise InvalidInput(f"{tests} fails without any mutant:\n{(copy.parent / 'last.txt').read_text()[-3000:]}")
        sound.add(tests)
    return {
        "name": mutant.name,
        "file": mutant.file,
        "line": mutant.line,
        "kind": mutant.kind,
        "old": mutant.old,
        "new": mutant.new,
        "by": by,
        "seconds": round(time.time() - begun, 1),
        "source": told(mutant),
    }


def ran(copy: Path, tests: str, limit: float, mutated: str) -> str:
    """``passed``, ``failed``, ``crashed`` or ``hangs``, by a forked process."""
    pid = os.fork()
    if pid == 0:
        child.become(copy, tests, mutated, kernels.STAMP)
    end = time.time() + limit
    while time.time() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return {0: "passed", 1: "failed", 2: "failed", 4: "failed"}.get(code, "crashed")
        time.sleep(0.05)
    os.killpg(pid, signal.SIGKILL)  # its own group: see child.become
    os.waitpid(pid, 0)
    return "hangs"


def report(
    wanted: list[Mutant], known: dict[str, dict[str, Any]], reasons: dict[str, str], words: str, every: int
) -> str:
    """Score and table of what survived."""
    have = [(m, known[m.name]) for m in wanted if m.name in known and known[m.name]["source"] == told(m)]
    survived = [(m, o) for m, o in have if o["by"] is None]
    equal = [m for m, _ in survived if key(m) in reasons]
    real = len(have) - len(equal)
    killed = len(have) - len(survived)
    kinds = Counter(m.kind for m, _ in have)
    lines = [
        f"Made by `python -m kerfgym.tests.mutations {words}`: of {every} mutants {len(wanted)}"
        f" were drawn and {len(have)} were run. {killed} were killed and {len(survived)} survived, of which"
        f" {len(equal)} are equivalent: a score of {100 * killed / max(real, 1):.1f} % of {real}."
        + ("" if len(have) == len(wanted) else " The run is not finished: the score says little yet."),
        "",
        markdown.table(
            ["kind", "run", "survived"],
            [[k, n, sum(m.kind == k for m, _ in survived)] for k, n in sorted(kinds.items())],
        ),
        "### Survivors",
        "",
        markdown.table(
            ["mutant", "why"],
            [[f"`{m.name}`", reasons.get(key(m), "a test is missing")] for m, _ in survived],
        ),
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except InvalidInput as error:
        sys.exit(f"error: {error}")
