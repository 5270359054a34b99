"""Any number of machines of a task behind one set of arrays: what every environment and vector environment is.

Machine ``i`` with the sequence seed ``s`` lives through the same episodes, bit for bit, in a batch of any size and in
the single environment.
"""

import warnings
from typing import Any

import gymnasium as gym
import numpy as np

from .. import scenarios
from ..control import stack as stacks
from ..engine.quantity import InvalidInput, check_choice
from ..pictures.kerf_picture import QUANTITIES
from . import workshop
from .episodes import Episodes, chosen, weights_of
from .interface import LARGEST_TRIM, LONGEST_WINDOW
from .task import Task

LONGEST = 3.0
"""Times the planned time of a job, after which an episode is over."""


class Batch(Episodes):
    """``size`` machines; the other arguments are those of the task's environment.

    The arrays belong to the batch and change with every step: ``actions`` float32 (size, k); ``observations`` float32
    (size, d); ``rewards`` and their sums ``returns`` float64 (size,); ``infos`` float64 (len(task.info), size);
    ``left`` float64 (size,), steps until the time is over; ``terminated`` and ``truncated`` bool (size,).
    ``advance()`` is one step of every machine.

    Raises:
        InvalidInput: unknown name, a number out of range, or a scenario that is not for this task.
    """

    actions: np.ndarray
    observations: np.ndarray
    rewards: np.ndarray
    returns: np.ndarray
    infos: np.ndarray
    left: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray

    def __init__(
        self,
        task: Task,
        size: int,
        scenario: Any = None,
        control: str = "residual",
        observation: str = "features",
        split: str = "train",
        reward: dict[str, float] | None = None,
        base: Any = None,
        machine: Any = None,
        path: str | None = None,
        extrapolate: bool = False,
        max_steps: int | None = None,
        colour: str = "standoff",
        threads: int = 1,
    ) -> None:
        check_choice(control, task.controls, "control")
        check_choice(observation, task.observations, "observation")
        check_choice(split, scenarios.SPLITS, "split")
        check_choice(colour, QUANTITIES, "colour")
        wanted = task.scenario if scenario is None else scenario
        found = [_fitting(task, each, path, extrapolate) for each in chosen(wanted, machine)]
        if max_steps is not None and max_steps < 1:
            raise InvalidInput(f"max_steps = {max_steps} is out of range; at least 1")
        self.task, self.control, self.observation, self.colour = task, control, observation, colour
        self.weights = weights_of(reward, task.reward)
        self.base = _base(task, "idle" if control == "direct" and not task.with_job else base or task.base)
        self.jobs = [workshop.programme(s, self.base) for s in found] if task.with_job else []
        for note in dict.fromkeys(note for job in self.jobs for note in job.warnings):
            warnings.warn(note, stacklevel=4)
        steps = [int(np.ceil(LONGEST * len(job.x) / task.period)) for job in self.jobs] or [s.steps for s in found]
        super().__init__(size, found, split, [min(n, max_steps or n) for n in steps])
        self.fleet = workshop.empty_fleet(size, self.base, threads)
        self.base.install(self.fleet, np.arange(size))
        act, observe, io = task.hook(self.fleet, control, observation, self.weights)
        self.fleet.hook(act, observe, io)
        self._changes_filter = control == "schedule" or (task.with_job and self.base.z.pilot is not None)
        if control == "schedule":
            self.fleet.widest_window(LONGEST_WINDOW, LARGEST_TRIM)
        for name in ("actions", "observations", "rewards", "returns", "infos", "left", "terminated", "truncated"):
            setattr(self, name, io.owned(name))
        seen, width = task.seen(observation, self.base.z.law), self.actions.shape[1]
        low, high = (np.broadcast_to(np.float32(end), len(seen.names)) for end in (seen.low, seen.high))
        self.action_space = gym.spaces.Box(-1.0, 1.0, (width,), np.float32)
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float32)
        self._prepared = np.full(size, -1)  # index of the scenario whose physics the column holds
        self._films: list[Any] = []
        self.advance = self.fleet.stepper(task.period)

    # ------------------------------------------------------------------------------------------------- episodes

    def start(self, machines: np.ndarray, seeds: np.ndarray) -> None:
        """Starts the episodes of these scenario seeds; the other machines are left alone."""
        which = self.meet(machines, seeds)
        for index in np.unique(which).tolist():
            mine = machines[which == index]
            again = bool((self._prepared[mine] == index).all())
            workshop.prepare(self.fleet, self.scenarios[index], self.base, mine, seeds[which == index], again)
            self._prepared[mine] = index
        if self._changes_filter:  # the last episode may have done so
            self.fleet.put_filter(machines, self.base.z.part("filter"))
        self.fleet.begin(machines, scenarios.noise_keys(seeds))
        self.left[machines], self.returns[machines] = self.longest[which], 0.0
        if self._films:
            for i in machines.tolist():
                seed = int(self.scenario_seeds[i])
                self._films[i] = workshop.film_of(self.scenario(i), self.base, seed, self.colour)
                self._films[i].take(self.fleet, i)

    def restart(self, machines: np.ndarray) -> None:
        """Starts the next episodes of the machines' sequences."""
        self.start(machines, self.following_seeds(machines))

    def reset(self, machines: np.ndarray, seed: Any, options: dict[str, Any], random: np.random.Generator) -> None:
        """Starts episodes as a user's ``reset`` asks for them, see :meth:`take_seeds` and :meth:`asked_seeds`."""
        self.take_seeds(machines, seed, random)
        seeds = self.following_seeds(machines)
        if options.get("scenario_seed") is not None:
            seeds = self.asked_seeds(options["scenario_seed"], len(machines))
        self.start(machines, seeds)

    def length(self, machine: int) -> int:
        """Decisions of the machine's episode so far."""
        return int(self.longest[self.scenario_of[machine]] - self.left[machine])

    def info(self, machine: int) -> dict[str, Any]:
        """What the task tells of a machine, by name."""
        return dict(zip(self.task.info, self.infos[:, machine].tolist(), strict=True))

    # ------------------------------------------------------------------------------------------------- pictures

    def keep_pictures(self) -> None:
        """From now on there is a :meth:`frame` of every machine whose episode has begun."""
        films = self._films = [None] * self.size
        advance, fleet = self.advance, self.fleet

        def filmed() -> None:
            advance()
            for i, film in enumerate(films):
                if film:
                    film.take(fleet, i)

        self.advance = filmed

    def frame(self, machine: int) -> np.ndarray | None:
        """A picture of a machine now, uint8 of shape (height, width, 3); None if none are kept."""
        film = self._films[machine] if self._films else None
        return film.frame() if film else None

    # ------------------------------------------------------------------------------------------------- stepping

    def put_actions(self, actions: Any) -> None:
        """Takes the actions of the coming step.

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


def _fitting(task: Task, scenario: scenarios.Scenario, path: str | None, extrapolate: bool) -> scenarios.Scenario:
    """The scenario as the task has it.

    Raises:
        InvalidInput: it is a job, or it is none.
    """
    if not task.with_job:
        if scenario.job:
            raise InvalidInput(
                f"scenario '{scenario.name}' is a job; kerfgym/ContourFollowing-v0 and kerfgym/Cutting-v0 do jobs"
            )
        return scenario
    if scenario.job is None:
        raise InvalidInput(f"scenario '{scenario.name}' has no job; this environment needs one with a table [job]")
    scenario = scenario if path is None else scenario.along(path)
    return scenario.varied(job={"extrapolate": True}) if extrapolate else scenario


def _base(task: Task, base: Any) -> stacks.Team:
    """What does what the action leaves open.

    Raises:
        InvalidInput: unknown, of another slot, not compiled, or a policy that moves what the action moves.
    """
    team = stacks.team(base) if task.with_job else stacks.asked(base)
    for stack in team.stacks:
        if stack.python is not None:
            raise InvalidInput(f"base controller '{stack.name}' is plain Python; a base must be a compiled law")
        if stack.slot not in task.slots:
            raise InvalidInput(f"base controller '{stack.name}' drives slot '{stack.slot}', not '{task.slot}'")
        if stack.pilot is not None and (stack.slot != "z" or not task.with_job):
            raise InvalidInput(f"base controller '{stack.name}' is a policy; it moves what the action moves")
    return team
