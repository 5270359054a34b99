"""Tuning of the adjusting unit: ``python -m kerfgym.experiments.tune_process [NAME …]``.

* ``huang2024-adjusting`` keeps the planned settings of ``huang2024-dynamic``; the rules' numbers are those with the
  smallest geometric mean of contour error (RMS and largest), standoff error, roughness, dross and energy, relative to
  ``huang2024-dynamic``. Jobs may take at most 2 % longer: slower is smoother, but that is no achievement.
* ``huang2024-tuned`` is the fastest that cuts no worse: planned settings and rules with the shortest cutting time at
  which neither dross nor roughness is worse than ``huang2024-dynamic``'s in any scenario. Its settings stay within the
  reach of the residual action of ``Cutting-v0`` around the published ones, and it gets no more power: the cut's model
  is calibrated on three cuts, and the further from them the less it means.

Both on tune seeds of the cutting suite's core.
"""

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import tomli_w

from ..baselines import PRESETS
from ..envs import job_metrics, scenarios
from ..envs import stack as stacks
from ..envs.job_interface import RESIDUAL
from ..envs.stack import Stack
from . import jobs, runs
from .ledger import Ledger

PLAIN = "huang2024-dynamic"
SEEDS = range(0, 8)
LONGER = 1.02
"""Time that a job of ``huang2024-adjusting`` may take, relative to the plain method's."""

SPARE = 0.99
"""What quality of ``huang2024-tuned`` may be on tune seeds over the plain method's, so as to be no worse on others."""

CRITERIA = ("contour_rms", "contour_max", "gap_rms", "roughness", "dross", "energy")
KEPT = ("roughness", "dross")
MEASURED = (*CRITERIA, "time", "cutting_time", "through")

Figures = dict[str, dict[str, float]]
"""Scenario, then metric, to the mean over seeds."""


def figures(stack: Stack, ledger: Ledger) -> Figures:
    """What a stack does in each scenario of the core; what it costs goes into the ledger."""
    found: Figures = {}
    for name in scenarios.core("cutting"):
        fleet, job, _ = jobs.roll(scenarios.load(name), stacks.team(stack), list(SEEDS))
        ledger.add(int(fleet.tick) * len(SEEDS), 0.0)
        seen = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
        found[name] = {key: float(seen[key].mean()) for key in MEASURED}
    return found


def ratios(seen: Figures, plain: Figures) -> dict[str, list[float]]:
    """Each metric over the plain method's, scenario by scenario."""
    return {key: [seen[name][key] / plain[name][key] for name in plain] for key in MEASURED}


def mean(values: list[float]) -> float:
    """The geometric one."""
    return float(np.exp(np.mean(np.log(values))))


def balanced(r: dict[str, list[float]]) -> float:
    """Mean of the criteria's logarithms, with a penalty for longer jobs and cuts that fail to go through."""
    gained = float(np.mean([math.log(mean(r[key])) for key in CRITERIA]))
    return gained + 50.0 * max(0.0, math.log(mean(r["time"]) / LONGER)) + 50.0 * max(0.0, 1.0 - mean(r["through"]))


def fastest(r: dict[str, list[float]]) -> float:
    """Logarithm of the cutting time, with a penalty for worse quality in any scenario."""
    worse = sum(max(0.0, math.log(x / SPARE)) for key in KEPT for x in r[key])
    return math.log(mean(r["cutting_time"])) + 10.0 * worse + 50.0 * max(0.0, 1.0 - min(r["through"]))


@dataclass(frozen=True)
class Search:
    """One preset: what is searched (parameter of the law, with its range if it is not the declared one), and for what.

    ``tied`` parameters have the value of another.
    """

    space: dict[str, tuple[float, float] | None]
    cost: Callable[[dict[str, list[float]]], float]
    criterion: str
    trials: int
    tied: dict[str, str] | None = None

    def changes(self, values: dict[str, float]) -> dict[str, float]:
        """The law's parameters."""
        every = {**values, **{name: values[other] for name, other in (self.tied or {}).items()}}
        return {f"law.{name}": float(f"{value:.4g}") for name, value in every.items()}


