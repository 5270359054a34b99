"""A task: what an environment decides, sees and earns, declared once.

Environment, batch, vector environment, VecEnv and policy artefact read it; there is no other place that knows how the
three environments differ. :data:`TASKS` in :mod:`all_tasks` lists them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..control import stack as stacks
from ..engine.deck import Deck, places
from ..engine.lanes import U, doubles, flags, part
from ..engine.quantity import InvalidInput
from ..plant.controller import SLOTS, Law, Weighing, stage_address
from ..plant.fleet import Fleet

OBSERVATIONS = ("features", "raw", "sheet")
"""Normalised and bounded; in the signals' own units; what the base controller's law says of the sheet, normalised."""

LIMIT = 10.0
"""Bound of every normalised feature."""

SHEET = OBSERVATIONS[2]

WEIGHTS = "weights"
"""The control by which actions are weights of the signals of the base controller's law."""


class Actions(NamedTuple):
    """What the actions of a control mean; each goes from −1 to 1."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    at_one: tuple[float, ...] | None = None  # None: it depends on the machine
    at_minus_one: tuple[float, ...] | None = None  # None: the opposite

    def document(self) -> dict[str, Any]:
        """As a policy's document holds it."""
        said = {key: list(value) for key, value in self._asdict().items() if value is not None}
        return {"shape": [len(self.names)], "low": -1.0, "high": 1.0, **said}


class Signals(NamedTuple):
    """What a kind of observation holds, in order, and its bounds: one for all signals or one for each."""

    names: tuple[str, ...]
    low: Any
    high: Any


@dataclass(frozen=True)
class Task:
    """One kind of environment.

    Attributes:
        id: of the environment in Gymnasium.
        name: in file names.
        slot: that a policy fills as a controller; its bases in the others come with it.
        period: control periods of 1 ms from decision to decision.
        scenario, base: unless the user names others.
        actions: by control, those that do not depend on the base.
        features, raw: what is observed, where it does not depend on the base.
        scaling: how signals become features, as a policy's document says it.
        info: names of what ``info`` holds, in order.
        reward: default weights of its terms, a NamedTuple.
        act, observe: the compiled stages before and after a decision.
        memory: numbers that the features remember of each machine.
        number: by which stages that serve several tasks tell them apart.
        objectives: entries of ``info`` that make the vector of objectives.
        with_job: whether its machines have axes and a cut, and do jobs.
        put_weights: gives the compiled stage by which actions become weights of a law's signals; None: there is no
            ``control="weights"`` and no ``observation="sheet"``.
    """

    id: str
    name: str
    slot: str
    period: int
    scenario: str
    base: str
    actions: dict[str, Actions]
    features: Signals
    raw: Signals
    scaling: dict[str, Any]
    info: tuple[str, ...]
    reward: Any
    act: Callable[..., None]
    observe: Callable[..., None]
    memory: int = 0
    number: int = 0
    objectives: tuple[str, ...] = ()
    with_job: bool = True
    put_weights: Callable[[Law], int] | None = None

    @property
    def slots(self) -> tuple[str, ...]:
        """What its base drives."""
        return tuple(SLOTS) if self.with_job else (self.slot,)

    @property
    def controls(self) -> tuple[str, ...]:
        """What ``control`` may be."""
        return (*self.actions, WEIGHTS) if self.put_weights else tuple(self.actions)

    @property
    def observations(self) -> tuple[str, ...]:
        """What ``observation`` may be."""
        return OBSERVATIONS if self.put_weights else OBSERVATIONS[:2]

    def decided(self, control: str, law: Law | None) -> Actions:
        """What actions mean, by the control and the law of the base.

        Raises:
            InvalidInput: the law has no weights.
        """
        if control != WEIGHTS:
            return self.actions[control]
        weights = _weighing(law, f"control '{control}'").weights
        return Actions(*(tuple(each) for each in zip(*((w.name, w.unit, w.span) for w in weights), strict=True)))

    def seen(self, observation: str, law: Law | None) -> Signals:
        """What is observed, by the kind of observation and the law of the base.

        Raises:
            InvalidInput: the law does not tell what it sees.
        """
        if observation == SHEET:
            return Signals(_weighing(law, f"observation '{observation}'").features, -LIMIT, LIMIT)
        return self.features if observation == "features" else self.raw

    def hook(self, fleet: Fleet, control: str, observation: str, weights: Any = None) -> tuple[int, int, Deck]:
        """The stages and a new deck for the machines of a fleet, which has its gantries and its law already."""
        n, law = fleet.size, fleet.law
        size, width = len(self.seen(observation, law).names), len(self.decided(control, law).names)
        act = stage_address(self.act, __file__)
        if self.put_weights and control == WEIGHTS:
            act = self.put_weights(law)
        io = Deck(
            Io,
            actions=np.zeros((n, width), np.float32),
            observations=np.zeros((n, size), np.float32),
            rewards=np.zeros(n),
            returns=np.zeros(n),
            infos=np.zeros((len(self.info), n)),
            weights=np.array(weights or self.reward),
            task=self.number,
            control=self.controls.index(control),
            observation=OBSERVATIONS.index(observation),
            size=size,
            width=width,
            machines=n,
            left=np.zeros(n),
            terminated=np.zeros(n, bool),
            truncated=np.zeros(n, bool),
            memory=np.zeros((self.memory, n)),
            gantry=fleet.gantries.deck if fleet.gantries else None,
            memories=fleet.memories,
            memory_size=law.memory,
        )
        return act, stage_address(self.observe, __file__), io


def _weighing(law: Law | None, what: str) -> Weighing:
    if law is None or law.weighing is None:
        able = [name for name in stacks.names() if stacks.get(name).law.weighing]
        raise InvalidInput(f"{what} needs a base that says what it weighs: {', '.join(able) or 'one of yours'}")
    return law.weighing


class Io(NamedTuple):
    """The stages' deck: a batch's arrays, and what they hold."""

    actions: int  # float32, (machines, width)
    observations: int  # float32, (machines, size)
    rewards: int  # float64, (machines,)
    returns: int  # float64, (machines,), sums of the rewards of the episodes
    infos: int  # float64, (len(info), machines)
    weights: int  # float64, (terms,)
    task: int
    control: int
    observation: int  # of OBSERVATIONS
    size: int
    width: int
    machines: int
    left: int  # float64, (machines,), decisions until the time is over
    terminated: int  # bool, (machines,)
    truncated: int  # bool, (machines,)
    memory: int  # float64, (memory, machines)
    gantry: int  # the gantries' deck, of machines that do jobs
    memories: int  # float64, (machines, memory_size), of the law in slot z
    memory_size: int


IO, ANY = places(Io), U(2**40)
IO_SIZE = U(len(Io._fields))


@part
def end(io, first, lane, reward, over):
    """A machine's reward, and whether its episode is over: by what happened, or because the time is."""
    i = first + lane
    rewards, returns, left = doubles(io[IO.rewards], ANY), doubles(io[IO.returns], ANY), doubles(io[IO.left], ANY)
    terminated, truncated = flags(io[IO.terminated], ANY), flags(io[IO.truncated], ANY)
    rewards[i] = reward
    returns[i] += reward
    left[i] -= 1.0
    terminated[i] = np.uint8(1) if over else np.uint8(0)
    truncated[i] = np.uint8(1) if left[i] <= 0.0 and not over else np.uint8(0)
