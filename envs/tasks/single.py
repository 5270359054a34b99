"""What all Gymnasium environments have in common: a batch of one machine."""

from typing import Any

import gymnasium as gym
import numpy as np

from ..control.stack import Team
from ..engine.deck import refuse_copy
from ..engine.quantity import InvalidInput
from ..scenarios import Scenario
from .batch import Batch
from .episodes import check_options, check_render_mode
from .task import Task

LARGEST = 3.4e38
"""Largest finite action (float32)."""

_ONE = np.zeros(1, np.int64)


class SingleEnv(gym.Env):
    """The environment of :attr:`TASK`; ``arguments`` are the batch's."""

    TASK: Task
    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}

    def __init__(self, render_mode: str | None, **arguments: Any) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.batch = batch = Batch(self.TASK, 1, **arguments)
        if render_mode:
            batch.keep_pictures()
        self.control, self.split, self.render_mode = batch.control, batch.split, render_mode
        self.objectives = self.TASK.objectives
        """Names of the entries of ``info`` that make the vector of objectives."""
        self.action_space, self.observation_space = batch.action_space, batch.observation_space
        # A step is short, so it goes around the batch, straight to the arrays of its only machine.
        self._advance, self._shape = batch.advance, batch.actions[0].shape
        self._actions: Any = batch.actions[0].data  # reads and writes a number three times as fast as the array does
        self._rewards: Any = batch.rewards.data
        self._terminated: Any = batch.terminated.data
        self._truncated: Any = batch.truncated.data
        self._observed, self._values = batch.observations[0].copy, batch.infos[:, 0].tolist
        self._single, self._over = self._shape == (1,), True

    def __reduce__(self) -> Any:
        refuse_copy(self)

    @property
    def base(self) -> Team:
        """What does what the action leaves open."""
        return self.batch.base

    @property
    def scenario(self) -> Scenario:
        """The scenario of the present episode."""
        return self.batch.scenario(0)

    @property
    def scenario_seed(self) -> int:
        """The seed of the present episode."""
        return int(self.batch.scenario_seeds[0])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Starts an episode; see *Starting State*.

        Raises:
            InvalidInput: unknown option, or a scenario seed that is not in the split.
        """
        super().reset(seed=seed)
        self.batch.reset(_ONE, [seed], check_options(options, "scenario_seed"), self.np_random)
        self._over = False
        return self._observed(), self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        """One decision, held for the period that *Action Space* names.

        Raises:
            InvalidInput: the action has the wrong shape or is not finite, or the episode is over.
        """
        if self._over:
            raise InvalidInput("the episode is over; call reset() before step()")
        if self._single:
            try:
                (x,) = action.tolist()
            except (AttributeError, TypeError, ValueError):
                x = None
            if not isinstance(x, float) or not -LARGEST <= x <= LARGEST:
                x = self._checked(action).item()
            self._actions[0] = x
        else:
            self.batch.actions[0] = self._checked(action)
        self._advance()
        terminated, truncated = self._terminated[0], self._truncated[0]
        self._over = terminated or truncated
        return self._observed(), self._rewards[0], terminated, truncated, self._info()

    def _checked(self, action: Any) -> np.ndarray:
        a = np.asarray(action)
        if a.shape != self._shape:
            raise InvalidInput(f"the action has shape {a.shape}; it must be {self._shape}")
        if a.dtype.kind not in "fiu":
            raise InvalidInput(f"the action is of type {a.dtype}; numbers are needed, float32 best")
        if not (np.abs(a) <= LARGEST).all():  # NaN neither
            raise InvalidInput(f"the action {action} is not finite; allowed: -1 to 1")
        return a

    def _info(self) -> dict[str, Any]:
        info: dict[str, Any] = self.batch.info(0)
        info["objectives"] = np.array([info[name] for name in self.objectives])
        return info

    def render(self) -> np.ndarray | None:
        """The machine now: of a height follower sheet, nozzle, gap, set height, and the last second of true and
        reported error; of a job the part with the kerf so far, coloured as ``colour`` says, and the spot."""
        return self.batch.frame(0)
