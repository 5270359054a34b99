"""A stable-baselines3 ``VecEnv`` over the block kernel, without an adaptor in between.

Episodes that end begin anew within the same step. The observations are normalised and the monitor's statistics kept
here, so ``VecNormalize`` and ``VecMonitor`` are not needed.
"""

import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from ..envs.contour_following import ContourFollowingEnv
from ..envs.cutting import CuttingEnv
from ..envs.engine.deck import refuse_copy
from ..envs.engine.quantity import InvalidInput, did_you_mean
from ..envs.height_following import HeightFollowingEnv
from ..envs.tasks.episodes import check_options
from ..envs.tasks.single import SingleEnv
from ..envs.tasks.vector import make_batch

_OF_MACHINE = ("scenario", "scenario_seed", "base", "control", "split")
ATTRIBUTES = (*_OF_MACHINE, "render_mode", "spec", "action_space", "observation_space")
"""What :meth:`KernelVecEnv.get_attr` knows, besides the entries of ``info`` and what :meth:`set_attr` has set."""

METHODS = ("reset", "render", "close", "get_wrapper_attr")
"""What :meth:`KernelVecEnv.env_method` can call."""


class KernelVecEnv(VecEnv):
    """``num_envs`` environments of one kind for stable-baselines3; other arguments as in the single environment.

    Args:
        num_envs: environments.
        num_threads: threads that step them; they sleep while they wait.
        full_info: whether every step's ``infos`` hold all entries of the single environment's ``info``. Without, only
            the ends of episodes do, which is what training reads; ``get_attr("true_gap")`` shows them at any time.
        render_mode: None or ``"rgb_array"``.

    Raises:
        InvalidInput: unknown argument or name, or a number out of range.
    """

    SINGLE: type[SingleEnv]
    """The single environment with the same machine."""

    def __init__(
        self,
        num_envs: int,
        *,
        num_threads: int = 1,
        full_info: bool = False,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        self.batch = make_batch(self.SINGLE, num_envs, num_threads, render_mode, arguments)
        self._attributes = (*ATTRIBUTES, *self.SINGLE.TASK.info)
        self._full_info = full_info
        self._mode = render_mode
        self._set: dict[str, list[Any]] = {}
        self._every = np.arange(num_envs)
        self._began = time.time()
        self._empty: list[dict[str, Any]] = [{} for _ in range(num_envs)]  # the same ones in each step
        self._ready = False
        self._random = np.random.default_rng()
        super().__init__(num_envs, self.batch.observation_space, self.batch.action_space)

    def __reduce__(self) -> Any:
        refuse_copy(self)

    # ------------------------------------------------------------------------------------------------- stepping

    def reset(self) -> np.ndarray:
        """Starts the next episode of every environment; :meth:`seed` and :meth:`set_options` before it count."""
        self.batch.take_seeds(self._every, self._seeds, self._random)
        following = self.batch.following_seeds(self._every)
        asked = [self._asked(i) for i in range(self.num_envs)]
        seeds = [f if a is None else a for f, a in zip(following.tolist(), asked, strict=True)]
        self.batch.start(self._every, self.batch.asked_seeds(seeds, self.num_envs))
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [self.batch.info(i) for i in range(self.num_envs)]
        self._ready = True
        return self.batch.observations.copy()

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of the coming step.

        Raises:
            InvalidInput: wrong shape or type, not finite, or the episodes have not begun.
        """
        if not self._ready:
            raise InvalidInput("the episodes have not begun; call reset() before step()")
        self.batch.put_actions(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One step of every environment; those whose episode ends begin the next one."""
        batch = self.batch
        batch.advance()
        rewards = batch.rewards.astype(np.float32)
        over = np.logical_or(batch.terminated, batch.truncated)
        infos = [batch.info(i) for i in range(self.num_envs)] if self._full_info else self._empty.copy()
        if over.any():
            machines = np.flatnonzero(over)
            for i in machines.tolist():
                infos[i] = self._last_info(i)
            batch.restart(machines)
            for i in machines.tolist():
                self.reset_infos[i] = batch.info(i)
        return batch.observations.copy(), rewards, over, infos

    def close(self) -> None:
        """Nothing needs to be closed."""

    def get_images(self) -> list[np.ndarray | None]:
        """A picture of each environment."""
        return [self.batch.frame(i) for i in range(self.num_envs)]

    # ---------------------------------------------------------------------------------------- single environments

    def has_attr(self, attr_name: str) -> bool:
        """Whether :meth:`get_attr` knows the attribute."""
        return attr_name in self._attributes or attr_name in METHODS or attr_name in self._set

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each environment: one of :data:`ATTRIBUTES`, an entry of ``info``, or a set one.

        Raises:
            AttributeError: there is none of that name; the nearest is offered.
        """
        machines = self._machines(indices)
        if attr_name in self._set:
            return [self._set[attr_name][i] for i in machines]
        if attr_name in self.SINGLE.TASK.info:
            return [float(x) for x in self.batch.infos[self.SINGLE.TASK.info.index(attr_name), machines]]
        if attr_name == "scenario":
            return [self.batch.scenario(i) for i in machines]
        if attr_name == "scenario_seed":
            return [int(self.batch.scenario_seeds[i]) for i in machines]
        if attr_name in METHODS:
            return [_Method(self, attr_name, i) for i in machines]
        if attr_name not in self._attributes:
            raise AttributeError(
                f"the environments have no attribute '{attr_name}'; {did_you_mean(attr_name, self._attributes)}"
            )
        one = {"render_mode": self._mode, "spec": None}.get(attr_name, getattr(self.batch, attr_name, None))
        return [one] * len(machines)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of some environments, a new one or ``scenario`` (from the next episode on).

        Raises:
            InvalidInput: the attribute is fixed when the environments are made.
        """
        if attr_name in self._attributes or attr_name in METHODS:
            raise InvalidInput(f"attribute '{attr_name}' is fixed when the environments are made")
        values = self._set.setdefault(attr_name, [None] * self.num_envs)
        for i in self._machines(indices):
            values[i] = value

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Calls a method of some environments: one of :data:`METHODS`.

        Raises:
            AttributeError: there is none of that name; the nearest is offered.
        """
        if method_name not in METHODS:
            raise AttributeError(
                f"the environments have no method '{method_name}'; {did_you_mean(method_name, METHODS)}"
            )
        return [_Method(self, method_name, i)(*method_args, **method_kwargs) for i in self._machines(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether the environments are wrapped: monitored they are, otherwise not."""
        return [issubclass(Monitor, wrapper_class)] * len(self._machines(indices))

    # ----------------------------------------------------------------------------------------------------------

    def _machines(self, indices: int | Iterable[int] | None) -> list[int]:
        machines = [int(i) for i in self._get_indices(indices)]
        for i in machines:
            if not -self.num_envs <= i < self.num_envs:
                raise InvalidInput(f"environment {i} does not exist; there are {self.num_envs}")
        return machines

    def _asked(self, machine: int) -> int | None:
        return check_options(self._options[machine], "scenario_seed").get("scenario_seed")

    def _last_info(self, machine: int) -> dict[str, Any]:
        """Info of the last step of an episode, with the monitor's statistics of it."""
        info = self.batch.info(machine)
        info["terminal_observation"] = self.batch.observations[machine].copy()
        info["TimeLimit.truncated"] = bool(self.batch.truncated[machine])
        length, total = self.batch.length(machine), round(float(self.batch.returns[machine]), 6)
        info["episode"] = {"r": total, "l": length, "t": round(time.time() - self._began, 6)}
        return info


class HeightFollowingVecEnv(KernelVecEnv):
    """:class:`envs.height_following.HeightFollowingEnv` for stable-baselines3, see :class:`KernelVecEnv`."""

    SINGLE = HeightFollowingEnv


class ContourFollowingVecEnv(KernelVecEnv):
    """:class:`envs.contour_following.ContourFollowingEnv` for stable-baselines3, see :class:`KernelVecEnv`."""

    SINGLE = ContourFollowingEnv


class CuttingVecEnv(KernelVecEnv):
    """:class:`envs.cutting.CuttingEnv` for stable-baselines3, see :class:`KernelVecEnv`."""

    SINGLE = CuttingEnv


KINDS = {kind.SINGLE.TASK.id: kind for kind in (HeightFollowingVecEnv, ContourFollowingVecEnv, CuttingVecEnv)}
"""By the id of the environment."""


class _Method:
    """A method of one of the environments."""

    def __init__(self, venv: KernelVecEnv, name: str, machine: int) -> None:
        self._venv, self._name, self._machine = venv, name, machine

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return getattr(self, f"_{self._name}")(*args, **kwargs)

    def _reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        venv, machine = self._venv, self._machine
        if options:
            venv._options[machine] = options
        seeds = [seed if i == machine else None for i in range(venv.num_envs)]
        options = check_options(venv._options[machine], "scenario_seed")
        venv.batch.reset(np.array([machine]), seeds, options, venv._random)
        venv._options[machine] = {}
        return venv.batch.observations[machine].copy(), venv.batch.info(machine)

    def _render(self) -> np.ndarray | None:
        return self._venv.batch.frame(self._machine)

    def _close(self) -> None:
        pass

    def _get_wrapper_attr(self, name: str) -> Any:
        return self._venv.get_attr(name, self._machine)[0]
