"""What a policy does differently: its actions over time, beside the sheet and what becomes of the gap.

The policy and the base that it acts on meet the same sheet, machine and noise. Of each period are kept the actions in
force, how much of them the policy keeps (:func:`agents.network.trusted`), and for weights what each of them adds to the
command: the law's own sum of signals, less the same without that action.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ...agents.compiled import Compiled
from ...agents.policy import bases
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.engine.deck import Deck
from ...envs.engine.lanes import rows, unflat
from ...envs.engine.quantity import InvalidInput
from ...envs.plant import machine
from ...envs.plant.controller import PERIOD
from ...envs.scenarios import Scenario
from ...envs.tasks.task import WEIGHTS
from ..measure import rollout

SCENARIOS = ("step", "wavy", "holes")
"""What is shown unless others are asked for."""

SHOWN, BEFORE = 0.35, 0.08
"""Seconds of each run that are drawn, and of them before what happens there."""

AT_ONCE = 0.5
"""Of the quickest change of a sheet, that makes a step of it."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Explained:
    """A policy and its base in one scenario; arrays are over the control periods.

    Attributes:
        scenario: its name.
        actions: (periods, actions), in force in each period, −1 to 1.
        trust: share of the actions that is kept; 1 within the range of training, 0 where the base acts alone.
        command: (periods,), mm/s, after the supervisor.
        sheet: mm; NaN where there is none below.
        error, base_error: true gap error of the policy and of its base, µm; NaN where there is no sheet.
        window: the periods that are drawn.
        effects: (periods, actions), mm/s that each action adds to the command; NaN outside of the window; None of
            controls without weights.
        plain: (periods,), mm/s, what the law alone, without actions, would command in the same moment, likewise.
        added: (periods,), mm/s, that all of them add.
    """

    scenario: str
    actions: Floats
    trust: Floats
    command: Floats
    sheet: Floats
    error: Floats
    base_error: Floats
    window: slice
    effects: Floats | None = None
    plain: Floats | None = None
    added: Floats | None = None

    @property
    def time(self) -> Floats:
        """ms, of the periods that are drawn, from the first of them."""
        return np.arange(self.window.stop - self.window.start) * PERIOD * 1e3

    @property
    def alone(self) -> bool:
        """Whether the base acts alone in all that is drawn."""
        return not (self.trust[self.window] > 0.0).any()


def policy_of(name: str) -> Stack:
    """A policy of a height follower by its name or folder.

    Raises:
        InvalidInput: no policy, or one that drives something else.
    """
    team = stacks.asked(name)
    found = [stack for stack in team.stacks if stack.slot == "z" and isinstance(stack.pilot, Compiled)]
    if not found:
        able = [each for each in stacks.shelved() if stacks.resolve(each).slot == "z"]
        raise InvalidInput(f"'{name}' is no policy that follows the height; shipped are {', '.join(able)}")
    return found[0]


def meanings(stack: Stack) -> list[str]:
    """What each action of a policy is, with what 1 stands for."""
    document = stack.pilot.policy.document  # type: ignore[union-attr]
    about, out = document.action, []
    for i, name in enumerate(about["names"]):
        unit = "" if about["units"][i] == "1" else f" {about['units'][i]}"
        if "at_one" not in about:
            out.append(name)
        elif "at_minus_one" in about:
            out.append(f"{name}: {about['at_minus_one'][i]:g} to {about['at_one'][i]:g}{unit}")
        else:
            out.append(f"{name}, ±{about['at_one'][i]:g}{unit}")
    return out


