"""Any number of height-following machines behind one set of arrays: what every environment and vector environment is.

A batch knows the episodes of its machines: which scenario and seed, how many periods are left. Machine ``i`` with the
sequence seed ``s`` lives through the same episodes, bit for bit, in a batch of any size and in the single environment.
"""

from typing import Any

import gymnasium as gym
import numpy as np

from . import scenarios
from . import stack as stacks
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
    Reward,
    act,
    observe,
)
from .plant import heads
from .plant.controller import stage_address
from .plant.fleet import Fleet
from .plant.lanes import mix
from .plant.quantity import InvalidInput, did_you_mean
from .scenarios import Scenario


class Batch:
    """``size`` machines; the other arguments are those of :class:`height_following.HeightFollowingEnv`.

    The arrays belong to the batch and change with every period: ``actions`` float32 (size, k); ``observations``
    float32 (size, d); ``rewards`` and their sums ``returns`` float64 (size,);
    ``infos`` float64 (15, size), a row for each name of ``INFO``;
    ``left`` float64 (size,), periods until the time is over; ``terminated`` and ``truncated`` bool (size,).

    Raises:
        InvalidInput: unknown name, or a number out of range.
    """

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
        for value, allowed, what in (
            (control, CONTROLS, "control"),
            (observation, OBSERVATIONS, "observation"),
            (split, scenarios.SPLITS, "split"),
        ):
            if value not in allowed:
                raise InvalidInput(f"unknown {what} '{value}'; {did_you_mean(str(value), allowed)}")
        self.scenarios = _scenarios(scenario, machine)
        self.control, self.split, self.weights = control, split, _weights(reward)
        self.base = stacks.resolve("idle" if control == "direct" else base)
        if self.base.python is not None:
            raise InvalidInput(f"base controller '{self.base.name}' is plain Python; a base must be a compiled law")
        if max_steps is not None and max_steps < 1:
            raise InvalidInput(f"max_steps = {max_steps} is out of range; at least 1")
        self._steps = np.array([min(s.steps, max_steps or s.steps) for s in self.scenarios])
        self.size, self.fleet = size, Fleet(size, self.base.law, heads.POOL, threads)
        self.base.install(self.fleet, np.arange(size))
        if control == "schedule":
            self.fleet.widest_window(LONGEST_WINDOW, LARGEST_TRIM)

        count = 3 if control == "schedule" else 1
        self.action_space = gym.spaces.Box(-1.0, 1.0, (count,), np.float32)
        self.observation_space = _observation_space(observation)
        width = self.observation_space.shape[0]
        self.actions = np.zeros((size, count), np.float32)
        self.observations = np.zeros((size, width), np.float32)
        self.rewards, self.returns, self.infos = np.zeros(size), np.zeros(size), np.zeros((len(INFO), size))
        self.left = np.zeros(size)
        self.terminated, self.truncated = np.zeros(size, bool), np.zeros(size, bool)
        self.scenario_seeds, self.scenario_of = np.zeros(size, np.int64), np.zeros(size, np.int64)
        self._prepared = np.full(size, -1, np.int64)  # index of the scenario whose physics the column holds
        self._sequence, self._episode = np.full(size, -1, np.int64), np.zeros(size, np.int64)
        self._weights = np.array(self.weights)
        self._io = np.array(Io(
            self.actions.ctypes.data, self.observations.ctypes.data, self.rewards.ctypes.data,
            self.returns.ctypes.data, self.infos.ctypes.data,
            self._weights.ctypes.data, CONTROLS.index(control), int(observation == "raw"), width, count, size,
            self.left.ctypes.data, self.terminated.ctypes.data, self.truncated.ctypes.data,
        ), np.uint64)  # fmt: skip
        self.fleet.hook(stage_address(act), stage_address(observe), self._io)
        self.advance = self.fleet.stepper()
        """One control period of every machine."""

    # ------------------------------------------------------------------------------------------------ episodes

    def has_sequence(self, machine: int) -> bool:
        """Whether the machine has got a sequence of episodes."""
        return bool(self._sequence[machine] >= 0)

    def sequence(self, machines: Any, seeds: Any) -> None:
        """Gives machines new sequences of episodes, one seed each."""
        self._sequence[machines], self._episode[machines] = seeds, 0

    def following_seeds(self, machines: np.ndarray) -> np.ndarray:
        """Scenario seeds of the episodes that come next in the machines' sequences, and moves on by one."""
        seeds, episodes = self._sequence[machines], self._episode[machines]
        self._episode[machines] += 1
        split = scenarios.SPLITS[self.split]
        if self.split == "train":
            return split.start + (mix(seeds, episodes) % np.uint64(len(split))).astype(np.int64)
        return split.start + (seeds + episodes) % len(split)

    def asked_seeds(self, asked: Any, count: int) -> np.ndarray:
        """Scenario seeds that a user asks for, one for each of ``count`` machines.

        Raises:
            InvalidInput: not whole numbers, not as many as machines, or not in the split.
        """
        seeds = np.asarray(asked)
        if seeds.dtype.kind not in "iu":
            raise InvalidInput(f"scenario_seed = {asked!r}; whole numbers are needed")
        if seeds.ndim > 1 or (seeds.ndim == 1 and len(seeds) != count):
            raise InvalidInput(f"scenario_seed has shape {seeds.shape}; one number, or {count}, one for each reset")
        split = scenarios.SPLITS[self.split]
        for seed in np.unique(seeds).tolist():
            if seed not in split:
                raise InvalidInput(
                    f"scenario_seed = {seed} is not in split '{self.split}': {split.start} to {split.stop - 1}"
                )
        return np.broadcast_to(seeds, count).astype(np.int64)

    def start(self, machines: np.ndarray, seeds: np.ndarray) -> None:
        """Starts the episodes of these scenario seeds; the other machines are left alone."""
        if len(self.scenarios) == 1:
            which = np.zeros(len(machines), np.int64)
            self._prepare(0, machines, seeds)
        else:
            which = (mix(seeds, 7) % np.uint64(len(self.scenarios))).astype(np.int64)
            for index in np.unique(which).tolist():
                chosen = which == index
                self._prepare(index, machines[chosen], seeds[chosen])
        if self.control == "schedule":
            self.fleet.put_filter(machines, self.base.part("filter"))
        self.scenario_seeds[machines], self.scenario_of[machines] = seeds, which
        self.fleet.begin(machines, scenarios.noise_keys(seeds))
        self.left[machines], self.returns[machines] = self._steps[which], 0.0

    def _prepare(self, index: int, machines: np.ndarray, seeds: np.ndarray) -> None:
        again = bool((self._prepared[machines] == index).all())
        scenarios.prepare(self.fleet, self.scenarios[index], machines, seeds, again)
        self._prepared[machines] = index

    def restart(self, machines: np.ndarray) -> None:
        """Starts the next episodes of the machines' sequences."""
        self.start(machines, self.following_seeds(machines))

    def length(self, machine: int) -> int:
        """Periods of the machine's episode so far."""
        return int(self._steps[self.scenario_of[machine]] - self.left[machine])

    def scenario(self, machine: int) -> Scenario:
        """The scenario of the machine's episode."""
        return self.scenarios[int(self.scenario_of[machine])]

    # ------------------------------------------------------------------------------------------------- stepping

    def put_actions(self, actions: Any) -> None:
        """Takes the actions of the coming period.

        Raises:
            InvalidInput: wrong shape or type, or not finite.
        """
        array = np.asarray(actions)
        if array.shape != self.actions.shape:
            raise InvalidInput(f"the actions have shape {array.shape}; it must be {self.actions.shape}")
        if array.dtype.kind not in "fiu":
            raise InvalidInput(f"the actions are of type {array.dtype}; numbers are needed, float32 best")
        if not np.isfinite(array).all():
            bad = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
            raise InvalidInput(f"the action of environment {bad}, {array[bad]}, is not finite; allowed: -1 to 1")
        np.copyto(self.actions, array, casting="unsafe")


