"""What is searched of a training: the usual settings of its algorithm, in ranges around the shipped preset's."""

import math
from dataclasses import dataclass
from typing import Any

from ...agents.learner import NUM_ENVS
from ...agents.settings import Settings
from .space import Axis, Space

REST = "1 - "
"""Begins the name of an axis on which what is left to 1 is searched: a share near 1 counts by its distance to it."""


@dataclass(frozen=True)
class Knob:
    """A setting and the range in which it is searched.

    ``scale`` is ``log``; ``whole``; ``rest``, of which ``low`` and ``high`` are of 1 minus the setting; or ``times``,
    of which they are factors on the preset's whole number, powers of two.
    """

    key: str
    low: float
    high: float
    scale: str = "log"

    def axis(self, start: float) -> Axis:
        """The axis on which it is searched; ``start`` is the preset's value."""
        if self.scale == "rest":
            return Axis(REST + self.key, self.low, self.high, log=True)
        if self.scale == "times":  # half a step beyond the ends, which then come up as often as the rest
            low = max(self.low, 1.0 / start)
            return Axis(self.key, start * low / math.sqrt(2.0), start * self.high * math.sqrt(2.0), log=True)
        return Axis(self.key, self.low, self.high, whole=self.scale == "whole", log=self.scale == "log")

    def value(self, x: float, start: float) -> float | int:
        """The setting at ``x`` of the axis."""
        if self.scale == "whole":
            return int(x)
        if self.scale == "times":
            return max(1, round(start * 2.0 ** round(math.log2(x / start))))
        return round(1.0 - x, 5) if self.scale == "rest" else float(f"{x:.4g}")


EVERY = (
    Knob("algorithm.learning_rate", 1e-4, 1e-2),
    Knob("algorithm.gamma", 0.003, 0.2, "rest"),  # horizons of 5 to 330 periods
    Knob("policy.spread", 0.003, 0.5),
)
ON_POLICY = (
    Knob("algorithm.gae_lambda", 0.005, 0.4, "rest"),
    Knob("algorithm.n_steps", 0.25, 4.0, "times"),
    Knob("algorithm.batch_size", 0.25, 4.0, "times"),
    Knob("algorithm.n_epochs", 1, 15, "whole"),
    Knob("algorithm.clip_range", 0.05, 0.4),
    Knob("algorithm.ent_coef", 1e-6, 0.05),
)
OFF_POLICY = (
    Knob("algorithm.tau", 1e-3, 0.1),
    Knob("algorithm.batch_size", 0.25, 4.0, "times"),
    Knob("algorithm.train_freq", 1.0, 8.0, "times"),
    Knob("algorithm.gradient_steps", 0.25, 4.0, "times"),
)
KNOBS = {
    "ppo": (*EVERY, *ON_POLICY),
    "recurrent-ppo": (*EVERY, *ON_POLICY, Knob("policy.lstm_hidden_size", 0.5, 2.0, "times")),
    "sac": (*EVERY, *OFF_POLICY),
    "td3": (*EVERY, *OFF_POLICY, Knob("algorithm.noise", 0.01, 0.3)),
    "tqc": (*EVERY, *OFF_POLICY),
    "gradient": (
        Knob("algorithm.learning_rate", 3e-4, 1e-2),
        Knob("algorithm.horizon", 0.25, 2.0, "times"),
        Knob("algorithm.epochs", 1, 6, "whole"),
        Knob("algorithm.jitter", 0.01, 1.0),
    ),
}

NETWORK = "policy.net_arch"
NETWORKS = ([32, 32], [64], [64, 64], [128, 128])
"""Layers that are tried besides the preset's; larger ones take too long where a policy is deployed."""


@dataclass(frozen=True)
class Hyper:
    """The search space of a training, and where the shipped or given settings stand in it."""

    base: Settings

    @property
    def knobs(self) -> list[Knob]:
        """Numbers that are searched: those of which the settings have one, and one only (a spread for each action, or
        as many gradient steps as samples, stays).
        """
        return [knob for knob in KNOBS[self.base.name] if _number(self.base.value(knob.key), knob)]

    @property
    def networks(self) -> dict[str, list[int]]:
        """Layers by their word, the preset's first; empty if its network is not a list of layers."""
        mine = self.base.value(NETWORK)
        if not isinstance(mine, list) or not mine or not all(isinstance(n, int) for n in mine):
            return {}
        return {"×".join(map(str, layers)): layers for layers in (mine, *NETWORKS)}

    @property
    def space(self) -> Space:
        """Axes and start, as samplers take them."""
        axes, start = [], {}
        for knob in self.knobs:
            value = float(self.base.value(knob.key))
            axis = knob.axis(value)
            axes.append(axis)
            start[axis.name] = min(max(1.0 - value if knob.scale == "rest" else value, axis.low), axis.high)
        if words := tuple(self.networks):
            axes.append(Axis(NETWORK, 0.0, len(words) - 1.0, choices=words))
            start[NETWORK] = 0.0
        return Space(tuple(axes), start)

    def settings(self, params: dict[str, Any]) -> Settings:
        """The settings at a point of the space."""
        changes: dict[str, Any] = {}
        for knob in self.knobs:
            value = self.base.value(knob.key)
            changes[knob.key] = knob.value(params[knob.axis(float(value)).name], float(value))
        if networks := self.networks:
            changes[NETWORK] = networks[params[NETWORK]]
        last, rate = (f"algorithm.{name}" for name in ("final_learning_rate", "learning_rate"))
        if self.base.value(last) is not None:  # falls by as much as in the preset
            changes[last] = float(f"{changes[rate] * self.base.value(last) / self.base.value(rate):.4g}")
        if "algorithm.n_steps" in changes:  # a batch cannot be larger than what there is
            whole = changes["algorithm.n_steps"] * self.base.environment.get("num_envs", NUM_ENVS)
            changes["algorithm.batch_size"] = min(changes["algorithm.batch_size"], whole)
        return self.base.varied(changes)


def _number(value: Any, knob: Knob) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return False
    return isinstance(value, int) and value >= 1 if knob.scale == "times" else value >= 0
