"""The shipped policies: trained from the presets as they stand, into ``agents/trained/<name>/``::

    make policies                 # or: python -m kerfgym.experiments.studies.ship [NAME …]
    make train                    # or: … --check height-following-gradient
    python -m kerfgym.experiments.studies.ship --seeds 5 height-following-gradient

The last also trains with other seeds and writes what each came to on *test* seeds into ``seeds.csv`` beside the
policy: one seed says nothing about a training. Which seed is shipped stands here, not in the results. The second trains
one policy anew and tells whether it comes out as those trainings did; it ships nothing. An interrupted training goes on
where its last checkpoint stands, unless machine, laws or settings have changed since it began.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from scipy import stats
from tyro.conf import Positional, arg

from ...agents import settings as presets
from ...agents import train
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files
from ..benchmark import benchmarking
from ..measure import grids
from ..report.terminal import WEIGHED
from ..results.conclusions import REFERENCE
from ..statistics import comparison
from ..store import runs, script
from ..store.stamp import LAWS, LOADED, PLANNED, with_imports
from ..train.folder import into

TRAINED = Path(__file__).parents[2] / "agents" / "trained"

VERSION_1 = [f"following-v1/{name}" for name in scenarios.core("following-v1")]
"""The core of the following suite's first version."""

SHIPPED: dict[str, tuple[str, str, int, dict[str, Any]]] = {
    "height-following-gradient": ("gradient", "kerfgym/HeightFollowing-v0", 0, {}),
    # Version 1 of the suite is another machine, too: its plate is as wide as the tip.
    "height-following-v1-gradient": ("gradient", "kerfgym/HeightFollowing-v0", 0, {
        "environment.scenario": VERSION_1, "evaluation.scenario": VERSION_1, "evaluation.episodes": 24 * len(VERSION_1),
    }),
    "height-following-ppo": ("ppo", "kerfgym/HeightFollowing-v0", 0, {}),
    # Window, trim and gain of the paper's loop from millisecond to millisecond, against the best fixed ones.
    "height-following-schedule-ppo": ("ppo", "kerfgym/HeightFollowing-v0", 0, {
        "environment.control": "schedule", "environment.base": "xi2023-tuned",
        "environment.scenario": [
            "tilt", "tilt", "wavy", "rough", "random-k2", "random-k3", "step", "step-flutter", "impulses", "impulses",
            "flutter", "chatter", "chatter", "corners", "tone.toml", "mixed.toml",
        ],
        "environment.reward.rate": 0.3,  # the default: a change of gain is no tremor
        "environment.reward.tolerance": 5e-4, "policy.spread": 0.4, "policy.spread_by_state": False,
        "algorithm.learning_rate": 1e-3, "algorithm.gamma": 0.98,  # what a window did shows later than a velocity
        "steps": 1_920_000, "checkpoint.every": 480_000, "evaluation.every": 480_000, "evaluation.episodes": 112,
    }),
    "contour-following-ppo": ("ppo", "kerfgym/ContourFollowing-v0", 0, {}),
    "cutting-ppo": ("ppo", "kerfgym/Cutting-v0", 0, {}),
}  # fmt: skip
"""Algorithm, environment and seed of each, and what differs from the preset."""

MADE_FOR = {"height-following-v1-gradient": "following-v1"}
"""Suites of those that were not trained for their environment's present one."""

LARGEST = 1_000_000
"""Bytes of a shipped policy."""


def trained(name: str, seed: int) -> Path:
    """The run folder of a training, which is done if it is not there yet; Ms is measured of the shipped seed's."""
    own = SHIPPED[name][2]
    return _trained(name, seed, Path("runs") / f"shipped-{name}{'' if seed == own else f'-{seed}'}")