def _scenarios(scenario: Any, changes: dict[str, Any] | None) -> list[Scenario]:
    """One or several scenarios from what the user gave."""
    if isinstance(scenario, str) and scenario in scenarios.suites():
        found = list(scenarios.suite(scenario).values())
    elif isinstance(scenario, list | tuple):
        found = [scenarios.load(s) for s in scenario]
    else:
        found = [scenarios.load(scenario)]
    if not found:
        raise InvalidInput("scenario is an empty list; at least one is needed")
    return [s.varied(**changes) for s in found] if changes else found


def _weights(reward: dict[str, float] | None) -> Reward:
    for name, value in (reward or {}).items():
        if name not in Reward._fields:
            raise InvalidInput(f"unknown reward term '{name}'; {did_you_mean(name, Reward._fields)}")
        if not np.isfinite(value) or value < 0:
            raise InvalidInput(f"reward.{name} = {value} is out of range; allowed: 0 and up")
    return Reward()._replace(**(reward or {}))


def _observation_space(observation: str) -> gym.spaces.Box:
    if observation == "features":
        return gym.spaces.Box(-LIMIT, LIMIT, (len(FEATURES),), np.float32)
    n = RAW_HISTORY
    low = np.array([0.0] * 2 * n + [-200.0] * n + [-2000.0] * (n + 1) + [0.0] * 5, np.float32)
    high = np.array([10.1] * 2 * n + [200.0] * n + [2000.0] * (n + 1) + [10.0, 2000.0, 1.0, 1.0, 6.0], np.float32)
    return gym.spaces.Box(low, high, dtype=np.float32)
