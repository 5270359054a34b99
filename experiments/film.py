"""Films of one episode."""

from pathlib import Path

import numpy as np

from ..envs import scenarios
from ..envs import stack as stacks
from ..envs.film import Film
from ..envs.plant.quantity import InvalidInput
from . import rollout
from .runs import atomic

FRAMES_PER_SECOND = 25


def film(
    out: Path, controller: str, scenario: str, seed: int, seconds: float | None = None, slow: float = 10.0
) -> None:
    """Writes an episode as MP4 or GIF, or its last frame as PNG.

    Raises:
        InvalidInput: unknown suffix, controller, scenario or seed, or a time that is not above 0.
    """
    if out.suffix not in (".mp4", ".gif", ".png"):
        raise InvalidInput(f"cannot write '{out}'; allowed: .mp4, .gif, .png")
    if seed < 0:
        raise InvalidInput(f"--seed {seed} is out of range; 0 and up")
    if slow <= 0 or (seconds is not None and seconds <= 0):
        raise InvalidInput("--slow and --seconds must be above 0")
    stack = stacks.resolve(controller)
    case = scenarios.load(scenario)
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
