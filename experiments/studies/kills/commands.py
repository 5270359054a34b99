"""The commands of the campaign: small, and with figures that can be compared."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ....envs.safety import files
from ....envs.scenarios import load
from ...tune.sampling import SAMPLERS

NAME = "run"
"""Of the run folder."""

Figures = dict[str, Any]


@dataclass(frozen=True)
class Command:
    """A command, what must be there before it, and the figures that it leaves.

    Attributes:
        words: after ``kerfgym``, without ``--name``.
        figures: of a finished run folder; what differs from run to run by nature, such as seconds, is left out.
        before: commands whose runs it needs.
        spent: what must not be there in the end.
    """

    words: tuple[str, ...]
    figures: Callable[[Path], Figures]
    before: tuple[tuple[str, ...], ...] = ()
    spent: tuple[str, ...] = (".begun",)


def prepare(folder: Path) -> None:
    """Writes the short scenarios that the commands take."""
    for name in ("wavy", "step", "impulses"):
        (folder / f"{name}.toml").write_text(load(name).varied(duration=0.4).to_toml(), encoding="utf-8")


def _tables(folder: Path, *names: str) -> Figures:
    return {name: (folder / name).read_bytes() for name in names}


def _frame(file: Path) -> str:
    """A table without its seconds."""
    frame = pd.read_csv(file)
    return frame.drop(columns=[c for c in frame if "seconds" in c]).to_csv(index=False)


def _without_seconds(data: Any) -> Any:
    if isinstance(data, dict):
        return {k: _without_seconds(v) for k, v in data.items() if "seconds" not in k and k not in ("git", "command")}
    return [_without_seconds(each) for each in data] if isinstance(data, list) else data


def _searched(name: str) -> Callable[[Path], Figures]:
    """Of a search, whose best is in the file ``name``."""
    return lambda folder: {
        "trials.csv": _frame(folder / "trials.csv"),
        name: _without_seconds(files.toml(folder / name)),
    }


def _train(folder: Path) -> Figures:
    return {"evaluations.csv": _frame(folder / "evaluations.csv"), **_tables(folder / "policy", "weights.safetensors")}


def _reproduce(folder: Path) -> Figures:
    parts = {file.name: _without_seconds(files.json_(file)) for file in sorted((folder / "parts").glob("*.json"))}
    return {**parts, **_tables(folder, "reproduce.md")}


_RUNS = ("runs.csv", "runs.parquet", "summary.csv")

_BENCHMARK = (
    *("benchmark", "-c", "pid", "-c", "xi2023-improved", "-s", "wavy.toml", "-s", "step.toml", "-s", "impulses.toml"),
    *("--seeds", "6", "--no-cost", "--no-blame", "--no-detuned"),
)

_SET = (
    *("environment.num_envs=8", "algorithm.n_steps=64", "algorithm.batch_size=128", "environment.max_steps=200"),
    *('environment.scenario="wavy.toml"', 'evaluation.scenario="wavy.toml"', "evaluation.episodes=4"),
)
_TRAINING = tuple(word for one in _SET for word in ("--set", one))

_SEARCH = (
    *("tune", "filter.window=3..8", "law.kv", "--suite", "drawing", "--seeds", "1", "--threads", "1"),
    *("--budget", "4000000", "--trials", "60", "--sampler"),
)
_PPO = ("tune", "ppo", "--trials", "4", "--steps", "1024", "--threads", "1", *_TRAINING)
_LONG = ("--steps", "8192", "--no-ms", "--set", "checkpoint.every=1024", "--set", "evaluation.every=2048", *_TRAINING)
_OTHER = tuple(word.replace("pid", "xi2023-tuned") for word in _BENCHMARK)
_TWO = ((*_BENCHMARK, "--no-ms", "--name", "a"), (*_OTHER, "--no-ms", "--name", "b"))


def _benchmarked(folder: Path) -> dict[str, Any]:
    return _tables(folder, *_RUNS, "traces.parquet")


COMMANDS: dict[str, Command] = {
    "benchmark": Command(_BENCHMARK, _benchmarked, spent=(".begun", "parts")),
    **{f"tune {sampler}": Command((*_SEARCH, sampler), _searched("tuned.toml")) for sampler in SAMPLERS},
    "tune ppo": Command(_PPO, _searched("ppo.toml")),
    "train": Command(("train", "ppo", *_LONG), _train),
    "reproduce": Command(("reproduce", "wu", "--seeds", "6", "--jobs", "2"), _reproduce),
    "report": Command(("report", "a", "b"), lambda folder: _tables(folder, *_RUNS), before=_TWO),
}
"""By the name that the campaign takes."""
