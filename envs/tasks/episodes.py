"""Episodes of any number of machines behind one set of arrays: what every environment and vector environment is.

Machine ``i`` with the sequence seed ``s`` lives through the same episodes, bit for bit, in a batch of any size and in
the single environment.
"""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from .. import scenarios
from ..engine.deck import refuse_copy
from ..engine.lanes import mix
from ..engine.quantity import InvalidInput, did_you_mean
from ..plant.fleet import Fleet
from ..safety import files
from ..scenarios import Scenario


class Episodes:
    """What batches have in common: which scenario and seed each machine lives through, and how long.

    The arrays belong to the batch and change with every step: ``actions`` float32 (size, k); ``observations`` float32
    (size, d); ``rewards`` and their sums ``returns`` float64 (size,); ``infos`` float64 (len(INFO), size); ``left``
    float64 (size,), steps until the time is over; ``terminated`` and ``truncated`` bool (size,).
    """

    INFO: tuple[str, ...] = ()
    fleet: Fleet
    base: Any
    advance: Callable[[], Any]
    """One step of every machine."""

    def __init__(
        self,
        size: int,
        scenarios_: list[Scenario],
        split: str,
        steps: list[int],
        action_space: gym.spaces.Box,
        observation_space: gym.spaces.Box,
    ) -> None:
        self.size, self.scenarios, self.split = size, scenarios_, split
        self._steps = np.array(steps)
        self.action_space, self.observation_space = action_space, observation_space
        self.actions = np.zeros((size, *action_space.shape), np.float32)
        self.observations = np.zeros((size, *observation_space.shape), np.float32)
        self.rewards, self.returns, self.infos = np.zeros(size), np.zeros(size), np.zeros((len(self.INFO), size))
        self.left = np.zeros(size)
        self.terminated, self.truncated = np.zeros(size, bool), np.zeros(size, bool)
        self.scenario_seeds, self.scenario_of = np.zeros(size, np.int64), np.zeros(size, np.int64)
        self._prepared = np.full(size, -1, np.int64)  # index of the scenario whose physics the column holds
        self._sequence, self._episode = np.full(size, -1, np.int64), np.zeros(size, np.int64)

    def __reduce__(self) -> Any:
        refuse_copy(self)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays that stages read and write, by the names that these have for them."""
        names = "actions", "observations", "rewards", "returns", "infos", "left", "terminated", "truncated"
        return {name: getattr(self, name) for name in names}

    def prepare(self, index: int, machines: np.ndarray, seeds: np.ndarray, again: bool) -> None:
        """Writes scenario ``index`` into the columns of ``machines``; ``again``: they hold it already."""
        raise NotImplementedError

    def film(self, machine: int) -> Any:
        """What shows the episode of a machine that has just begun: ``take(fleet, machine)`` and ``frame()``."""
        raise NotImplementedError

    def prepared(self, machines: np.ndarray) -> None:
        """What else has to be written before an episode begins."""

    # ------------------------------------------------------------------------------------------------ episodes

    def has_sequence(self, machine: int) -> bool:
        """Whether the machine has got a sequence of episodes."""
        return bool(self._sequence[machine] >= 0)

    @property
    def begun(self) -> np.ndarray:
        """Episodes that each machine has begun in its sequence, shape (size,)."""
        return self._episode.copy()

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
        self.prepared(machines)
        self.scenario_seeds[machines], self.scenario_of[machines] = seeds, which
        self.fleet.begin(machines, scenarios.noise_keys(seeds))
        self.left[machines], self.returns[machines] = self._steps[which], 0.0

    def _prepare(self, index: int, machines: np.ndarray, seeds: np.ndarray) -> None:
        again = bool((self._prepared[machines] == index).all())
        self.prepare(index, machines, seeds, again)
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


def chosen(scenario: Any, changes: dict[str, Any] | None) -> list[Scenario]:
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


def check_render_mode(mode: str | None, allowed: list[str]) -> None:
    """Raises :class:`InvalidInput` for a way of rendering that does not exist."""
    if mode is not None and mode not in allowed:
        raise InvalidInput(f"unknown render_mode '{mode}'; {did_you_mean(str(mode), allowed)}")


def check_choice(value: str, allowed: Any, what: str) -> None:
    """Raises :class:`InvalidInput` for a word that is not one of those allowed."""
    if value not in allowed:
        raise InvalidInput(f"unknown {what} '{value}'; {did_you_mean(str(value), allowed)}")


def weights_of(reward: dict[str, float] | None, default: Any) -> Any:
    """The weights of a reward, ``default`` (a NamedTuple) with some changed.

    Raises:
        InvalidInput: unknown term, or a weight that is negative or not finite.
    """
    for name, value in (reward or {}).items():
        if name not in default._fields:
            raise InvalidInput(f"unknown reward term '{name}'; {did_you_mean(name, default._fields)}")
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not number or not 0 <= value < np.inf:
            raise InvalidInput(f"reward.{name} = {files.shown(value)} is out of range; allowed: 0 and up")
        if name == "tolerance" and value == 0:
            raise InvalidInput("reward.tolerance = 0 is out of range; allowed: above 0, in mm")
    return default._replace(**(reward or {}))
