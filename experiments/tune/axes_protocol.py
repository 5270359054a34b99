"""Tuning of the position loops: ``python -m kerfgym.experiments.tune.axes_protocol``.

``wu-tuned`` has the largest gain whose step overshoots by at most 1 % (Wu: no overshoot), found by bisection on the
nominal axes in simulation. ``wu-feedforward`` keeps that gain; its feed-forward of the velocity is the inverse of the
drive's gain, that of the acceleration the one with the smallest contour error on the tune seeds of the contour suite.
``wu-stiff`` may overshoot a step, which no planned path holds: it has half the gain at which the loop becomes unstable
(linear; a step of 1 mm, where limits act, rings on at a lower gain), and both feed-forwards are those with the smallest
contour error.
"""

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import tomli_w
from scipy.optimize import minimize, minimize_scalar

from ...baselines import PRESETS
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.figures import job_metrics
from ...envs.plant import heads, xy_axes
from ...envs.plant.fleet import Fleet
from ...envs.tasks import workshop
from ..store import runs

OVERSHOOT = 0.01
STEP = 1.0
"""mm."""

MARGIN = 2.0
"""Factor on the gain of ``wu-stiff`` at which its loop becomes unstable."""

SEEDS = range(0, 4)


def step_response(kp: float, axes: xy_axes.Params, periods: int = 1500) -> np.ndarray:
    """Position of one axis, mm, every control period after a step of 1 mm."""
    stack = stacks.get("wu").varied({"law.kp": kp})
    fleet = Fleet(1, stacks.get("idle").law, heads.POOL)
    gantries = fleet.use_gantries(stack.law, stacks.get("recipe").law)
    to = np.where(np.arange(periods + 20) < 8, 0.0, STEP)
    none = np.zeros_like(to)
    gantries.put_job(SimpleNamespace(
        x=to, y=none, s=to, cut_s=none, feed=none, tx=none + 1.0, ty=none, beam=none, phase=none, lift=none,
        most=none + 1.0, cut_feed=1.0, patience=0.0,
    ), [0])  # fmt: skip
    gantries.put_law("xy", [0], stack.part("law"))
    scenarios.prepare(fleet, scenarios.Scenario(name="step"), [0], [0])
    gantries.put_axes([0], axes)
    fleet.begin([0], [0])
    seen = np.empty(periods)
    for i in range(periods):
        fleet.advance()
        seen[i] = gantries.column("x.position")[0]
    return seen


def largest_gain(axes: xy_axes.Params) -> float:
    """Largest Kp whose step overshoots by at most :data:`OVERSHOOT`."""
    low, high = 0.02, 2.0
    for _ in range(24):
        middle = 0.5 * (low + high)
        fine = step_response(middle, axes).max() <= STEP * (1.0 + OVERSHOOT)
        low, high = (middle, high) if fine else (low, middle)
    return low


def contour_error(stack: Stack) -> float:
    """Geometric mean over the suite's core of the RMS contour error on the tune seeds, µm."""
    team = stacks.team(stack)
    errors = []
    for name in scenarios.core("contour"):
        scenario = scenarios.load(name)
        fleet = workshop.fleet_for(scenario, team, np.array(SEEDS))
        job = workshop.programme(scenario, team)
        fleet.advance(len(job.x) + 500)
        figures = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
        errors.append(np.sqrt(np.mean(figures["contour_rms"] ** 2)))
    return float(np.exp(np.mean(np.log(errors))))


def write(name: str, parameters: dict[str, float], provenance: dict[str, Any]) -> None:
    """Writes a preset with its record."""
    head = "# Found by: python -m kerfgym.experiments.tune.axes_protocol\n"
    with runs.atomic(PRESETS / f"{name}.toml") as part:
        part.write_text(head + tomli_w.dumps({"parameters": parameters, "provenance": provenance}), encoding="utf-8")


def stiff(axes: xy_axes.Params) -> tuple[dict[str, float], list[float]]:
    """Parameters of ``wu-stiff``, and the contour error of every trial, µm."""
    law, tried = stacks.get("wu").part("law"), list[float]()
    kp = float(np.floor(1e4 * xy_axes.largest_gain(axes) / (MARGIN * law.kn * axes.gain)) / 1e4)

    def parameters(x: np.ndarray) -> dict[str, float]:
        return {"law.kp": kp, "law.velocity": round(float(x[0]), 5), "law.acceleration": round(1e3 * float(x[1]), 3)}

    def cost(x: np.ndarray) -> float:
        tried.append(contour_error(stacks.get("wu").varied(parameters(x))))
        return tried[-1]

    first = [0.5 / axes.gain, axes.t1 / axes.gain]
    found = minimize(
        cost, first, method="Nelder-Mead", bounds=[(0.0, 1.5), (0.0, 0.06)],
        options={"maxfev": 60, "xatol": 1e-4, "fatol": 1e-3},
    )  # fmt: skip
    return parameters(found.x), tried


def main() -> None:
    """Tunes, prints and writes all three presets."""
    started, axes = time.process_time(), xy_axes.Params()
    kp = float(np.floor(1e4 * largest_gain(axes)) / 1e4)
    record = runs.record(["python", "-m", "kerfgym.experiments.tune.axes_protocol"])
    common = {"kerfgym": record["kerfgym"], "git": record["git"]["commit"]}
    overshoot = float(step_response(kp, axes).max() / STEP - 1.0)
    write(
        "wu-tuned",
        {"law.kp": kp},
        {**common, "criterion": "overshoot of a step at most 1 %", "trials": 0, "overshoot": round(overshoot, 5)},
    )
    base = stacks.get("wu").varied({"law.kp": kp, "law.velocity": round(1.0 / axes.gain, 5)})
    tried: list[tuple[float, float]] = []

    def cost(milliseconds: float) -> float:
        error = contour_error(base.varied({"law.acceleration": milliseconds}))
        tried.append((milliseconds, error))
        return error

    found = minimize_scalar(cost, bounds=(0.0, 60.0), method="bounded", options={"maxiter": 20})
    parameters = {"law.kp": kp, "law.velocity": round(1.0 / axes.gain, 5), "law.acceleration": round(float(found.x), 3)}
    write("wu-feedforward", parameters, {
        **common, "suite": "contour-1", "score_tune_um": round(float(found.fun), 3), "trials": len(tried),
        "tune_seeds": f"{SEEDS[0]}-{SEEDS[-1]}", "cpu_seconds": round(time.process_time() - started, 1),
    })  # fmt: skip
    begun = time.process_time()
    firm, trials = stiff(axes)
    write("wu-stiff", firm, {
        **common, "criterion": f"gain margin {MARGIN:g}", "suite": "contour-1", "score_tune_um": round(min(trials), 3),
        "trials": len(trials), "tune_seeds": f"{SEEDS[0]}-{SEEDS[-1]}",
        "cpu_seconds": round(time.process_time() - begun, 1),
    })  # fmt: skip
    plain = contour_error(stacks.get("wu").varied({"law.kp": kp}))
    print(f"wu-tuned: Kp {kp}, overshoot {overshoot:.2%}, contour error {plain:.2f} µm")
    print(f"wu-feedforward: {parameters}, contour error {found.fun:.2f} µm after {len(tried)} trials")
    print(f"wu-stiff: {firm}, contour error {min(trials):.2f} µm after {len(trials)} trials")


if __name__ == "__main__":
    main()
