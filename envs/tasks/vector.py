"""``gymnasium.vector.VectorEnv`` over the block kernel: thousands of machines step as one (Towers et al. 2024)."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ..engine.deck import refuse_copy
from ..engine.quantity import InvalidInput, check_choice
from .batch import Batch
from .episodes import check_options, check_render_mode
from .single import SingleEnv


class KernelVectorEnv(VectorEnv):
    """Any number of environments of one kind in one kernel; the kinds derive from it."""

    SINGLE: type[SingleEnv]
    """The single environment, whose task, arguments and spaces these are."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        *,
        num_threads: int = 1,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        self.batch = make_batch(self.SINGLE, num_envs, num_threads, render_mode, arguments)
        self.num_envs, self.render_mode = num_envs, render_mode
        if not isinstance(autoreset_mode, AutoresetMode):
            check_choice(autoreset_mode, [mode.value for mode in AutoresetMode], "autoreset_mode")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_action_space, self.single_observation_space = self.batch.action_space, self.batch.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._begun, self._over = np.zeros(num_envs, bool), np.zeros(num_envs, bool)  # its episode is over
        self._ready = False  # every environment has begun
        self._every = np.arange(num_envs)
        self._names = (*self.SINGLE.TASK.info, *(f"_{name}" for name in self.SINGLE.TASK.info))

    def __reduce__(self) -> Any:
        refuse_copy(self)

    def reset(
        self, *, seed: int | list[int | None] | np.ndarray | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts the next episode of every environment, or of some.

        Args:
            seed: begins new sequences of episodes: one number ``s`` stands for ``s + i``, a list has one for each
                environment (None: go on with the present sequence).
            options: ``reset_mask``, bool of shape (num_envs,): which environments; ``scenario_seed``: one, or one for
                each environment that is reset.

        Raises:
            InvalidInput: unknown option, wrong length, or a scenario seed that is not in the split.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        options = check_options(options, "scenario_seed", "reset_mask")
        machines = self._every if "reset_mask" not in options else self._masked(options["reset_mask"])
        self.batch.reset(machines, seed, options, self.np_random)
        self._begin(machines)
        mask = np.zeros(self.num_envs, bool)
        mask[machines] = True
        return self.batch.observations.copy(), self._info(mask)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One step of every environment.

        Raises:
            InvalidInput: the actions have the wrong shape or type or are not finite; an episode has not begun, or is
                over where autoreset is disabled.
        """
        batch, over = self.batch, self._over
        ended = over.any()
        if not self._ready or (ended and self.autoreset_mode is AutoresetMode.DISABLED):
            first = np.flatnonzero(over | ~self._begun)[0]
            state = "is over" if self._begun[first] else "has not begun"
            raise InvalidInput(f"the episode of environment {first} {state}; call reset() before step()")
        batch.put_actions(actions)
        batch.advance()
        if ended:
            machines = np.flatnonzero(over)
            batch.restart(machines)
            self._begin(machines)
            batch.rewards[machines] = 0.0
            batch.terminated[machines] = batch.truncated[machines] = False
        np.logical_or(batch.terminated, batch.truncated, out=over)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            return self._same_step()
        return (
            batch.observations.copy(),
            batch.rewards.copy(),
            batch.terminated.copy(),
            batch.truncated.copy(),
            self._info(),
        )

    def render(self) -> tuple[Any, ...] | None:
        """A picture of each environment, see the single one."""
        return tuple(map(self.batch.frame, range(self.num_envs))) if self.render_mode else None

    # ------------------------------------------------------------------------------------------------------------

    def _begin(self, machines: np.ndarray) -> None:
        self._over[machines], self._begun[machines] = False, True
        self._ready = self._ready or bool(self._begun.all())

    def _same_step(self) -> tuple:
        """The end of a step in which episodes ended and the next ones begin."""
        batch, over = self.batch, self._over.copy()
        machines = np.flatnonzero(over)
        rewards, terminated, truncated = batch.rewards.copy(), batch.terminated.copy(), batch.truncated.copy()
        last = np.full(self.num_envs, None, object)
        for i in machines.tolist():
            last[i] = batch.observations[i].copy()
        final = {"final_obs": last, "_final_obs": over, "final_info": self._info(over), "_final_info": over}
        batch.restart(machines)
        self._begin(machines)
        return batch.observations.copy(), rewards, terminated, truncated, {**self._info(), **final}

    def _info(self, mask: np.ndarray | None = None) -> dict[str, Any]:
        """Gymnasium's rule: zero for the environments that the mask leaves out; None: it leaves none out."""
        mask = np.ones(self.num_envs, bool) if mask is None else mask
        values = np.where(mask, self.batch.infos, 0.0)
        return dict(zip(self._names, (*values, *(mask,) * len(values)), strict=True))

    def _masked(self, mask: Any) -> np.ndarray:
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,):
            raise InvalidInput(f"reset_mask must be an array of bool of shape ({self.num_envs},)")
        if not mask.any():
            raise InvalidInput("reset_mask selects no environment; at least one is needed")
        return np.flatnonzero(mask)


def make_batch(
    single: type[SingleEnv], num_envs: int, num_threads: int, render_mode: str | None, arguments: dict[str, Any]
) -> Batch:
    """The batch of a vector environment.

    Raises:
        InvalidInput: no environments or threads, or an argument that the single environment does not have.
    """
    check_render_mode(render_mode, single.metadata["render_modes"])
    for name, value in (("num_envs", num_envs), ("num_threads", num_threads)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise InvalidInput(f"{name} = {value!r}; a whole number, at least 1")
    known = [name for name in single.__init__.__annotations__ if name not in ("return", "render_mode")]
    for name in arguments:
        check_choice(name, known, "argument")
    batch = Batch(single.TASK, int(num_envs), **arguments, threads=int(num_threads))
    if render_mode:
        batch.keep_pictures()
    return batch
