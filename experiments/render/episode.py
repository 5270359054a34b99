"""Films of one episode."""

import errno
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.quantity import InvalidInput, check_choice
from ...envs.pictures.kerf_picture import QUANTITIES
from ...envs.scenarios import Machine, Reading, Scenario, machines
from ...envs.tasks import workshop
from ..measure import rollout
from ..measure.grids import cut
from ..results.jobs import LONGEST
from ..store.progress import Bars
from ..store.runs import atomic

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
    reading: Reading | None = None,
    cut_as: Mapping[str, float] | None = None,
    machine: Machine | None = None,
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
        case = case.along(path, reading)
    if cut_as:
        case = cut(case, cut_as)
    case = machines.put_on(case, machine) if machine else case
    check_choice(colour, QUANTITIES, "colour")
    team = stacks.team(controller) if case.job else stacks.asked(controller)
    every = max(1, round(1000 / (slow or (0.2 if case.job else 10.0)) / FRAMES_PER_SECOND))
    length = len(workshop.programme(case, team).x) if case.job else case.steps
    longest = round(LONGEST * length) if case.job else length
    most = longest if seconds is None else max(1, round(seconds * 1000))
    frames = _frames(case, team, seed, most if case.job else min(most, length), every, out.suffix == ".png", colour)
    _write(out, frames, max(1, min(most, length) // every))


def _frames(
    case: Scenario, team: stacks.Team, seed: int, most: int, every: int, last: bool, colour: str
) -> Iterator[np.ndarray]:
    """A picture of every so many steps, at least one; the ``last`` only if that is wanted. One of a whole job takes no
    longer than the job."""
    fleet, reel = workshop.fleet_for(case, team, [seed]), workshop.film_of(case, team, seed, colour)
    sample, ends, shown = (SAMPLE, len(workshop.programme(case, team).x) - 1.5, 0) if case.job else (1, 0.0, 0)
    for step in rollout.periods(fleet, team.z, most):
        if step % sample == 0:
            reel.take(fleet)
        if not last and step % every == every - 1:
            yield reel.frame()
            shown += 1
        if fleet.gantries and fleet.gantries.column("progress.near")[0] >= ends:
            break
    if not shown:
        yield reel.frame()


def _write(out: Path, frames: Iterator[np.ndarray], expected: int) -> None:
    """Writes pictures as they come: all those of three seconds would take a gigabyte of memory."""
    with atomic(out) as part, Bars() as bars:
        shown = bars.each("drawing", frames, 1 if out.suffix == ".png" else expected)
        first = next(shown)
        if out.suffix == ".mp4":
            import imageio_ffmpeg

            how = {"fps": FRAMES_PER_SECOND, "codec": "libx264", "macro_block_size": 2, "output_params": ["-f", "mp4"]}
            film_ = imageio_ffmpeg.write_frames(str(part), first.shape[1::-1], **how)
            film_.send(None)
            count = 0
            for frame in itertools.chain([first], shown):
                film_.send(np.ascontiguousarray(frame))
                count += 1
            film_.close()
            _whole(part, count)
        elif out.suffix == ".gif":
            others = map(Image.fromarray, shown)
            Image.fromarray(first).save(
                part, format="GIF", save_all=True, append_images=others, duration=1000 // FRAMES_PER_SECOND, loop=0
            )
        else:
            Image.fromarray(first).save(part, format="PNG")
            next(shown, None)


def _whole(film_: Path, frames: int) -> None:
    """Raises :class:`OSError` unless a film has all its frames: ffmpeg says nothing of a full disk."""
    import imageio_ffmpeg

    try:
        found = imageio_ffmpeg.count_frames_and_secs(str(film_))[0]
    except RuntimeError:  # it has not even a head
        found = 0
    if found != frames:
        raise OSError(errno.ENOSPC, f"{found} of {frames} frames were written")
