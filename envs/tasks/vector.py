"""``gymnasium.vector.VectorEnv`` over the block kernel: thousands of machines step as one (Towers et al. 2024)."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ..engine.deck import refuse_copy
from ..engine.quantity import InvalidInput, did_you_mean
from .episodes import Episodes, check_render_mode

OPTIONS = ("scenario_seed", "reset_mask")


class KernelVectorEnv(VectorEnv):
    """Any number of environments of one kind in one kernel; the kinds derive from it."""

    BATCH: type[Episodes]
    SINGLE: Any
    """Batch, and the single environment whose arguments and spaces these are."""

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
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.batch: Any = make_batch(self.BATCH, self.SINGLE, num_envs, num_threads, arguments)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.autoreset_mode = _mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_action_space, self.single_observation_space = self.batch.action_space, self.batch.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._begun, self._over = np.zeros(num_envs, bool), np.zeros(num_envs, bool)  # its episode is over
        self._ready = False  # every environment has begun
        self._every = np.arange(num_envs)
        self._films: list[Any] = [None] * num_envs
        self._names = (*self.BATCH.INFO, *(f"_{name}" for name in self.BATCH.INFO))

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
        options = options or {}
        for key in options:
            if key not in OPTIONS:
                raise InvalidInput(f"unknown option '{key}'; {did_you_mean(key, OPTIONS)}")
        machines = self._every if "reset_mask" not in options else self._masked(options["reset_mask"])
        put_sequences(self.batch, machines, seed, self.np_random)
        following = self.batch.following_seeds(machines)
        asked = options.get("scenario_seed")
        self._start(machines, following if asked is None else self.batch.asked_seeds(asked, len(machines)))
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
            self._start(machines, batch.following_seeds(machines))
            batch.rewards[machines] = 0.0
            batch.terminated[machines] = batch.truncated[machines] = False
        if self.render_mode:
            self._film()
        np.logical_or(batch.terminated, batch.truncated, out=over)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            return self._same_step()
        return (
            batch.observations.copy(), batch.rewards.copy(), batch.terminated.copy(), batch.truncated.copy(),
            self._info(self._all()),
        )  # fmt: skip

    def render(self) -> tuple[Any, ...] | None:
        """A picture of each environment, see the single one."""
        return tuple(film.frame() if film else None for film in self._films) if self.render_mode else None

    # ------------------------------------------------------------------------------------------------------------

    def _start(self, machines: np.ndarray, seeds: np.ndarray) -> None:
        self.batch.start(machines, seeds)
        self._over[machines], self._begun[machines] = False, True
        self._ready = self._ready or bool(self._begun.all())
        if self.render_mode:
            for i in machines.tolist():
                self._films[i] = self.batch.film(i)
                self._films[i].take(self.batch.fleet, i)

    def _film(self) -> None:
        for i, film in enumerate(self._films):
            if film is not None:
                film.take(self.batch.fleet, i)

    def _same_step(self) -> tuple:
        """The end of a step in which episodes ended and the next ones begin."""
        batch, over = self.batch, self._over.copy()
        machines = np.flatnonzero(over)
        rewards, terminated, truncated = batch.rewards.copy(), batch.terminated.copy(), batch.truncated.copy()
        last = np.full(self.num_envs, None, object)
        for i in machines.tolist():
            last[i] = batch.observations[i].copy()
        final = {"final_obs": last, "_final_obs": over, "final_info": self._info(over), "_final_info": over}
        self._start(machines, batch.following_seeds(machines))
        return batch.observations.copy(), rewards, terminated, truncated, {**self._info(self._all()), **final}

    def _info(self, mask: np.ndarray) -> dict[str, Any]:
        """Gymnasium's rule: zero for the environments that the mask leaves out."""
        values = np.where(mask, self.batch.infos, 0.0)
        return dict(zip(self._names, (*values, *(mask,) * len(values)), strict=True))

    def _all(self) -> np.ndarray:
        return np.ones(self.num_envs, bool)

    def _masked(self, mask: Any) -> np.ndarray:
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,):
            raise InvalidInput(f"reset_mask must be an array of bool of shape ({self.num_envs},)")
        if not mask.any():
            raise InvalidInput("reset_mask selects no environment; at least one is needed")
        return np.flatnonzero(mask)


def make_batch(kind: type[Episodes], single: Any, num_envs: int, num_threads: int, arguments: dict[str, Any]) -> Any:
    """The batch of a vector environment.

    Raises:
        InvalidInput: no environments or threads, or an argument that the single environment does not have.
    """
    for name, value in (("num_envs", num_envs), ("num_threads", num_threads)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise InvalidInput(f"{name} = {value!r}; a whole number, at least 1")
    known = [name for name in single.__init__.__annotations__ if name not in ("return", "render_mode")]
    for name in arguments:
        if name not in known:
            raise InvalidInput(f"unknown argument '{name}'; {did_you_mean(name, known)}")
    make: Any = kind
    return make(int(num_envs), **arguments, threads=int(num_threads))


def put_sequences(batch: Episodes, machines: np.ndarray, seed: Any, random: np.random.Generator) -> None:
    """Gives machines the sequences of episodes that ``seed`` asks for; those without any get a random one.

    Raises:
        InvalidInput: not as many seeds as environments, or one that is not a whole number from 0 on.
    """
    if seed is None or isinstance(seed, int | np.integer):
        seeds = [None if seed is None else int(seed) + i for i in range(batch.size)]
    else:
        seeds = list(seed)
        if len(seeds) != batch.size:
            raise InvalidInput(f"{len(seeds)} seeds for {batch.size} environments; one for each")
    for i in machines.tolist():
        given = seeds[i]
        if given is not None and (not isinstance(given, int | np.integer) or given < 0):
            raise InvalidInput(f"seed {given!r} of environment {i}: a whole number from 0 on")
        if given is not None or not batch.has_sequence(i):
            batch.sequence(i, int(random.integers(2**31)) if given is None else int(given))


def _mode(mode: str | AutoresetMode) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    known = [m.value for m in AutoresetMode]
    if mode not in known:
        raise InvalidInput(f"unknown autoreset_mode '{mode}'; {did_you_mean(str(mode), known)}")
    return AutoresetMode(mode)