SEARCHES = {
    # Focus and standoff keep their defaults: the errors of a good height follower are too small to show in any of the
    # criteria but its own.
    "huang2024-adjusting": Search(
        dict.fromkeys(
            ("tolerance", "slow", "corner", "least", "recover", "match", "least_power", "overlap", "amplitude")
        ),
        balanced, f"geometric mean of {', '.join(CRITERIA)}, time at most × {LONGER:g}", 240,
    ),
    "huang2024-tuned": Search(
        {
            "override": (1.0 - RESIDUAL.override, 1.0 + RESIDUAL.override), "x": (0.3 - RESIDUAL.x, 0.3),
            "narrow": (0.0, RESIDUAL.y / 0.3), "z": (0.0, 1.0 + RESIDUAL.z),
            "frequency": (2000.0 - 0.5 * RESIDUAL.frequency, 2000.0 + RESIDUAL.frequency),
            "focus": (-RESIDUAL.focus, RESIDUAL.focus), "diagonal": (0.0, 0.5), "corner": (0.0, 1.0),
            "recover": None, "match": None,
        },
        fastest, f"cutting time, {' and '.join(KEPT)} at most × {SPARE:g} in each scenario", 400, {"y": "x"},
    ),
}  # fmt: skip
"""By name of the preset."""


def search(name: str) -> None:
    """Tunes, prints and writes a preset."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    task, base, started = SEARCHES[name], stacks.get("huang2024-adjusting"), time.process_time()
    base = base.varied({f"law.{key}": value for key, value in base.law.Params._field_defaults.items()})
    ledger = Ledger()
    plain = figures(stacks.get(PLAIN), ledger)
    known = base.parameters()

    def objective(trial: "optuna.Trial") -> float:
        values = {}
        for key, limits in task.space.items():
            q = known[f"law.{key}"].quantity
            values[key] = trial.suggest_float(key, *(limits or (q.low, q.high)), log=q.log)
        r = ratios(figures(base.varied(task.changes(values)), ledger), plain)
        return task.cost(r) if np.isfinite(list(r.values())).all() else 10.0

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0, multivariate=True, n_startup_trials=30))
    study.enqueue_trial({key: known[f"law.{key}"].value for key in task.space})
    study.optimize(objective, n_trials=task.trials // 2)
    study.sampler = optuna.samplers.CmaEsSampler(x0=study.best_params, sigma0=0.1, seed=0)
    study.optimize(objective, n_trials=task.trials - task.trials // 2)

    parameters = task.changes(study.best_params)
    r = ratios(figures(base.varied(parameters), ledger), plain)
    record = runs.record(["python", "-m", "kerfgym.experiments.tune_process", name])
    provenance = {
        "suite": f"cutting-{scenarios.rules('cutting')['version']}", "criterion": task.criterion,
        "relative": {key: round(mean(values), 4) for key, values in r.items()}, "trials": task.trials,
        "simulated_steps": ledger.steps, "sampler": f"TPE {task.trials // 2}, then CMA-ES", "sampler_seed": 0,
        "tune_seeds": f"{SEEDS[0]}-{SEEDS[-1]}",
        "cpu_seconds": round(time.process_time() - started, 1), "kerfgym": record["kerfgym"],
        "git": record["git"]["commit"],
    }  # fmt: skip
    head = f"# Found by: python -m kerfgym.experiments.tune_process {name}\n"
    with runs.atomic(PRESETS / f"{name}.toml") as part:
        part.write_text(head + tomli_w.dumps({"parameters": parameters, "provenance": provenance}), encoding="utf-8")
    print(f"{name}: {parameters}, relative to {PLAIN}: {provenance['relative']}")


def main() -> None:
    """Makes the presets named on the command line (all of them if none is)."""
    for name in sys.argv[1:] or list(SEARCHES):
        if name not in SEARCHES:
            raise SystemExit(f"unknown preset '{name}'; known: {', '.join(SEARCHES)}")
        search(name)


if __name__ == "__main__":
    main()
