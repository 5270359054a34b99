"""What logs of a machine of one's own are worth: the whole way from the command line, beside one who knows the machine.

A slow and late machine with a narrow nozzle and a noisy head is recorded, identified and tuned on. Somebody else tunes
on the machine itself, in the same way. Both are compared on that machine, and with the preset, which was tuned on the
standard one, on machines that the logs allow::

    python -m kerfgym.experiments.studies.own_machine --controller observer
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from ...envs import scenarios
from ...envs.control.stack import resolve
from ...envs.figures.metrics import rms_true
from ...envs.scenarios import machines
from ..measure import rollout
from ..store import script

TRUE = ("axis.bandwidth=25", "axis.dead_time=0.004", "head.bore=1.5", "head.noise=0.006")
"""What is said of it; the rest is drawn from the standard machine's distributions."""

PROTOCOLS = ("sweep", "rest", "motion", "follow")

SHEETS = ("mine.sheets.toml", "step")
"""Of tuning, and of what counts."""

SEEDS = range(1000, 1200)
"""Of the comparisons."""


def scored(machine: Path, controller: str, sheets: list[str]) -> tuple[np.ndarray, int]:
    """µm RMS, shape (sheets, seeds), and runs with a collision."""
    rows, touched = [], 0
    for sheet in sheets:
        scenario = machines.put_on(scenarios.load(sheet), machines.load(machine))
        recording = rollout.roll(scenario, resolve(controller), SEEDS)
        rows.append(rms_true(recording))
        touched += int(recording.collided.sum())
    return np.array(rows), touched


def main(controller: str = "observer", jitter: float = 1.0, seed: int = 0, folder: Path | None = None) -> int:
    """Tell what a controller tuned on an identified machine is worth beside one tuned on the machine itself.

    Args:
        controller: whose law and filter are tuned.
        jitter: mm/s per ms, largest of the command.
        seed: which machine.
        folder: where the files are left. Default: nowhere.
    """
    with tempfile.TemporaryDirectory() as passing:
        return _told((folder or Path(passing)).resolve(), controller, jitter, seed)


def _told(folder: Path, controller: str, jitter: float, seed: int) -> int:
    folder.mkdir(parents=True, exist_ok=True)

    def ran(*words: str) -> float:
        began = time.monotonic()
        command = [sys.executable, "-m", "kerfgym.experiments.cli", *words]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"kerfgym {' '.join(words)}: {done.stderr}")
        return time.monotonic() - began

    said = [word for each in TRUE for word in ("--set", each)]
    ran("machine", "new", "about.toml", "--overwrite", *said)
    ran("machine", "draw", "true.toml", "--like", "about.toml", "--seed", str(seed), "--overwrite")
    ran("machine", "new", "known.toml", "--set", TRUE[2], "--overwrite")  # a nozzle's bore can be measured
    for protocol in PROTOCOLS:
        ran("record", "--machine", "true.toml", "--protocol", protocol, "--seed", str(seed), "--overwrite")
    logs = [f"{protocol}.csv" for protocol in PROTOCOLS]
    chain = {"identify": ran("identify", *logs, "-o", "mine.toml", "--like", "known.toml", "--overwrite")}
    tune = ["tune", "law", "read", "-c", controller, "--jitter", f"{jitter:g}", "--overwrite"]
    tune += [word for sheet in SHEETS for word in ("-s", sheet)]
    chain["tune"] = ran(*tune, "--machine", "mine.toml", "--name", "mine")
    ran(*tune, "--machine", "true.toml", "--name", "true")
    compared = ["-c", "runs/mine/tuned.toml", "-c", controller, "-s", "mine.sheet.toml", "-s", "step", "--seeds", "20"]
    chain["benchmark"] = ran("benchmark", "--machine", "mine.toml", *compared, "--name", "compared", "--overwrite")
    seconds = ", ".join(f"{step} {s:.0f}" for step, s in chain.items())
    print(f"s: {seconds}; {sum(chain.values()):.0f} in all")
    sheets = [str(folder / sheet) if sheet.endswith(".toml") else sheet for sheet in SHEETS]
    mine, true = (str(folder / "runs" / name / "tuned.toml") for name in ("mine", "true"))
    # One who knows the machine, on it: what does knowing it by its logs alone cost?
    here, _ = scored(folder / "true.toml", mine, sheets)
    best, _ = scored(folder / "true.toml", true, sheets)
    cost = np.exp(np.mean(np.log(here.mean(axis=1)))) / np.exp(np.mean(np.log(best.mean(axis=1)))) - 1
    print(f"on the machine itself: tuned on mine {_shown(here)} µm, tuned on it {_shown(best)} µm; {cost:+.1%}")
    made, touched = scored(folder / "mine.toml", mine, sheets)
    usual, also = scored(folder / "mine.toml", controller, sheets)
    print(f"worst of {len(SEEDS)} machines that the logs allow, and collisions at last")
    for name, row, preset in zip(SHEETS, made, usual, strict=True):
        print(f"  {name}: tuned {row.max():.1f}, preset {preset.max():.1f} µm, {preset.max() / row.max():.2f} times")
    both = [np.sqrt(np.prod(rows, axis=0)).max() for rows in (made, usual)]
    print(f"  both: tuned {both[0]:.1f}, preset {both[1]:.1f} µm, {both[1] / both[0]:.2f} times; {touched} and {also}")
    return 0


def _shown(rows: np.ndarray) -> str:
    return " and ".join(f"{mean:.2f}" for mean in rows.mean(axis=1))


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.studies.own_machine")
