"""Jobs under teams of controllers: one task of a benchmark."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from ...envs.control.stack import Team
from ...envs.figures import job_metrics
from ...envs.figures.quality import iso_range, iso_taper
from ...envs.plant import gantry, machine
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from ...envs.tasks import workshop
from ..measure import rollout

LONGEST = 3.0
"""Times the nominal time, after which a job that is not done has failed."""

_STRIDE = 500
SHOWN = ("x", "y", "speed", "error", "phase", "gap_error", "margin", "roughness", "dross", "kerf_top")
"""Channels of the axes and the cut that a trace keeps; of the head it has the reported error, command and speed."""


def roll(
    scenario: Scenario,
    team: Team,
    seeds: Any,
    record: bool = False,
    threads: int = 1,
    change: Callable[[Fleet], None] | None = None,
) -> tuple[Fleet, Any, np.ndarray | None]:
    """The job of a scenario under a team, one machine per seed, until all are done or have taken too long.

    Args:
        scenario: with a job.
        team: that does it.
        seeds: of the scenario.
        record: keep every period.
        threads: worker threads; they change no figure.
        change: made to the machines before they begin.

    Returns:
        ``(fleet, job, channels)``: channels are float32 (periods, ``gantry.CHANNELS`` and behind them
        ``machine.CHANNELS``, seeds) if recorded.
    """
    fleet, job = workshop.fleet_for(scenario, team, seeds, threads, change), workshop.programme(scenario, team)
    assert fleet.gantries
    most = round(LONGEST * len(job.x)) + _STRIDE
    kept = [fleet.gantries.start_recording(most, fleet.tick), fleet.start_recording(most)] if record else []
    go, done = rollout.advancing(fleet, team.z, most), 0
    while done < most:
        steps = min(_STRIDE, most - done)
        go(steps)
        done += steps
        over = fleet.gantries.column("progress.near") >= len(job.x) - 1.5
        if (over | (fleet.column("tally.collided") > 0.5)).all():
            break
    fleet.gantries.stop_recording()
    fleet.stop_recording()
    return fleet, job, np.concatenate([part[:done] for part in kept], axis=1) if record else None


def measured(
    scenario: Scenario, team: Team, seeds: tuple[int, ...], shown: tuple[int, ...] = ()
) -> tuple[pd.DataFrame, dict[int, pd.DataFrame], int]:
    """A row of figures for each seed, :func:`traced` of the seeds ``shown``, and the control periods simulated."""
    fleet, job, _ = roll(scenario, team, seeds)
    jobs = job_metrics.Jobs.of(fleet, job)
    failed = job_metrics.failed(jobs) & ~scenario.exempt | job_metrics.broken(jobs)
    frame = pd.DataFrame({"failed": failed, **job_metrics.evaluate(jobs), **job_metrics.evidence(jobs)})
    steel = workshop.material_of(scenario)
    ranges = [iso_range(1e-3 * r, steel.thickness) if np.isfinite(r) else "–" for r in frame["roughness"]]
    frame["iso_roughness"] = ranges
    frame["iso_taper"] = [iso_taper(u, steel.thickness) if np.isfinite(u) else "–" for u in frame["taper"]]
    traces = {seed: traced(scenario, team, seed) for seed in shown}
    return frame, traces, int(fleet.tick) * len(seeds) + sum(map(len, traces.values()))


def traced(scenario: Scenario, team: Team, seed: int) -> pd.DataFrame:
    """Every period of one run."""
    _, _, channels = roll(scenario, team, [seed], record=True)
    assert channels is not None
    index = [gantry.CHANNELS.index(channel) for channel in SHOWN]
    frame = pd.DataFrame(channels[:, index, 0], columns=list(SHOWN))
    head = dict(zip(machine.CHANNELS, channels[:, len(gantry.CHANNELS) :, 0].T, strict=True))
    frame["reported_error"] = frame["gap_error"] + (head["height"] - head["gap"])
    frame["command"], frame["velocity"] = head["command"], head["velocity"]
    frame.insert(0, "time", (np.arange(len(frame)) + 1) * PERIOD)
    return frame
