"""The best classical followers under caps on Ms: ``python -m kerfgym.experiments.studies.caps [NAME …]``.

A loop may be closer to the sheet because it is better or because it lives more dangerously. So every stack that has a
shipped preset is searched anew under each of :data:`CAPS`, with the same sampler and the same number of trials
(:mod:`experiments.tune.protocol`), and scored on *test* seeds. ``runs/caps/caps.csv`` has a row for each; a run that
was interrupted goes on where it stood.
"""

import argparse
import math
from pathlib import Path
from typing import Any

import pandas as pd

from ...envs.control.stack import Stack, asked
from ..store import runs
from ..store.progress import Bars
from ..tune import evaluate, goals, protocol
from ..tune.outcome import TEST_SEEDS

CAPS = (2.0, 3.3, math.inf)
"""The ranking's, that of the comparison with learned policies, and none."""

FOLLOWERS = tuple(name for name in protocol.NAMES if name not in ("preview-5ms", "oracle"))
"""Stacks of the information class *sensor* that have a preset."""

REFERENCE = "xi2023-tuned"


def tested(stack: Stack) -> dict[str, float]:
    """On test seeds: score, µm; collisions, those in scenarios with a guard too; overshoot of the descent, mm."""
    team = asked(stack)
    evaluator = evaluate.Evaluator(team, "following", range(1000, 1000 + TEST_SEEDS), 2)
    figures = evaluator.whole(team, ("rms_true", "collision", "overshoot"))
    overshoot = figures["descent"]["overshoot"] if "descent" in figures else [math.nan]
    return {
        "score_test_um": goals.score("rms_true", figures, evaluator.core),
        "collisions_test": int(sum(each["collision"].sum() for each in figures.values())),
        "overshoot_mm": float(max(overshoot)),
    }


def row(name: str, cap: float) -> dict[str, Any]:
    """One search and what its result is worth."""
    found, record = protocol.search(name, cap=cap)
    spent = {key: record[key] for key in ("ms", "trials", "sampler", "tune_seeds", "simulated_steps", "cpu_seconds")}
    values = {key: found.parameters()[key].value for key in protocol.space(found)}
    return {"controller": name, "cap": cap, **tested(found), **spent, "git": record["git"], "parameters": str(values)}


def table(names: list[str], file: Path) -> pd.DataFrame:
    """A row for each stack and cap; those that the file has are not made again."""
    done = pd.read_csv(file) if file.is_file() else pd.DataFrame({"controller": [], "cap": []})
    have = set(zip(done["controller"], done["cap"], strict=True))
    missing = [(name, cap) for cap in CAPS for name in names if (name, cap) not in have]
    with Bars() as bars:
        for name, cap in bars.each("searches", missing, len(missing)):
            done = pd.concat([done, pd.DataFrame([row(name, cap)])], ignore_index=True)
            with runs.atomic(file) as part:
                done.to_csv(part, index=False)
    return done


def main() -> None:
    """Searches, and prints the table."""
    parser = argparse.ArgumentParser(
        prog="python -m kerfgym.experiments.studies.caps", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(FOLLOWERS))
    names = parser.parse_args().names or list(FOLLOWERS)
    for name in names:
        if name not in FOLLOWERS:
            parser.error(f"unknown stack '{name}'; known: {', '.join(FOLLOWERS)}")
    folder = Path("runs") / "caps"
    folder.mkdir(parents=True, exist_ok=True)
    found = table(names, folder / "caps.csv")
    runs.write_json(folder / "run.json", runs.record(["python", "-m", "kerfgym.experiments.studies.caps", *names]))
    print(
        found.sort_values(["cap", "score_test_um"])
        .drop(columns=["parameters", "git", "sampler"])
        .to_string(index=False)
    )


if __name__ == "__main__":
    main()
