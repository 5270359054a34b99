"""Made-up results of benchmarks, of which everything is known, and the page of all of them."""

import types

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs.figures import job_metrics
from kerfgym.envs.plant import supervisor
from kerfgym.envs.plant.gantry import CUT, RAPID
from kerfgym.experiments.measure import population
from kerfgym.experiments.report.page import write_report
from kerfgym.experiments.results.conclusions import Results

CONTROLLERS = {
    "xi2023-tuned": ("sensor", 24.0, 1.9),
    "pid": ("sensor", 8.0, 1.95),
    "preview-5ms": ("preview", 2.0, 1.12),
}
"""Name: information class, score in µm, Ms."""

TUNED = {"trials": 400, "simulated_steps": 600_000_000, "cpu_seconds": 350.0, "tune_seeds": "0-39"}
SEEDS = range(1000, 1006)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of its own, in which the test works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def few_machines(monkeypatch):
    """A search ends with Ms and margins on fewer machines than it would for a user."""
    monkeypatch.setattr(population, "DRAWN", 3)


def following(
    controllers=CONTROLLERS,
    scenarios=("wavy", "rough", "holes"),
    core=("wavy", "rough"),
    seeds=SEEDS,
    seconds=0.7,
    exempt=(),
    drawing=False,
    traced=2,
):
    """Followers whose scores are exactly those of ``controllers``; in ``holes`` the pid touches in its first run.

    Everybody has good and bad luck of his own.
    """
    luck = _luck(len(controllers), len(seeds))
    difficulty = {name: 2.0 ** (i - 0.5) for i, name in enumerate(scenarios)}
    scored = [name for name in core if name in scenarios] or scenarios
    mean = np.exp(np.mean([np.log(difficulty[name]) for name in scored]))
    rows, traces, curves = [], [], []
    for number, (name, (information, score, ms)) in enumerate(controllers.items()):
        for scenario in scenarios:
            for i, seed in enumerate(seeds):
                rms = score * difficulty[scenario] / mean * luck[number, i]
                touched = (scenario, name, seed) == ("holes", "pid", seeds[0])
                row = {
                    "controller": name,
                    "information": information,
                    "scenario": scenario,
                    "seed": seed,
                    "failed": False,
                    "rms_true": rms,
                    "p99_true": 3 * rms,
                    "max_true": 5 * rms,
                    "rms_reported": (0.6 + 0.2 * number) * rms,
                    "collision": float(touched),
                    "jitter": 0.2 * number + 0.1,
                    "dross": 0.05 + 1e-4 * rms,
                    "roughness": 20 + 0.05 * rms,
                }
                rows.append(row)
            for seed in list(seeds)[:traced]:
                traces.append(_followed(name, number, scenario, seed, seconds, 1e-3 * score, drawing))
        frequency = np.geomspace(1, 200, 40)
        curve = frequency**2 / np.abs(frequency**2 - 900 + 30j * frequency)
        curves.append(pd.DataFrame({"controller": name, "frequency": frequency, "magnitude": curve * ms / curve.max()}))
    names = list(controllers)
    meta = {
        "command": "kerfgym benchmark --seeds 6",
        "seeds": f"{seeds[0]}-{seeds[-1]}",
        "seed_count": len(seeds),
        "tuning": {name: TUNED for name in names},
        "parameters": {name: {"law.kp": 50.0} for name in names},
        "decisions": {names[0]: {"median_us": 0.25, "p99_us": 1.5, "ratio": 0.0015}},
    }
    return Results(
        pd.DataFrame(rows),
        pd.concat(traces, ignore_index=True) if traces else pd.DataFrame(),
        pd.concat(curves, ignore_index=True),
        meta,
        tuple(core),
        tuple(exempt),
        {name: f"what happens in {name}, ±3 mm/m" for name in scenarios},
        pd.DataFrame({"controller": names, "gain": np.linspace(2.0, 4.0, len(names)), "delay_ms": 5.0}),
    )


def _luck(controllers, seeds):
    """Factors of 5 % more or less, whose mean square over the seeds is 1."""
    luck = np.exp(0.05 * np.random.default_rng(1).standard_normal((controllers, seeds)))
    return luck / np.sqrt(np.mean(luck**2, axis=1, keepdims=True))


def _followed(name, number, scenario, seed, seconds, size, drawing):
    """A trace: a sine of 20 Hz on the gap; in ``tip-up`` an alarm after 80 % of the time."""
    time = np.arange(1, round(seconds * 1000) + 1) * 1e-3
    error = size * np.sin(2 * np.pi * 20 * time + 0.2 * number + seed)
    mode = np.full(len(time), float(supervisor.FOLLOW))
    if scenario == "tip-up":
        mode[time > 0.8 * seconds], error[time > 0.8 * seconds] = supervisor.ALARM, 5.0
    frame = pd.DataFrame(
        {
            "controller": name,
            "scenario": scenario,
            "seed": seed,
            "time": time,
            "set_height": 0.8,
            "gap": 0.8 + error,
            "height": 0.8 + 0.7 * error,
            "surface": 0.5 * np.sin(4 * time),
            "command": 6 * np.cos(40 * time),
            "velocity": 5 * np.cos(40 * time),
            "mode": mode,
            "scored": (time > 0.1).astype(float),
            "distance": 200 * time,
        }
    )
    if drawing:
        turn = 2 * np.pi * time / seconds
        frame["x"], frame["y"] = 60 + 60 * np.cos(turn), 40 + 40 * np.sin(turn)
    return frame