def _trained(name: str, seed: int, run: Path) -> Path:
    algorithm, env, own, changes = SHIPPED[name]
    _renew(run)
    if not (run / "run.json").is_file():
        given = presets.preset(algorithm, env, changes)
        words = ["kerfgym", "train", algorithm, "--env", env, "--seed", str(seed)]
        words += [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
        with runs.at_work(run, resume=True):
            into(run, given, seed, "cpu", 1, seed == own, words)
    return run


def _renew(run: Path) -> None:
    """Begins a training anew whose machine, law or settings are no longer those that it began with."""
    now = with_imports([Path(train.__file__)], (*LOADED, *PLANNED, *LAWS, "agents/presets/*.toml"))
    made_from = run / "made-from.json"
    if not made_from.is_file() or files.json_(made_from) != now:
        shutil.rmtree(run, ignore_errors=True)
        run.mkdir(parents=True)
        runs.write_json(made_from, now)


def ship(name: str, folder: Path = TRAINED) -> Path:
    """Trains a policy and puts artefact and record where they are shipped from."""
    run = trained(name, SHIPPED[name][2])
    files = [*(run / "policy").iterdir(), run / "run.json", run / "evaluations.csv"]
    size = sum(file.stat().st_size for file in files)
    if size > LARGEST:
        raise RuntimeError(f"{name} takes {size} bytes; at most {LARGEST}")
    for file in files:
        with runs.atomic(folder / name / file.name) as part:
            shutil.copyfile(file, part)
    return folder / name


def seeds_of(name: str, seeds: Sequence[int]) -> pd.DataFrame:
    """What trainings with these seeds came to: one row each, on the suite's test seeds.

    Columns: ``seed, cpu_seconds, simulated_steps, failed, score`` (the suite's), ``ratio`` (the reference's over it)
    with its 95 % interval and, of jobs, figures over the reference's.
    """
    return judged(name, {seed: trained(name, seed) for seed in seeds})


def judged(name: str, folders: dict[int, Path]) -> pd.DataFrame:
    """The same of trainings that are done, by seed."""
    suite = suite_of(name)
    policies = {str(run / "policy"): seed for seed, run in folders.items()}
    reference = str(scenarios.rules(suite).get("reference", REFERENCE))
    (grid,) = grids.plan([suite], [reference, *policies])
    place = Path("runs") / f"judged-{name}"
    found = benchmarking.run_grids([grid], place, with_cost=False, overwrite=True, workers=2)[suite]
    summary, surely = found.summary(), comparison.figures(found)
    traded = comparison.relative(found, WEIGHED) if found.jobs else None
    rows = []
    for policy, seed in policies.items():
        ledger = files.json_(folders[seed] / "run.json")["ledger"]
        row = {"seed": seed, "cpu_seconds": ledger["cpu_seconds"], "simulated_steps": ledger["simulated_steps"]}
        row |= {"failed": int(summary.loc[policy, "failed"])}
        row |= surely.loc[policy, ["score", "ratio", "ratio_low", "ratio_high"]].to_dict()
        if traded is not None:
            row |= {f"{metric}_over": traded.loc[policy, metric] for metric in WEIGHED}
        rows.append(row)
    return pd.DataFrame(rows)


def further(scores: np.ndarray) -> tuple[float, float]:
    """Where the score of one more training lies with 95 %, from those of some: Student's t of their logarithms.

    Raises:
        InvalidInput: fewer than two, of which nothing can be told.
    """
    if len(scores) < 2:
        raise InvalidInput(f"{len(scores)} trainings tell nothing about one more; at least 2, by --seeds")
    logs, n = np.log(scores), len(scores)
    reach = stats.t.ppf(0.975, n - 1) * logs.std(ddof=1) * np.sqrt(1.0 + 1.0 / n)
    return float(np.exp(logs.mean() - reach)), float(np.exp(logs.mean() + reach))


def reproduced(name: str) -> bool:
    """Trains a shipped policy anew and tells whether it comes out as its stored trainings did."""
    stored = TRAINED / name / "seeds.csv"
    if not stored.is_file():
        raise InvalidInput(f"{name} has no trainings to compare with; first --seeds 5 {name}")
    before = pd.read_csv(stored)
    low, high = further(before["score"].to_numpy())
    own, run = SHIPPED[name][2], Path("runs") / f"again-{name}"
    if (run / "run.json").is_file():  # of an earlier check; what an interrupted one left goes on
        shutil.rmtree(run)
    now = judged(name, {own: _trained(name, own, run)}).iloc[0]
    within = bool(low <= now["score"] <= high and not now["failed"])
    print(
        f"{name}: score {now['score']:.3f}, {now['ratio']:.2f} × closer than the reference "
        f"({now['ratio_low']:.2f} … {now['ratio_high']:.2f} over test seeds), {int(now['failed'])} failed runs, "
        f"{now['cpu_seconds']:.0f} CPU-s\n"
        f"{len(before)} stored trainings: median {before['score'].median():.3f}; "
        f"95 % of further ones lie within {low:.3f} … {high:.3f}: {'reproduced' if within else 'NOT reproduced'}"
    )
    return within


def suite_of(name: str) -> str:
    """The suite that a shipped policy was trained for."""
    if name in MADE_FOR:
        return MADE_FOR[name]
    return next(suite for suite in grids.SHOWN if scenarios.rules(suite)["environment"] == SHIPPED[name][1])


def main(
    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME")] = (),
    seeds: int = 0,
    check: bool = False,
) -> int:
    """Train the shipped policies from the presets as they stand.

    Args:
        names: of policies; without any, all.
        seeds: compare trainings with the seeds 0 … N−1 too.
        check: ship nothing; tell whether a training comes out as those of seeds.csv did.
    """
    chosen = script.known(names, SHIPPED, "policy")
    if check and seeds:
        raise InvalidInput("--check trains the shipped seed alone; leave --seeds away")
    if check:
        return sum(not reproduced(name) for name in chosen)
    for name in chosen:
        print(ship(name))
        if seeds:
            table = seeds_of(name, range(seeds))
            with runs.atomic(TRAINED / name / "seeds.csv") as part:
                table.to_csv(part, index=False, float_format="%.5g")
            print(table.to_string(index=False))
    return 0


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.studies.ship")
