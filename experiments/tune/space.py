"""What is searched: from a user's words to axes, and from points on the axes to parameters of a controller."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...agents.settings import ALGORITHMS
from ...envs.control.stack import Parameter, Team
from ...envs.engine.quantity import InvalidInput, Quantity, did_you_mean
from ...envs.plant.filters import KINDS

GROUPS = ("filter", "law", "guard", "gate", "table", "plan")
ALL = ("filter", "law", "guard", "plan")
"""Groups that ``all`` stands for; how the sensor is gated and calibrated is left as it is."""

READS = {
    "none": (), "mean": ("window",), "improved": ("window", "trim"), "weighted": ("window", "ratio"),
    "median": ("window",), "lag": ("tau",), "anti-impulse": ("jump", "hold"), "kalman": ("trust",),
}  # fmt: skip
"""Settings that each kind of filter reads; the others are not asked for while it is chosen."""

assert set(READS) == set(KINDS)

READ = "read"
"""Group of the settings that the controller's own kind of filter reads."""

NARROW = {
    "filter.window": (1.0, 15.0),
    "filter.trim": (0.0, 7.0),
    "filter.hold": (0.0, 10.0),
    "filter.tau": (0.0, 20.0),
    "filter.jump": (0.005, 0.5),
}
"""Ranges searched unless told otherwise, where the declared ones go far beyond what a height follower can use."""


@dataclass(frozen=True)
class Axis:
    """One searched parameter: its range, and how it is spread over 0 to 1."""

    name: str
    low: float
    high: float
    whole: bool = False
    log: bool = False
    choices: tuple[str, ...] = ()

    def encode(self, value: float) -> float:
        """``value`` on the scale from 0 to 1."""
        if self.whole:
            return (value - self.low + 0.5) / (self.high - self.low + 1.0)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def decode(self, x: float) -> float:
        """The value at ``x``, 0 to 1."""
        if self.whole:
            return float(min(self.high, math.floor(self.low + x * (self.high - self.low + 1.0))))
        if self.log:
            return float(np.clip(self.low * (self.high / self.low) ** x, self.low, self.high))
        return float(self.low + x * (self.high - self.low))

    @property
    def words(self) -> str:
        """Name and range, as a digest and a reader take it."""
        if self.choices:
            return f"{self.name}={'|'.join(self.choices)}"
        marks = (" whole" if self.whole else "") + (" log" if self.log else "")
        return f"{self.name}={self.low:g}..{self.high:g}{marks}"