def explained(stack: Stack, scenario: Scenario, seed: int) -> Explained:
    """Both in one episode of a scenario."""
    assert isinstance(stack.pilot, Compiled)
    document = stack.pilot.policy.document
    base = bases(document, f"policy '{stack.name}'")["z"]
    seeds = np.array([seed], np.uint64)
    plain = rollout.roll(scenario, base, seeds)
    pilot, decks = stack.pilot, list[Deck]()
    fleet = rollout.fleet_for(scenario, replace(stack, pilot=None), seeds, change=lambda f: decks.append(pilot.fly(f)))
    io = decks[0]
    actions, trust = io.owned("environment").owned("actions"), io.owned("trust")
    kept = np.zeros((scenario.steps, actions.shape[1]))
    trusts, knows, weighs = np.ones(scenario.steps), io["known"] > 0, document.control == WEIGHTS
    moments: list[tuple[Any, Any, list[float]]] = []
    law = stack.law

    def before(period: int) -> None:
        kept[period] = actions[0]
        trusts[period] = max(float(trust[0]), 0.0) if knows else 1.0
        if weighs:
            signals = unflat(law.signals, fleet.slots(machine.SIGNALS, len(law.signals._fields)).tolist())
            state = fleet.slots(machine.S_LAW, rows(law.State)).tolist()
            moments.append((signals, unflat(law.State, state), fleet.memories[0].tolist()))

    run = rollout.run(fleet, scenario, stack, seeds, before)
    over = run["scored"][:, 0] > 0.5
    sheet = np.where(over, run["surface"][:, 0], np.nan).astype(float)
    error, base_error = (
        np.where(each["scored"][:, 0] > 0.5, 1e3 * each.error[:, 0], np.nan).astype(float) for each in (run, plain)
    )
    window = _window(sheet, over, scenario.settle_steps)
    effects = alone = added = None
    if weighs and law.weighing:
        of_moment = _effects(law, stack.part("law"))
        found = np.full((scenario.steps, kept.shape[1] + 2), np.nan)
        for period in range(window.start, window.stop):
            found[period] = of_moment(*moments[period])
        effects, alone, added = found[:, :-2], found[:, -2], found[:, -1]
    command = run["command"][:, 0].astype(float)
    return Explained(scenario.name, kept, trusts, command, sheet, error, base_error, window, effects, alone, added)


def largest(found: Iterable[Explained], most: int) -> list[int]:
    """The actions that add most to the command in what is drawn, or where that is not known are largest, RMS; most
    first. Without those that are never anything but 0."""
    parts = [(e.actions if e.effects is None else e.effects)[e.window] for e in found]
    size = np.sqrt(np.nanmean(np.concatenate(parts) ** 2, axis=0))
    return [int(i) for i in np.argsort(-size, kind="stable")[:most] if size[i] > 0.0]


# ------------------------------------------------------------------------------------------------------------------


def _effects(law: Any, params: Any) -> Callable[[Any, Any, list[float]], list[float]]:
    """A function that gives, of one moment, what each action adds to the command, what it is without
    them, and what all of them together add."""
    weighing = law.weighing
    first, many = weighing.action, len(weighing.weights)

    def of_moment(signals: Any, state: Any, memory: list[float]) -> list[float]:
        whole, out = weighing.weigh(params, state, signals, memory), []
        for k in range(first, first + many):
            own, memory[k] = memory[k], 0.0
            out.append(whole - weighing.weigh(params, state, signals, memory) if own else 0.0)
            memory[k] = own
        bare = [*memory[:first], *[0.0] * many, *memory[first + many :]]
        alone = weighing.weigh(params, state, signals, bare)
        return [*out, alone, whole - alone]

    return of_moment


def _window(sheet: Floats, over: npt.NDArray[np.bool_], settle: int) -> slice:
    """The first hole after the settling time, else the first step, else what follows that time."""
    shown, ahead = round(SHOWN / PERIOD), round(BEFORE / PERIOD)
    first = settle + ahead
    holes = np.flatnonzero(~over[first:])
    jumps = np.abs(np.diff(sheet[first:], prepend=sheet[first]))
    most = np.max(jumps, initial=0.0, where=np.isfinite(jumps))
    found = holes if len(holes) else np.flatnonzero((jumps > AT_ONCE * most) & (most > 0.0))
    start = min(settle + (int(found[0]) if len(found) else 0), max(len(sheet) - shown, 0))
    return slice(start, min(start + shown, len(sheet)))
