"""The shipped policies: trained from the presets as they stand, into ``agents/trained/<name>/``::

    make train        # or: python -m kerfgym.experiments.ship [NAME …]

An interrupted training goes on where its last checkpoint stands.
"""

import shutil
import sys
from pathlib import Path
from typing import Any

from ..agents import settings as presets
from . import runs
from .training import into, open_run

TRAINED = Path(__file__).parents[1] / "agents" / "trained"

SHIPPED: dict[str, tuple[str, str, int, dict[str, Any]]] = {
    "height-following-ppo": (
        "ppo", "kerfgym/HeightFollowing-v0", 0, {},
    ),
}  # fmt: skip
"""Algorithm, environment and seed of each, and what differs from the preset."""

LARGEST = 1_000_000
"""Bytes of a shipped policy."""


def ship(name: str, folder: Path = TRAINED) -> Path:
    """Trains a policy and puts artefact and record where they are shipped from."""
    algorithm, env, seed, changes = SHIPPED[name]
    run, resume = Path("runs") / f"shipped-{name}", False
    if not (run / "run.json").is_file():
        resume = run.exists()
        given = presets.preset(algorithm, env, changes)
        words = ["kerfgym", "train", algorithm, "--env", env, "--seed", str(seed)]
        words += [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
        into(open_run(run, given, resume=resume), given, seed, "cpu", 1, True, resume, words)
    files = [*(run / "policy").iterdir(), run / "run.json"]
    size = sum(file.stat().st_size for file in files)
    if size > LARGEST:
        raise RuntimeError(f"{name} takes {size} bytes; at most {LARGEST}")
    for file in files:
        with runs.atomic(folder / name / file.name) as part:
            shutil.copyfile(file, part)
    return folder / name


def main() -> None:
    """Ships the policies named on the command line (all of them if none is)."""
    for name in sys.argv[1:] or list(SHIPPED):
        if name not in SHIPPED:
            raise SystemExit(f"unknown policy '{name}'; known: {', '.join(SHIPPED)}")
        print(ship(name))


if __name__ == "__main__":
    main()
