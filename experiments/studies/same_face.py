"""Every learner on the same face of the machine: the same signals, weights and sheets.

::

    python -m kerfgym.experiments.studies.same_face [LEARNER …]

writes ``agents/trained/learners.csv``, one row for each training: five seeds of each learner at equal CPU time, and
of those that can do as many steps in it at equal simulated steps. The face is that of the preset by gradients,
``control="weights"`` on ``observation="sheet"`` with its base and its sheets; what else a learner needs stands in its
own preset. Trainings that are there already are not done again, so an interrupted study goes on.
"""

from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from tyro.conf import Positional, arg

from ...agents import settings as presets
from ...envs.safety import files
from ..benchmark import benchmarking
from ..measure import grids
from ..statistics import comparison
from ..store import pool, runs, script
from ..train import several
from ..train.folder import into
from .ship import TRAINED, renew

ENV, SUITE = "kerfgym/HeightFollowing-v0", "following"

SEEDS, TESTED = 5, 50
"""Trainings of each learner, and test seeds that they are judged by."""

STEPS = {
    "gradient": {"equal steps": 2_304_000, "equal CPU time": 20_000_000},
    "ppo": {"equal steps": 2_400_000, "equal CPU time": 2_400_000},
    "recurrent-ppo": {"equal CPU time": 400_000},
    "sac": {"equal CPU time": 36_000},
    "td3": {"equal CPU time": 50_000},
    "tqc": {"equal CPU time": 18_000},
}
"""Steps of training by learner and by what is equal. CPU times are equal to some ten percent, as the table shows: a
learner's rates follow its steps, so these must be known beforehand. The others would need hours for PPO's steps."""

CALM = {"policy.spread": 0.02, "policy.output_gain": 0.02, "algorithm.learning_starts": 1000, "algorithm.noise": 0.02}
"""A weight has a wider say than a velocity, so learners explore less than in their presets."""

FILE = TRAINED / "learners.csv"


def changes(learner: str, equal: str) -> dict[str, Any]:
    """What differs from a learner's preset, by dotted name: the face, the steps, and how far it explores."""
    face = presets.preset("gradient", ENV).environment
    steps = STEPS[learner][equal]
    half = max(steps // 2, 1)  # best of two: one evaluation costs as much as seconds of training
    found = {f"environment.{key}": face[key] for key in ("control", "observation", "base", "scenario")}
    found |= {"steps": steps, "evaluation.every": half, "checkpoint.every": half, "evaluation.episodes": 132}
    given = presets.preset(learner, ENV)
    calm = {} if learner == "gradient" else CALM  # its preset is for this face
    return found | {key: value for key, value in calm.items() if given.value(key) is not None}


def folder(learner: str, equal: str, seed: int) -> Path:
    """Of a training's run."""
    return Path("runs") / f"learner-{learner}-{equal.split()[1]}-{seed}"


def trained(which: tuple[str, str, int]) -> None:
    """A training, if it is not there yet."""
    learner, equal, seed = which
    run, changed = folder(*which), changes(learner, equal)
    renew(run)
    if not (run / "run.json").is_file():
        words = several.command(
            learner, ENV, None, None, [f"{key}={value}" for key, value in changed.items()], "cpu", 1
        )
        with runs.at_work(run, resume=True):
            given = presets.preset(learner, ENV, changed)
            into(run, given, seed, "cpu", 1, False, [*words, "--seed", str(seed)])


def judged(which: list[tuple[str, str, int]], workers: int) -> pd.DataFrame:
    """One row for each training: what it cost, and its score on test seeds beside its base's."""
    policies = {str(folder(*each) / "policy"): each for each in which}
    base = presets.preset("gradient", ENV).environment["base"]
    (grid,) = grids.plan([SUITE], [base, *policies], seeds=TESTED)
    found = benchmarking.run_grids([grid], Path("runs") / "learners", with_ms=False, overwrite=True, workers=workers)
    summary = found[SUITE].summary()
    surely = comparison.figures(found[SUITE])
    rows: list[dict[str, Any]] = []
    for policy, (learner, equal, seed) in policies.items():
        ledger = files.json_(folder(learner, equal, seed) / "run.json")["ledger"]
        rows.append({
            "learner": learner, "equal": equal, "seed": seed, "training_steps": ledger["training_steps"],
            "simulated_steps": ledger["simulated_steps"], "cpu_seconds": ledger["cpu_seconds"],
            "failed": int(summary.loc[policy, "failed"]), "score": surely.loc[policy, "score"],
            "of_base": surely.loc[policy, "score"] / surely.loc[base, "score"],
            "jitter": summary.loc[policy, "jitter"], "base_jitter": summary.loc[base, "jitter"],
        })  # fmt: skip
    return pd.DataFrame(rows)


def main(names: Annotated[Positional[tuple[str, ...]], arg(metavar="LEARNER")] = (), jobs: int = 2) -> None:
    """Train every learner on the same face, and judge them on test seeds.

    Args:
        names: of learners; without any, all. Rows of the others stay.
        jobs: processes.
    """
    chosen = script.known(names, STEPS, "learner")
    which = [(name, equal, seed) for name in chosen for equal in STEPS[name] for seed in range(SEEDS)]
    for _ in pool.spread(trained, which, jobs):
        pass
    table = judged(which, jobs)
    if FILE.is_file():
        before = pd.read_csv(FILE)
        table = pd.concat([before[~before["learner"].isin(chosen)], table])
    with runs.atomic(FILE) as part:
        table.to_csv(part, index=False, float_format="%.5g")
    print(table.to_string(index=False))


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.studies.same_face")
