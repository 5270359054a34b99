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
from ...agents.train import Diverged
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
"""Steps of training by learner and by what is equal. CPU times are as nearly equal as that allows, as the table shows:
a learner's rates follow its steps, so these must be known beforehand. The others would need hours for PPO's steps."""

_SLOWLY = {"policy.output_gain": 0.003, "algorithm.learning_rate": 1e-5, "algorithm.learning_starts": 100}
OWN: dict[str, dict[str, Any]] = {
    "gradient": {},
    "ppo": {
        "policy.spread": 0.02, "policy.output_gain": 0.003,
        "algorithm.learning_rate": 1e-4, "algorithm.final_learning_rate": 1e-5,
    },
    "recurrent-ppo": {
        "policy.spread": 0.1, "policy.output_gain": 0.003,
        "algorithm.learning_rate": 3e-5, "algorithm.final_learning_rate": 1e-5,
    },
    "sac": {**_SLOWLY, "policy.spread": 0.02},
    "td3": {**_SLOWLY, "algorithm.noise": 0.02},
    "tqc": {**_SLOWLY, "policy.spread": 0.02},
}  # fmt: skip
"""What differs from a learner's preset besides: a weight has a wider say than a velocity, and with the rate and the
exploration of their presets all learners by rewards lose their base, or come to no finite numbers. The best of up to
five short trainings of each on tune seeds. The preset by gradients is made for this face."""

FILE = TRAINED / "learners.csv"


def changes(learner: str, equal: str) -> dict[str, Any]:
    """What differs from a learner's preset, by dotted name: the face, the steps, and how far it explores."""
    face = presets.preset("gradient", ENV).environment
    steps = STEPS[learner][equal]
    half = max(steps // 2, 1)  # best of two: one evaluation costs as much as seconds of training
    found = {f"environment.{key}": face[key] for key in ("control", "observation", "base", "scenario")}
    found |= {"steps": steps, "evaluation.every": half, "checkpoint.every": half, "evaluation.episodes": 132}
    return found | OWN[learner]


def folder(learner: str, equal: str, seed: int) -> Path:
    """Of a training's run; one that stands for both kinds of equality is done once."""
    return Path("runs") / f"learner-{learner}-{STEPS[learner][equal]}-{seed}"


def trained(which: tuple[str, str, int]) -> bool:
    """Whether a training came to a policy; it is done if it is not there yet."""
    learner, equal, seed = which
    run, changed = folder(*which), changes(learner, equal)
    renew(run)
    if not (run / "run.json").is_file():
        words = several.command(
            learner, ENV, None, None, [f"{key}={value}" for key, value in changed.items()], "cpu", 1
        )
        with runs.at_work(run, resume=True):
            given = presets.preset(learner, ENV, changed)
            try:
                into(run, given, seed, "cpu", 1, False, [*words, "--seed", str(seed)], quiet=True)
            except Diverged:
                return False
    return True


def judged(which: list[tuple[str, str, int]], workers: int) -> pd.DataFrame:
    """One row for each training: what it cost, and its score on test seeds beside its base's.

    One that came to no finite numbers has none of these.
    """
    good = {each: str(folder(*each) / "policy") for each in which if (folder(*each) / "run.json").is_file()}
    policies = dict.fromkeys(good.values())
    base = presets.preset("gradient", ENV).environment["base"]
    (grid,) = grids.plan([SUITE], [base, *policies], seeds=TESTED)
    found = benchmarking.run_grids([grid], Path("runs") / "learners", with_ms=False, overwrite=True, workers=workers)
    summary = found[SUITE].summary()
    surely = comparison.figures(found[SUITE])
    rows: list[dict[str, Any]] = []
    for learner, equal, seed in which:
        row = {"learner": learner, "equal": equal, "seed": seed, "diverged": (learner, equal, seed) not in good}
        if row["diverged"]:
            rows.append(row)
            continue
        policy = good[learner, equal, seed]
        ledger = files.json_(folder(learner, equal, seed) / "run.json")["ledger"]
        rows.append(row | {
            "training_steps": ledger["training_steps"],
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
    once = {folder(*each): each for each in which}
    for _ in pool.spread(trained, list(once.values()), jobs):
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
