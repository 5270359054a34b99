"""A policy's network in NumPy: normaliser, frame stack, layers, output; nothing else is needed to run it.

Sums are taken in single precision in a fixed order (the bias, then input by input), and tanh and the logistic function
by one formula of sums, products and a quotient in double precision, so that the compiled network
(:mod:`agents.compiled`) computes the same bits. A matrix product of a library would add up in another order on each
processor.
"""

from typing import Any, NamedTuple

import numpy as np

ACTIVATIONS = ("none", "tanh", "relu")
OUTPUTS = ("clip", "tanh")
"""What makes an action in −1 … 1 of the last layer's output."""

LOG2E, LN2_HIGH, LN2_LOW = 1.4426950408889634, 0.6931471803691238, 1.9082149292705877e-10
SERIES = tuple(1.0 / x for x in (1, 1, 2, 6, 24, 120, 720, 5040, 40320, 362880, 3628800, 39916800, 479001600))
"""Of e^x; twelve terms are exact to 1e-15 for |x| ≤ ln(2)/2."""


FALL, RISE = np.float32(0.05), np.float32(0.005)
"""By how much trust changes in a decision at most: it is lost within 20 of them, and is back in 200."""

UNKNOWN = np.float32(-1.0)
"""Trust before an episode's first decision."""


REMEMBER = ("lstm", "gru")
"""Kinds of layers with memory: four gates from what they take and what they gave."""


class Layer(NamedTuple):
    """``linear``: activation(weight·x + bias), weight (outputs, inputs). ``lstm``: weight (4·hidden, inputs + hidden)
    of the gates input, forget, cell, output, as in :class:`torch.nn.LSTM`, whose two biases are added up. ``gru``: the
    same shape, of the gates reset, update, and of the candidate's share of what it takes and of what it gave, as in
    :class:`torch.nn.GRU`; in each of the last two the weights of the other are 0."""

    kind: str
    weight: np.ndarray
    bias: np.ndarray
    activation: str = "none"

    @property
    def outputs(self) -> int:
        """Numbers that it gives."""
        return len(self.bias) // 4 if self.kind in REMEMBER else len(self.bias)

    @property
    def inputs(self) -> int:
        """Numbers that it takes."""
        return self.weight.shape[1] - (self.outputs if self.kind in REMEMBER else 0)


class Normaliser(NamedTuple):
    """(x − mean)/scale, limited to ±clip, in double precision; of each observation, or of all frames if as many."""

    mean: np.ndarray
    scale: np.ndarray
    clip: float


class Known(NamedTuple):
    """Where a policy was trained: bounds of some of the numbers of an observation, single precision, shape (k,)."""

    which: np.ndarray  # of the observation's numbers
    low: np.ndarray
    high: np.ndarray
    margin: np.ndarray  # beyond the bounds, until nothing is left of the action


class Network(NamedTuple):
    """Everything between an observation of ``size`` numbers and an action."""

    size: int
    frames: int  # newest last; those before an episode are 0
    normaliser: Normaliser | None
    layers: tuple[Layer, ...]
    output: str  # one of OUTPUTS
    known: Known | None = None

    @property
    def actions(self) -> int:
        """Numbers of an action."""
        return self.layers[-1].outputs

    @property
    def normalises_frames(self) -> bool:
        """Whether the normaliser comes behind the frame stack."""
        return self.normaliser is not None and self.frames > 1 and len(self.normaliser.mean) > self.size


class Memory:
    """What the network keeps of ``count`` machines from step to step: frames, and state of layers with memory."""

    def __init__(self, network: Network, count: int) -> None:
        self.frames = np.zeros((count, network.frames * network.size), np.float32)
        self.trust = np.full((count, 1), UNKNOWN)
        widths = [layer.outputs if layer.kind in REMEMBER else 0 for layer in network.layers]
        self.hidden = [np.zeros((count, n), np.float32) for n in widths]
        self.cell = [np.zeros((count, n), np.float32) for n in widths]  # of LSTMs alone

    def forget(self, which: Any) -> None:
        """Episodes begin: nothing is known."""
        for array in (self.frames, *self.hidden, *self.cell):
            array[which] = 0.0
        self.trust[which] = UNKNOWN


def exponential(x: np.ndarray) -> np.ndarray:
    """e^x, double precision, |x| < 700."""
    k = np.rint(x * LOG2E)
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    p = np.full_like(r, SERIES[-1])
    for c in SERIES[-2::-1]:
        p = p * r + c
    return np.ldexp(p, k.astype(np.int64))


