"""Tuning of the adjusting unit: ``python -m kerfgym.experiments.tune_process``.

``huang2024-adjusting`` keeps the planned settings of ``huang2024-dynamic``; the rules' numbers are those with the
smallest geometric mean of contour error (RMS and largest), standoff error, roughness, dross and energy, relative to
``huang2024-dynamic``, on tune seeds of the cutting suite. Jobs may take at most 2 % longer: slower is smoother, but
that is no achievement.
"""

import math
import time

import numpy as np
import tomli_w

from ..baselines import PRESETS
from ..envs import job_metrics, scenarios
from ..envs import stack as stacks
from ..envs.stack import Stack
from . import jobs, runs

NAME, PLAIN = "huang2024-adjusting", "huang2024-dynamic"
SEEDS = range(0, 8)
TRIALS = 240
LONGER = 1.02
"""Time that a job may take, relative to the plain method's."""

CRITERIA = ("contour_rms", "contour_max", "gap_rms", "roughness", "dross", "energy")
SPACE = ("tolerance", "slow", "corner", "least", "recover", "match", "least_power", "overlap", "amplitude")
"""What is searched. Focus and standoff keep their defaults: the errors of a good height follower are too small to show
in any of the criteria but its own."""


def figures(stack: Stack) -> dict[str, float]:
    """Geometric means over the cutting suite's core of the seeds' mean of every criterion, time and share through."""
    found: dict[str, list[float]] = {name: [] for name in (*CRITERIA, "time", "through")}
    for name in scenarios.core("cutting"):
        fleet, job, _ = jobs.roll(scenarios.load(name), stacks.team(stack), list(SEEDS))
        seen = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
        for key, values in found.items():
            values.append(float(seen[key].mean()))
    return {key: float(np.exp(np.mean(np.log(values)))) for key, values in found.items()}


def cost(seen: dict[str, float], plain: dict[str, float]) -> float:
    """Mean of the criteria's logarithms relative to the plain method, with a penalty for longer jobs and cuts that fail
    to go through."""
    if not all(math.isfinite(value) for value in seen.values()):
        return 10.0
    gained = float(np.mean([math.log(seen[key] / plain[key]) for key in CRITERIA]))
    longer = max(0.0, math.log(seen["time"] / plain["time"]) - math.log(LONGER))
    return gained + 50.0 * longer + 50.0 * max(0.0, plain["through"] - seen["through"])


def main() -> None:
    """Tunes, prints and writes the preset."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    started, base, plain = time.process_time(), stacks.get(NAME), figures(stacks.get(PLAIN))
    known = base.parameters()

    def objective(trial: "optuna.Trial") -> float:
        changes = {
            f"law.{key}": trial.suggest_float(key, q.low, q.high, log=q.log)
            for key in SPACE
            for q in (known[f"law.{key}"].quantity,)
        }
        return cost(figures(base.varied(changes)), plain)

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0, multivariate=True, n_startup_trials=30))
    study.enqueue_trial({key: known[f"law.{key}"].value for key in SPACE})
    study.optimize(objective, n_trials=TRIALS // 2)
    study.sampler = optuna.samplers.CmaEsSampler(x0=study.best_params, sigma0=0.1, seed=0)
    study.optimize(objective, n_trials=TRIALS - TRIALS // 2)

    parameters = {f"law.{key}": float(f"{value:.4g}") for key, value in study.best_params.items()}
    seen = figures(base.varied(parameters))
    record = runs.record(["python", "-m", "kerfgym.experiments.tune_process"])
    provenance = {
        "suite": "cutting-1", "criterion": f"geometric mean of {', '.join(CRITERIA)}, time at most × {LONGER:g}",
        "relative": {key: round(seen[key] / plain[key], 4) for key in seen}, "trials": TRIALS,
        "sampler": f"TPE {TRIALS // 2}, then CMA-ES", "sampler_seed": 0, "tune_seeds": f"{SEEDS[0]}-{SEEDS[-1]}",
        "cpu_seconds": round(time.process_time() - started, 1), "kerfgym": record["kerfgym"],
        "git": record["git"]["commit"],
    }  # fmt: skip
    head = "# Found by: python -m kerfgym.experiments.tune_process\n"
    with runs.atomic(PRESETS / f"{NAME}.toml") as part:
        part.write_text(head + tomli_w.dumps({"parameters": parameters, "provenance": provenance}), encoding="utf-8")
    print(f"{NAME}: {parameters}, relative to {PLAIN}: {provenance['relative']}")


if __name__ == "__main__":
    main()
