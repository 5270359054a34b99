"""Any number of machines that do jobs, behind one set of arrays."""

import warnings
from typing import Any

import gymnasium as gym
import numpy as np

from .. import scenarios
from ..control import stack as stacks
from ..engine.deck import Deck
from ..engine.quantity import InvalidInput
from ..pictures.kerf_film import KerfFilm
from ..pictures.kerf_picture import QUANTITIES
from ..plant import heads
from ..plant.controller import stage_address
from ..plant.fleet import Fleet
from . import job_interface as interface
from . import workshop
from .episodes import Episodes, check_choice, chosen, weights_of
from .job_interface import FEATURES, LIMIT, ContourReward, CuttingReward, Io

PERIOD = 8
"""Control periods of 1 ms from decision to decision."""

LONGEST = 3.0
"""Times the planned time, after which an episode is over."""


class JobBatch(Episodes):
    """``size`` machines; the other arguments are those of :class:`contour_following.ContourFollowingEnv`.

    Raises:
        InvalidInput: unknown name, a number out of range, or a scenario without a job.
    """

    TASK = ""

    def __init__(
        self,
        size: int,
        scenario: Any = "",
        control: str = "residual",
        observation: str = "features",
        split: str = "train",
        reward: dict[str, float] | None = None,
        base: Any = "",
        machine: dict[str, Any] | None = None,
        path: str | None = None,
        max_steps: int | None = None,
        colour: str = "standoff",
        threads: int = 1,
        extrapolate: bool = False,
    ) -> None:
        contour = self.TASK == "contour"
        check_choice(control, interface.CONTROLS[:1] if contour else interface.CONTROLS, "control")
        check_choice(observation, interface.OBSERVATIONS, "observation")
        check_choice(split, scenarios.SPLITS, "split")
        check_choice(colour, QUANTITIES, "colour")
        found = chosen(scenario or ("contour-square" if contour else "cut-square"), machine)
        if path is not None:
            found = [s.along(path) if s.job else s for s in found]
        if extrapolate:
            found = [s.varied(job={"extrapolate": True}) if s.job else s for s in found]
        for each in found:
            if each.job is None:
                raise InvalidInput(f"scenario '{each.name}' has no job; this environment needs one with a table [job]")
        if max_steps is not None and max_steps < 1:
            raise InvalidInput(f"max_steps = {max_steps} is out of range; at least 1")
        self.control, self.observation, self.colour = control, observation, colour
        self.weights = weights_of(reward, ContourReward() if contour else CuttingReward())
        self.base = stacks.team(base or ("wu" if contour else "recipe"))
        for stack in self.base.stacks:
            if stack.python is not None:
                raise InvalidInput(f"base controller '{stack.name}' is plain Python; a base must be a compiled law")
            if stack.pilot is not None and stack.slot != "z":
                raise InvalidInput(f"base controller '{stack.name}' is a policy; it moves what the action moves")
        self.jobs = [workshop.programme(s, self.base) for s in found]
        for note in dict.fromkeys(note for job in self.jobs for note in job.warnings):
            warnings.warn(note, stacklevel=4)
        width, seen = 3 if contour else 8, len(FEATURES[self.TASK])
        high = np.inf if observation == "raw" else LIMIT
        longest = [int(np.ceil(LONGEST * len(job.x) / PERIOD)) for job in self.jobs]
        super().__init__(
            size, found, split, [min(n, max_steps or n) for n in longest],
            gym.spaces.Box(-1.0, 1.0, (width,), np.float32), gym.spaces.Box(-high, high, (seen,), np.float32),
        )  # fmt: skip
        self.fleet = Fleet(size, self.base.z.law, heads.POOL, threads)
        gantries = self.fleet.use_gantries(self.base.xy.law, self.base.process.law)
        self.base.install(self.fleet, np.arange(size))
        io = Deck(
            Io, **self.arrays, weights=np.array(self.weights), task=interface.TASKS.index(self.TASK),
            direct=int(control == "direct"), raw=int(observation == "raw"), size=seen, width=width, machines=size,
            gantry=gantries.deck,
        )  # fmt: skip
        self.fleet.hook(stage_address(interface.act), stage_address(interface.observe), io)
        self.advance = self.fleet.stepper(PERIOD)

    def prepare(self, index: int, machines: np.ndarray, seeds: np.ndarray, again: bool) -> None:
        """See :meth:`Episodes.prepare`."""
        workshop.prepare(self.fleet, self.scenarios[index], self.base, machines, seeds)

    def prepared(self, machines: np.ndarray) -> None:
        """A policy in the slot ``z`` may have changed the filter during the last episode."""
        if self.base.z.pilot is not None:
            self.fleet.put_filter(machines, self.base.z.part("filter"))

    def film(self, machine: int) -> KerfFilm:
        """What shows the episode of a machine that has just begun."""
        index = int(self.scenario_of[machine])
        title = f"{self.scenarios[index].name} · {self.base.name} · seed {int(self.scenario_seeds[machine])}"
        return KerfFilm(self.jobs[index], title, self.colour)


class ContourBatch(JobBatch):
    """Machines of ContourFollowing."""

    TASK, INFO = "contour", interface.INFO["contour"]


class CuttingBatch(JobBatch):
    """Machines of Cutting."""

    TASK, INFO = "cutting", interface.INFO["cutting"]