def tanh(x: np.ndarray) -> np.ndarray:
    """Single precision in and out; 1 − 2/(e^(2x) + 1)."""
    y = np.minimum(np.maximum(x.astype(np.float64), -20.0), 20.0)
    return (1.0 - 2.0 / (exponential(2.0 * y) + 1.0)).astype(np.float32)


def logistic(x: np.ndarray) -> np.ndarray:
    """Single precision in and out; 1/(1 + e^(−x))."""
    y = np.minimum(np.maximum(x.astype(np.float64), -80.0), 80.0)
    return (1.0 / (1.0 + exponential(-y))).astype(np.float32)


def linear(weight: np.ndarray, bias: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Sums in a fixed order; x (count, inputs), single precision."""
    if len(x) <= 4:
        terms = np.empty((len(x), 1 + x.shape[1], len(bias)), np.float32)
        terms[:, 0] = bias
        np.multiply(x[:, :, None], weight.T[None], out=terms[:, 1:])
        return np.add.accumulate(terms, axis=1)[:, -1]
    out = np.repeat(bias[None], len(x), axis=0)
    for i, column in enumerate(weight.T):
        out += x[:, i, None] * column
    return out


def normalised(normaliser: Normaliser, x: np.ndarray) -> np.ndarray:
    """An observation as the first layer reads it."""
    y = (x.astype(np.float64) - normaliser.mean) / normaliser.scale
    return np.minimum(np.maximum(y, -normaliser.clip), normaliser.clip).astype(np.float32)


def trusted(known: Known, before: np.ndarray, observations: np.ndarray) -> np.ndarray:
    """How much of its action a policy keeps, 0 to 1, single precision, shape (count, 1).

    All of it within its range, nothing a margin or more beyond, linearly between; and since it moves slowly, the base
    takes over without a bump.

    Args:
        known: the range.
        before: trust at the decision before.
        observations: single precision, (count, size).
    """
    x, one = observations[:, known.which], np.float32(1.0)
    beyond = (np.maximum(known.low - x, x - known.high) / known.margin).max(axis=1, keepdims=True)
    wanted = one - np.minimum(np.maximum(beyond, np.float32(0.0)), one)
    return np.where(before < 0, wanted, before + np.minimum(np.maximum(wanted - before, -FALL), RISE))


def run(network: Network, memory: Memory, observations: np.ndarray) -> np.ndarray:
    """Actions in −1 … 1, float32 (count, actions), for observations (count, size); the memory moves on by a step."""
    x = np.asarray(observations, np.float32)
    if network.normaliser and not network.normalises_frames:
        x = normalised(network.normaliser, x)
    if network.frames > 1:
        memory.frames[:, : -network.size] = memory.frames[:, network.size :]
        memory.frames[:, -network.size :] = x
        x = memory.frames
    if network.normaliser and network.normalises_frames:
        x = normalised(network.normaliser, x)
    for i, layer in enumerate(network.layers):
        if layer.kind == "lstm":
            gates = linear(layer.weight, layer.bias, np.concatenate([x, memory.hidden[i]], axis=1))
            enter, forget, candidate, out = np.split(gates, 4, axis=1)
            memory.cell[i] = logistic(forget) * memory.cell[i] + logistic(enter) * tanh(candidate)
            memory.hidden[i] = x = logistic(out) * tanh(memory.cell[i])
        elif layer.kind == "gru":
            gates = linear(layer.weight, layer.bias, np.concatenate([x, memory.hidden[i]], axis=1))
            reset, update, taken, given = np.split(gates, 4, axis=1)
            candidate = tanh(taken + logistic(reset) * given)
            memory.hidden[i] = x = candidate + logistic(update) * (memory.hidden[i] - candidate)
        else:
            x = linear(layer.weight, layer.bias, x)
            x = tanh(x) if layer.activation == "tanh" else x
            x = np.maximum(x, np.float32(0.0)) if layer.activation == "relu" else x
    actions = tanh(x) if network.output == "tanh" else np.minimum(np.maximum(x, np.float32(-1.0)), np.float32(1.0))
    if network.known is None:
        return actions
    memory.trust = trusted(network.known, memory.trust, np.asarray(observations, np.float32))
    return actions * memory.trust