@dataclass(frozen=True)
class Space:
    """Axes, and where each stands in the controller as it is."""

    axes: tuple[Axis, ...]
    start: dict[str, float]
    ties: dict[str, str] = field(default_factory=dict)  # what always has the value of another

    @property
    def conditional(self) -> bool:
        """Whether some axes count only for some choices."""
        return any(axis.choices for axis in self.axes)

    def active(self, chosen: dict[str, Any]) -> list[Axis]:
        """The axes that count, given the choices made: a filter's settings only for the kinds that read them."""
        kinds = {name.rpartition(".")[0]: value for name, value in chosen.items() if name.endswith("filter.kind")}

        def counts(axis: Axis) -> bool:
            group, _, setting = axis.name.rpartition(".")
            if group not in kinds or setting == "kind":
                return True
            return setting in READS[kinds[group]]

        return [axis for axis in self.axes if counts(axis)]

    def suggest(self, trial: Any) -> dict[str, Any]:
        """A candidate from an optuna trial: choices first, then the numbers that they leave to choose."""
        chosen: dict[str, Any] = {}
        for axis in sorted(self.axes, key=lambda a: not a.choices):
            if axis.choices:
                chosen[axis.name] = trial.suggest_categorical(axis.name, list(axis.choices))
        for axis in self.active(chosen):
            if axis.choices:
                continue
            if axis.whole:
                chosen[axis.name] = trial.suggest_int(axis.name, int(axis.low), int(axis.high))
            else:
                chosen[axis.name] = trial.suggest_float(axis.name, axis.low, axis.high, log=axis.log)
        return chosen

    def values(self, params: dict[str, Any], digits: int = 5) -> dict[str, Any]:
        """Parameters of the controller from those of a trial: rounded, and a trim that leaves something over; with 0
        digits as they are."""
        params = params | {name: params[other] for name, other in self.ties.items()}
        if not digits:
            return {k: v if isinstance(v, str) else float(v) for k, v in params.items()}
        out = {k: v if isinstance(v, str) else float(f"{float(v):.{digits}g}") for k, v in params.items()}
        for axis in self.axes:
            if not axis.choices and not axis.whole and axis.name in out:
                out[axis.name] = min(max(out[axis.name], axis.low), axis.high)
        for name in [n for n in out if n.endswith("filter.trim")]:
            window = self.start.get(name.replace("trim", "window"), 64)
            window = float(out.get(name.replace(".trim", ".window"), window))
            out[name] = min(float(out[name]), float((int(window) - 1) // 2))
        return out


def read(known: dict[str, Parameter]) -> list[str]:
    """Settings that the kind of filter reads which a controller has."""
    kinds = {name: KINDS[int(p.value)] for name, p in known.items() if name.endswith("filter.kind")}
    return [f"{name.removesuffix('kind')}{setting}" for name, kind in kinds.items() for setting in READS[kind]]


def unread(axes: Space, known: dict[str, Parameter]) -> list[str]:
    """Settings that are searched although the filter does not read them, in sentences; its kind is not searched."""
    out = []
    for name, p in known.items():
        own = name.removesuffix("kind")
        if not name.endswith("filter.kind") or any(axis.name == name for axis in axes.axes):
            continue
        kind = KINDS[int(p.value)]
        settings = [axis.name for axis in axes.axes if axis.name.startswith(own)]
        if idle := [each for each in settings if each.removeprefix(own) not in READS[kind]]:
            reads = f"reads {', '.join(own + each for each in READS[kind])}" if READS[kind] else "has no settings"
            out.append(
                f"{', '.join(idle)} changes nothing: a filter of the kind {kind} {reads}; 'read' searches what it reads"
            )
    return out


def space(controller: Team, words: Iterable[str]) -> Space:
    """The space that ``words`` mean: groups (filter, law, guard …), ``all``, ``read`` (what the filter's kind reads),
    and names with or without a range.

    ``law.kp`` is searched over its declared range, ``law.kp=20..120`` over this one; ``law.y=law.x`` has no value of
    its own.

    Raises:
        InvalidInput: unknown word (the nearest is offered), or a range beyond the declared one.
    """
    known = controller.parameters()
    groups = {group: [n for n in known if n.split(".")[-2] == group] for group in GROUPS}
    groups = {group: names for group, names in groups.items() if names}
    if groups.get("filter"):
        groups[READ] = read(known)
    groups["all"] = [n for group in ALL for n in groups.get(group, [])]
    ranges: dict[str, tuple[float, float] | None] = {}
    ties: dict[str, str] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if name in groups and not equals:
            ranges.update({n: ranges.get(n) for n in groups[name]})
        elif name in known and text in known:
            ties[name] = text
        elif name in known:
            ranges[name] = _range(text, known[name], word) if equals else ranges.get(name)
        else:
            raise InvalidInput(
                f"controller '{controller.name}': nothing called '{name}' to tune; "
                f"{did_you_mean(name, [*groups, *known, *ALGORITHMS])}"
            )
    if not ranges:
        raise InvalidInput(f"nothing to tune; known: {', '.join([*groups, *known])}")
    if loose := [f"{name}={other}" for name, other in ties.items() if name in ranges or other not in ranges]:
        raise InvalidInput(f"'{loose[0]}': the first is searched, too, or the second is not")
    axes = tuple(_axis(name, known[name], limits) for name, limits in ranges.items())
    start = {a.name: _inside(a, known[a.name].value) for a in axes}
    start |= {n: p.value for n, p in known.items() if n.endswith("filter.window") and n not in start}
    return Space(axes, start, ties)


def start_of(axes: Space) -> dict[str, Any]:
    """The controller as it stands, as parameters of a trial."""
    chosen = {a.name: a.choices[int(axes.start[a.name])] for a in axes.axes if a.choices}
    return {**chosen, **numbers_of(axes, chosen)}


def numbers_of(axes: Space, chosen: dict[str, str]) -> dict[str, float]:
    """The numbers of the controller as it stands that count, given these choices."""
    active = [a for a in axes.active(chosen) if not a.choices]
    return {a.name: int(axes.start[a.name]) if a.whole else float(axes.start[a.name]) for a in active}


def _axis(name: str, parameter: Parameter, limits: tuple[float, float] | None) -> Axis:
    q: Quantity = parameter.quantity
    if q.choices:
        return Axis(name, 0.0, len(q.choices) - 1.0, choices=q.choices)
    narrow = next((r for end, r in NARROW.items() if name.endswith(end)), (q.low, q.high))
    low, high = limits or (max(q.low, min(narrow[0], parameter.value)), min(q.high, max(narrow[1], parameter.value)))
    return Axis(name, float(low), float(high), q.whole, q.log and low > 0)


def _range(text: str, parameter: Parameter, word: str) -> tuple[float, float]:
    q = parameter.quantity
    low, dots, high = text.partition("..")
    if not dots or q.choices:
        raise InvalidInput(f"'{word}': a range is written {parameter.name}=LOW..HIGH; allowed: {q.range}")
    ends = q.check(low, parameter.name), q.check(high, parameter.name)
    if ends[0] >= ends[1]:
        raise InvalidInput(f"'{word}': the range is empty; allowed: {q.range}")
    return ends


def _inside(axis: Axis, value: float) -> float:
    return value if axis.choices else min(max(value, axis.low), axis.high)
