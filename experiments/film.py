"""Films of one episode."""

from pathlib import Path

import numpy as np

from ..envs import scenarios, workshop
from ..envs import stack as stacks
from ..envs.film import Film
from ..envs.kerf_film import KerfFilm
from ..envs.kerf_picture import QUANTITIES
from ..envs.plant.quantity import InvalidInput, did_you_mean
from ..envs.scenarios import Scenario
from . import rollout
from .jobs import LONGEST
from .runs import atomic

FRAMES_PER_SECOND = 25

SAMPLE = 4
"""ms between the points of a kerf's picture."""


def film(
    out: Path,
    controller: str,
    scenario: str,
    seed: int,
    seconds: float | None = None,
    slow: float | None = None,
    path: Path | None = None,
    colour: str = "standoff",
) -> None:
    """Writes an episode as MP4 or GIF, or its last frame as PNG; of a job the part with its kerf.

    Raises:
        InvalidInput: unknown suffix, controller, scenario or seed, or a time that is not above 0.
    """
    if out.suffix not in (".mp4", ".gif", ".png"):
        raise InvalidInput(f"cannot write '{out}'; allowed: .mp4, .gif, .png")
    if seed < 0:
        raise InvalidInput(f"--seed {seed} is out of range; 0 and up")
    if (slow is not None and slow <= 0) or (seconds is not None and seconds <= 0):
        raise InvalidInput("--slow and --seconds must be above 0")
    case = scenarios.load(scenario)
    if path is not None:
        case = case.varied(job={"part": str(path), "size": 0.0}) if case.job else case.along(path)
    if case.job:
        _film_job(out, case, stacks.team(controller), seed, seconds, slow or 0.2, colour)
        return
    slow = slow or 10.0
    stack = stacks.resolve(controller)
    fleet = rollout.fleet_for(case, stack, [seed])
    reel = Film(case, stack.name, seed)
    every = max(1, round(1000 / slow / FRAMES_PER_SECOND))
    steps = case.steps if seconds is None else min(max(1, round(seconds * 1000)), case.steps)
    frames = []
    for step in rollout.periods(fleet, stack, steps):
        reel.take(fleet)
        if out.suffix != ".png" and step % every == every - 1:
            frames.append(reel.frame())
    _write(out, frames or [reel.frame()])


def _film_job(
    out: Path, case: Scenario, team: stacks.Team, seed: int, seconds: float | None, slow: float, colour: str
) -> None:
    """The kerf as it grows; a picture of the whole job takes no longer than the job."""
    if colour not in QUANTITIES:
        raise InvalidInput(f"unknown colour '{colour}'; {did_you_mean(colour, QUANTITIES)}")
    fleet, job = workshop.fleet_for(case, team, [seed]), workshop.programme(case, team)
    reel = KerfFilm(job, f"{case.name} · {team.name} · seed {seed}", colour)
    every = max(1, round(1000 / slow / FRAMES_PER_SECOND))
    most = round(LONGEST * len(job.x)) if seconds is None else max(1, round(seconds * 1000))
    frames = []
    for step in rollout.periods(fleet, team.z, most):
        if step % SAMPLE == 0:
            reel.take(fleet)
        if out.suffix != ".png" and step % every == every - 1:
            frames.append(reel.frame())
        assert fleet.gantries
        if fleet.gantries.column("progress.near")[0] >= len(job.x) - 1.5:
            break
    _write(out, frames or [reel.frame()])


def _write(out: Path, frames: list[np.ndarray]) -> None:
    import imageio.v3 as imageio

    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic(out) as part:
        if out.suffix == ".png":
            imageio.imwrite(part, frames[-1], extension=".png")
        elif out.suffix == ".gif":
            imageio.imwrite(part, frames, extension=".gif", duration=1000 / FRAMES_PER_SECOND, loop=0)
        else:
            imageio.imwrite(part, frames, extension=".mp4", fps=FRAMES_PER_SECOND, codec="libx264", macro_block_size=2)
