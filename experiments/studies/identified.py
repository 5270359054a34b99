"""Study of identification: do its intervals hold the truth, and how near is it?

Machines are drawn from wide ranges, recorded by three protocols, and identified by one who does not know them::

    python -m kerfgym.experiments.manual identified
    python -m kerfgym.experiments.studies.identified --machines 20 --first 1000
"""

import time
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from scipy import stats

from ...envs.control.stack import get
from ...envs.plant.controller import PERIOD
from ...envs.scenarios import Scenario, machines
from ..identify import drive, mounting
from ..identify.identifying import Identified, identify
from ..identify.protocols import record
from ..measure import rollout
from ..store import script
from ..store.runs import atomic
from .registry import Trial, study

MACHINES, FIRST = 200, 400
"""Of the study, and the seed of the first: nobody had looked at these when the method was made."""

WIDE = {
    "name": "wide",
    "head": {
        "noise": {"log_uniform": [5e-4, 5e-3]},
        "face": {"uniform": [8.0, 12.0]},
        "body": {"uniform": [8.0, 14.0]},
        "inductance": {"uniform": [140.0, 200.0]},
    },
    "axis": {
        "bandwidth": {"uniform": [25, 150]},
        "zeta": {"uniform": [0.5, 1.1]},
        "dead_time": {"uniform": [0.0005, 0.012]},
        "acceleration": {"uniform": [6000, 20000]},
        "jerk": {"log_uniform": [1e6, 5e6]},
        "speed": {"uniform": [250, 500]},
        "friction": {"uniform": [400, 1500]},
        "backlash": {"uniform": [0.002, 0.03]},
        "compliance": {"uniform": [0.05, 0.2]},
    },
}
"""What the machines are drawn from."""


def truth(machine: Any, seed: int) -> dict[str, float]:
    """What a drawn machine is, by the keys of what is identified."""
    flat = Scenario(name="truth", duration=1.0, settle=0.0, feed=0.0, set_height=1.0)
    fleet = rollout.fleet_for(machines.put_on(flat, machine), get("idle"), [seed])
    z, s = fleet.get("z"), fleet.get("sensor")
    known = {name: float(getattr(z, name)) for name in (*drive.NAMES, *mounting.PRIOR) if hasattr(z, name)}
    known |= {"bandwidth": z.omega / (2 * np.pi), "resonance": z.omega_r / (2 * np.pi), "resonance_zeta": z.zeta_r}
    known |= {"dead_time": z.dead_time * PERIOD, "noise": s.noise}
    return known | {"face": 2 * s.radius, "body": s.body, "inductance": s.inductance}


def identified(machine: Any, seed: int) -> Identified:
    """What three logs say of it."""
    return identify([record(machine, protocol, seed) for protocol in ("sweep", "rest", "motion")], seed=seed)


def compared(seed: int) -> pd.DataFrame:
    """One row for each number of a machine.

    Columns: ``machine, number, true, low, median, high, excited, seconds``; in the units of a machine's file.
    """
    machine = machines.load(WIDE)
    known, began = truth(machine, seed), time.process_time()
    found, rows = identified(machine, seed), []
    seconds = time.process_time() - began
    for each in found.numbers:
        low, middle, high = each.interval
        key = each.key.split(".")[1]
        if key in known:
            rows.append((seed, key, known[key], low, middle, high, each.found, seconds))
    return pd.DataFrame(rows, columns=["machine", "number", "true", "low", "median", "high", "excited", "seconds"])


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """By number: machines, share of them whose interval holds the truth with its 95 % interval (Clopper and Pearson
    1934), median and 95th percentile of the error, relative and as it is, and how many logs told something of it."""
    rows = []
    for number, of in table.groupby("number", sort=False):
        held, n = int(((of["low"] <= of["true"]) & (of["true"] <= of["high"])).sum()), len(of)
        sure = stats.binomtest(held, n).proportion_ci(method="exact")
        told = of[of["excited"]]
        off = (told["median"] - told["true"]).abs()
        rows.append({
            "number": number, "machines": n, "held": held / n, "held_low": sure.low, "held_high": sure.high,
            "excited": len(told), "median_error": off.median(), "median_relative": (off / told["true"]).median(),
            "p95_error": off.quantile(0.95), "p95_relative": (off / told["true"]).quantile(0.95),
        })  # fmt: skip
    return pd.DataFrame(rows).set_index("number")


def measured(seeds: Iterable[int], workers: int, folder: Any = None) -> pd.DataFrame:
    """The rows of machines, each of which is kept in ``folder`` as soon as it is done, and taken from there."""

    def kept(seed: int) -> pd.DataFrame:
        file = None if folder is None else folder / f"{seed}.csv"
        if file is not None and file.is_file():
            return pd.read_csv(file)
        table = compared(seed)
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            with atomic(file) as part:
                table.to_csv(part, index=False)
        return table

    return pd.concat(Parallel(n_jobs=workers)(delayed(kept)(seed) for seed in seeds), ignore_index=True)


@study(
    "identified",
    "whether intervals of identified machines hold the truth",
    "python -m kerfgym.experiments.manual identified",
    60.0,
    ("envs/machines/*.toml",),
)
def of_machines(trial: Trial) -> dict[str, Any]:
    """By number what :func:`summary` has."""
    table = measured(range(FIRST, FIRST + MACHINES), trial.workers, trial.folder)
    each = table.groupby("machine")["seconds"].first()  # of CPU; what was kept from a run before took its time then
    seconds, wall = float(each.median()), float(each.sum()) / trial.workers
    seeds = f"{FIRST}-{FIRST + MACHINES - 1}"
    return {
        "numbers": summary(table).to_dict("index"),
        "machines": MACHINES,
        "seconds": seconds,
        "seeds": seeds,
        "wall_seconds": wall,
    }


def main(machines: int = 20, first: int = 0, jobs: int = 2) -> int:
    """Tell how often intervals of identified machines hold the truth.

    Args:
        machines: how many.
        first: seed of the first of them.
        jobs: processes.
    """
    table = measured(range(first, first + machines), jobs)
    missed = table[(table["low"] > table["true"]) | (table["true"] > table["high"])]
    print(missed.to_string(index=False))
    print(summary(table).to_string(float_format="{:.4g}".format))
    print(f"{table.groupby('machine')['seconds'].first().median():.1f} CPU-s a machine")
    return 0


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.studies.identified")
