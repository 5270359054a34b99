"""What the environments of jobs have in common."""

from typing import Any

import gymnasium as gym
import numpy as np

from ..engine.deck import refuse_copy
from ..engine.quantity import InvalidInput, did_you_mean
from ..pictures.kerf_film import KerfFilm
from ..scenarios import Scenario
from .episodes import check_render_mode
from .job_batch import JobBatch
from .job_interface import OBJECTIVES

_ONE = np.zeros(1, np.int64)


class JobEnv(gym.Env):
    """A batch of one machine as an environment."""

    BATCH: type[JobBatch]
    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}

    def __init__(self, render_mode: str | None, **arguments: Any) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.batch = self.BATCH(1, **arguments)
        self.render_mode = render_mode
        self.action_space, self.observation_space = self.batch.action_space, self.batch.observation_space
        self.objectives = OBJECTIVES[self.batch.TASK]
        """Names of the entries of ``info`` that make the vector of objectives."""
        self._over = True
        self._film: KerfFilm | None = None

    def __reduce__(self) -> Any:
        refuse_copy(self)

    @property
    def scenario(self) -> Scenario:
        """The scenario of the present episode."""
        return self.batch.scenario(0)

    @property
    def scenario_seed(self) -> int:
        """The seed of the present episode."""
        return int(self.batch.scenario_seeds[0])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Starts a job; see *Starting State*.

        Raises:
            InvalidInput: unknown option, or a scenario seed that is not in the split.
        """
        super().reset(seed=seed)
        batch = self.batch
        if seed is not None or not batch.has_sequence(0):
            batch.sequence(0, seed if seed is not None else int(self.np_random.integers(2**31)))
        options = options or {}
        for key in options:
            if key != "scenario_seed":
                raise InvalidInput(f"unknown option '{key}'; {did_you_mean(key, ['scenario_seed'])}")
        following = batch.following_seeds(_ONE)
        asked = "scenario_seed" in options
        batch.start(_ONE, batch.asked_seeds(options["scenario_seed"], 1) if asked else following)
        self._over = False
        if self.render_mode:
            self._film = batch.film(0)
            self._film.take(batch.fleet)
        return batch.observations[0].copy(), self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        """One decision: 8 ms of the job.

        Raises:
            InvalidInput: the action has the wrong shape or is not finite, or the episode is over.
        """
        if self._over:
            raise InvalidInput("the episode is over; call reset() before step()")
        batch, a = self.batch, np.asarray(action)
        if a.shape != self.action_space.shape:
            raise InvalidInput(f"the action has shape {a.shape}; it must be {self.action_space.shape}")
        batch.put_actions(a[None])
        batch.advance()
        if self._film is not None:
            self._film.take(batch.fleet)
        terminated, truncated = bool(batch.terminated[0]), bool(batch.truncated[0])
        self._over = terminated or truncated
        return batch.observations[0].copy(), float(batch.rewards[0]), terminated, truncated, self._info()

    def render(self) -> np.ndarray | None:
        """The part with the kerf so far, coloured as ``colour`` says, and the spot."""
        return self._film.frame() if self._film else None

    def _info(self) -> dict[str, Any]:
        info: dict[str, Any] = dict(zip(self.batch.INFO, self.batch.infos[:, 0].tolist(), strict=True))
        info["objectives"] = np.array([info[name] for name in self.objectives])
        return info