def cutting(controllers=(("fast", 170.0), ("fine", 50.0)), scenarios=("cut-square",), seeds=SEEDS):
    """Teams with exactly these roughnesses, the first the reference; each metric else is 1 for the first, 2 for the
    second … The trace cuts a circle after a rapid of 20 ms; at its right the cut does not go through."""
    luck = _luck(len(controllers), len(seeds))
    rows, traces = [], []
    for number, (name, roughness) in enumerate(controllers, 1):
        for scenario in scenarios:
            for i, seed in enumerate(seeds):
                figures = {metric: number * luck[number - 1, i] for metric in job_metrics.METRICS}
                row = {
                    "controller": name,
                    "information": "sensor",
                    "scenario": scenario,
                    "seed": seed,
                    "failed": False,
                    **figures,
                    "roughness": roughness * luck[number - 1, i],
                    "collision": 0.0,
                    "iso_roughness": "3",
                    "iso_taper": "1",
                }
                rows.append(row)
            ms = np.arange(1200)
            turn = 2 * np.pi * np.clip(ms - 20, 0, None) / 1180
            trace = {
                "controller": name,
                "scenario": scenario,
                "seed": seeds[0],
                "time": (ms + 1) * 1e-3,
                "x": 30 * np.cos(turn),
                "y": 30 * np.sin(turn),
                "speed": 80.0,
                "error": 0.01 * number * np.sin(turn),
                "phase": np.where(ms < 20, RAPID, CUT),
                "gap_error": 0.02 * number * np.sin(3 * turn),
                "margin": np.where(np.cos(turn) > 0.9, 0.9, 1.2),
                "roughness": 1e-3 * roughness,
                "dross": 0.9,
                "kerf_top": 0.3,
                "reported_error": 0.01 * number * np.sin(3 * turn),
                "command": 1.0,
                "velocity": 0.5,
            }
            traces.append(pd.DataFrame(trace))
    names = [name for name, _ in controllers]
    meta = {"command": "kerfgym benchmark", "seed_count": len(seeds), "tuning": {n: {"z": TUNED} for n in names}}
    return Results(
        pd.DataFrame(rows),
        pd.concat(traces, ignore_index=True),
        pd.DataFrame(),
        meta,
        tuple(scenarios),
        summaries={name: f"a cut, {name}" for name in scenarios},
        metric="roughness",
        reference=names[0],
        jobs=True,
        labels=("c45-10: calibrated; not validated",),
        materials=(("c45-10", 10.0),),
    )


RECORD = {
    "command": "kerfgym benchmark --seeds 6",
    "kerfgym": "0.1.0",
    "git": {"commit": "0123abc", "changed": False},
    "python": "3.11",
    "packages": {"numpy": "2.0"},
    "machine": {"system": "Linux", "cores": 2},
}


@pytest.fixture(scope="session")
def made_up():
    """Functions that make results up: ``following``, ``cutting``; ``record`` of a run."""
    return types.SimpleNamespace(following=following, cutting=cutting, record=RECORD, controllers=CONTROLLERS)


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory):
    """A run with everything that a page can show: its folder, and its results by suite."""
    folder = tmp_path_factory.mktemp("run")
    follow = following()
    stages = ["sensor", "dead time", "law"]
    follow.blame = pd.DataFrame(
        {
            "scenario": "rough",
            "controller": "pid",
            "stage": stages,
            "share": [10.0, 50.0, 4.0],
            "low": [8.0, 45.0, 3.0],
            "high": [12.0, 55.0, 5.0],
            "unit": "µm²",
            "alone": [9.0, 40.0, np.nan],
            "alone_low": 1.0,
            "alone_high": 60.0,
        }
    )
    follow.headroom = pd.DataFrame(
        {
            "scenario": ["rough"],
            "controller": ["pid"],
            "informed": ["preview-5ms"],
            "rms": [8.0],
            "informed_rms": [2.0],
            "ratio": [4.0],
            "low": [3.5],
            "high": [4.5],
        }
    )
    beyond = following(
        {"xi2023-tuned": ("sensor", 48.0, 1.9), "pid": ("sensor", 40.0, 1.9)},
        ("fast-rough", "low-rough"),
        ("fast-rough", "low-rough"),
        traced=0,
    )
    grids = {"following": follow, "cutting": cutting(), "ood": beyond}
    return types.SimpleNamespace(folder=folder, grids=grids, path=write_report(folder, grids, RECORD))
