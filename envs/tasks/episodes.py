"""Which scenario and seed each of a batch's machines lives through, and what users may ask for."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from .. import scenarios
from ..engine.deck import refuse_copy
from ..engine.lanes import mix
from ..engine.quantity import InvalidInput, check_choice
from ..safety import files
from ..scenarios import Scenario, machines


class Episodes:
    """What a batch knows of its machines' episodes.

    Args:
        size: machines.
        found: scenarios; each episode has one of them.
        split: of the scenario seeds.
        longest: steps of an episode of each scenario.
    """

    def __init__(self, size: int, found: list[Scenario], split: str, longest: list[int]) -> None:
        self.size, self.scenarios, self.split, self.longest = size, found, split, np.array(longest)
        self.scenario_seeds, self.scenario_of = np.zeros(size, np.int64), np.zeros(size, np.int64)
        self._sequence, self._episode = np.full(size, -1, np.int64), np.zeros(size, np.int64)

    def __reduce__(self) -> Any:
        refuse_copy(self)

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

    def take_seeds(self, machines: np.ndarray, seed: Any, random: np.random.Generator) -> None:
        """Gives machines the sequences of episodes that ``seed`` asks for; those without any get a random one.

        Args:
            machines: indices, shape (n,).
            seed: a whole number ``s``, which stands for ``s + i``; or one for each machine of the batch, None: it goes
                on with the present sequence.
            random: where random ones come from.

        Raises:
            InvalidInput: not as many seeds as environments, or one that is not a whole number from 0 on.
        """
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + i for i in range(self.size)]
        else:
            seeds = list(seed)
            if len(seeds) != self.size:
                raise InvalidInput(f"{len(seeds)} seeds for {self.size} environments; one for each")
        for i in machines.tolist():
            given = seeds[i]
            if given is not None and (not isinstance(given, int | np.integer) or given < 0):
                raise InvalidInput(f"seed {given!r} of environment {i}: a whole number from 0 on")
            if given is not None or self._sequence[i] < 0:
                self.sequence(i, int(random.integers(2**31)) if given is None else int(given))

    def meet(self, machines: np.ndarray, seeds: np.ndarray) -> np.ndarray:
        """Notes that episodes of these scenario seeds begin; returns the index of each one's scenario."""
        which = (mix(seeds, 7) % np.uint64(len(self.scenarios))).astype(np.int64)
        self.scenario_seeds[machines], self.scenario_of[machines] = seeds, which
        return which

    def scenario(self, machine: int) -> Scenario:
        """The scenario of the machine's episode."""
        return self.scenarios[int(self.scenario_of[machine])]


def chosen(scenario: Any, machine: Any) -> list[Scenario]:
    """One or several scenarios from what the user gave.

    Args:
        scenario: a scenario, a suite (its name or its folder), or a list of either.
        machine: what :func:`machines.load` takes, for them to be put on; or tables without a name, which change
            what the scenarios say. None: as the scenarios say.
    """
    found = [each for one in (scenario if isinstance(scenario, list | tuple) else [scenario]) for each in _each(one)]
    if not found:
        raise InvalidInput("scenario is an empty list; at least one is needed")
    if machine is None or machine == {}:
        return found
    if isinstance(machine, dict) and "name" not in machine:
        return [s.varied(**machine) for s in found]
    cuts = machines.load(machine)
    for warning in machines.warnings(found, cuts):
        warnings.warn(warning, stacklevel=6)
    return [machines.put_on(s, cuts) for s in found]


def _each(scenario: Any) -> list[Scenario]:
    if isinstance(scenario, str | Path) and (str(scenario) in scenarios.suites() or scenarios.is_own(scenario)):
        return list(scenarios.suite(str(scenario)).values())
    return [scenarios.load(scenario)]


def check_render_mode(mode: str | None, allowed: list[str]) -> None:
    """Raises :class:`InvalidInput` for a way of rendering that does not exist."""
    if mode is not None:
        check_choice(mode, allowed, "render_mode")


def check_options(options: dict[str, Any] | None, *allowed: str) -> dict[str, Any]:
    """The options of a ``reset``; raises :class:`InvalidInput` for one that does not exist."""
    for key in options or {}:
        check_choice(key, allowed, "option")
    return options or {}


def weights_of(reward: dict[str, float] | None, default: Any) -> Any:
    """The weights of a reward, ``default`` (a NamedTuple) with some changed.

    Raises:
        InvalidInput: unknown term, or a weight that is negative or not finite.
    """
    for name, value in (reward or {}).items():
        check_choice(name, default._fields, "reward term")
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not number or not 0 <= value < np.inf:
            raise InvalidInput(f"reward.{name} = {files.shown(value)} is out of range; allowed: 0 and up")
        if name == "tolerance" and value == 0:
            raise InvalidInput("reward.tolerance = 0 is out of range; allowed: above 0, in mm")
    return default._replace(**(reward or {}))
