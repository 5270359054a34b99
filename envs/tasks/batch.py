"""Any number of height-following machines behind one set of arrays."""

from typing import Any

import gymnasium as gym
import numpy as np

from .. import scenarios
from ..control import stack as stacks
from ..engine.deck import Deck
from ..engine.quantity import InvalidInput
from ..pictures.film import Film
from ..plant import heads
from ..plant.controller import stage_address
from ..plant.fleet import Fleet
from .episodes import Episodes, check_choice, chosen, weights_of
from .interface import (
    CONTROLS,
    FEATURES,
    INFO,
    LARGEST_TRIM,
    LIMIT,
    LONGEST_WINDOW,
    OBSERVATIONS,
    RAW_HISTORY,
    Io,
    Memory,
    Reward,
    act,
    observe,
)


class Batch(Episodes):
    """``size`` machines; the other arguments are those of :class:`height_following.HeightFollowingEnv`.

    Raises:
        InvalidInput: unknown name, or a number out of range.
    """

    INFO = INFO

    def __init__(
        self,
        size: int,
        scenario: Any = "wavy",
        control: str = "residual",
        observation: str = "features",
        split: str = "train",
        reward: dict[str, float] | None = None,
        base: Any = "xi2023-improved",
        machine: dict[str, Any] | None = None,
        max_steps: int | None = None,
        threads: int = 1,
    ) -> None:
        check_choice(control, CONTROLS, "control")
        check_choice(observation, OBSERVATIONS, "observation")
        check_choice(split, scenarios.SPLITS, "split")
        found = chosen(scenario, machine)
        jobs = [each.name for each in found if each.job]
        if jobs:
            raise InvalidInput(
                f"scenario '{jobs[0]}' is a job; kerfgym/ContourFollowing-v0 and kerfgym/Cutting-v0 do jobs"
            )
        self.control, self.observation, self.weights = control, observation, weights_of(reward, Reward())
        self.base = stacks.resolve("idle" if control == "direct" else base)
        if self.base.python is not None:
            raise InvalidInput(f"base controller '{self.base.name}' is plain Python; a base must be a compiled law")
        if self.base.slot != "z":
            raise InvalidInput(f"base controller '{self.base.name}' drives slot '{self.base.slot}', not 'z'")
        if self.base.pilot is not None:
            raise InvalidInput(f"base controller '{self.base.name}' is a policy; it moves what the action moves")
        if max_steps is not None and max_steps < 1:
            raise InvalidInput(f"max_steps = {max_steps} is out of range; at least 1")
        space = gym.spaces.Box(-1.0, 1.0, (3 if control == "schedule" else 1,), np.float32)
        steps = [min(s.steps, max_steps or s.steps) for s in found]
        super().__init__(size, found, split, steps, space, _observation_space(observation))
        self.fleet = Fleet(size, self.base.law, heads.POOL, threads)
        self.base.install(self.fleet, np.arange(size))
        if control == "schedule":
            self.fleet.widest_window(LONGEST_WINDOW, LARGEST_TRIM)
        io = Deck(
            Io, **self.arrays, weights=np.array(self.weights), control=CONTROLS.index(control),
            raw=int(observation == "raw"), size=self.observations.shape[1], width=self.actions.shape[1], machines=size,
            memory=np.zeros((len(Memory._fields), size)),
        )  # fmt: skip
        self.fleet.hook(stage_address(act), stage_address(observe), io)
        self.advance = self.fleet.stepper()

    def prepare(self, index: int, machines: np.ndarray, seeds: np.ndarray, again: bool) -> None:
        """See :meth:`Episodes.prepare`."""
        scenarios.prepare(self.fleet, self.scenarios[index], machines, seeds, again)

    def film(self, machine: int) -> Film:
        """What shows the episode of a machine that has just begun."""
        return Film(self.scenario(machine), self.base.name, int(self.scenario_seeds[machine]))

    def prepared(self, machines: np.ndarray) -> None:
        """The action may have changed the filter during the last episode."""
        if self.control == "schedule":
            self.fleet.put_filter(machines, self.base.part("filter"))


def _observation_space(observation: str) -> gym.spaces.Box:
    if observation == "features":
        return gym.spaces.Box(-LIMIT, LIMIT, (len(FEATURES),), np.float32)
    n = RAW_HISTORY
    low = np.array([0.0] * 2 * n + [-200.0] * n + [-2000.0] * (n + 1) + [0.0] * 5, np.float32)
    high = np.array([10.1] * 2 * n + [200.0] * n + [2000.0] * (n + 1) + [10.0, 2000.0, 1.0, 1.0, 6.0], np.float32)
    return gym.spaces.Box(low, high, dtype=np.float32)
