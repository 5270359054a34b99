"""A policy inside compiled roll-outs: the network as a stage of the machine's kernel.

The stage runs once an episode has begun and after each decision's last period. It has the environment's own ``observe``
write the observations, runs the network on them, and has the environment's own ``act`` put the actions into force. So
the signals are built in one place, and a seed gives the same trajectory here and in the Gymnasium loop with
:meth:`policy.Policy.act`; sums are taken in the same order (:mod:`agents.network`), so it is the same to the bit.
"""

import json
from typing import Any, NamedTuple

import numpy as np

from ..envs.engine.deck import Deck, places
from ..envs.engine.lanes import U0, U1, U, as_bits, as_number, call, clip, doubles, part, singles, stage, words
from ..envs.plant import machine
from ..envs.plant.controller import stage_address
from ..envs.plant.fleet import Fleet
from ..envs.tasks.interface import LARGEST_TRIM, LONGEST_WINDOW
from .network import ACTIVATIONS, FALL, LN2_HIGH, LN2_LOW, LOG2E, OUTPUTS, REMEMBER, RISE, SERIES, UNKNOWN, Network


class Io(NamedTuple):
    """The stage's deck, and what its arrays hold."""

    next: int  # stage and deck of the next pilot; 0: none
    next_io: int
    act: int  # the environment's stages and their deck
    observe: int
    environment: int
    observations: int  # float32, (machines, size)
    actions: int  # float32, (machines, width)
    size: int
    width: int
    period: int  # control periods from decision to decision
    since: int  # float64, (machines,), periods since the last decision
    work: int  # float32, (machines, stride): frames, normalised frames, then what each layer needs
    stride: int
    frames: int
    normaliser: int  # 0: none, 1: of each observation, 2: of all frames
    scales: int  # float64: limit, means, scales
    weights: int  # float32, of all layers: transposed weight, bias
    layers: int  # uint64, (depth, 4)
    depth: int
    output: int
    known: int  # numbers of an observation that bound where the policy was trained
    which: int  # uint64, (known,), of the observation
    bounds: int  # float32, (known, 3): low, high, margin
    trust: int  # float32, (machines,)


IO = places(Io)
_IO, _ANY = U(len(Io._fields)), U(2**40)
_FRESH = machine.signal("fresh")
_U2, _U3, _U4 = U(2), U(3), U(4)
_S52, _S1023, _SHIFT = U(52), U(1023), 6755399441055744.0
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12 = SERIES
_TANH, _RELU = U(ACTIVATIONS.index("tanh")), U(ACTIVATIONS.index("relu"))
_SQUASHED = U(OUTPUTS.index("tanh"))


@part
def _exponential(x):
    """e^x, |x| < 700, as :func:`network.exponential` has it."""
    k = np.rint(x * LOG2E)
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    p = ((((_C12 * r + _C11) * r + _C10) * r + _C9) * r + _C8) * r + _C7
    p = ((((((p * r + _C6) * r + _C5) * r + _C4) * r + _C3) * r + _C2) * r + _C1) * r + _C0
    # Adding 1.5·2^52 leaves the whole number k in the last bits.
    return p * as_number((as_bits(k + _SHIFT) + _S1023) << _S52)


@part
def _tanh(x):
    """Single precision in and out."""
    y = clip(np.float64(x), -20.0, 20.0)
    return np.float32(1.0 - 2.0 / (_exponential(2.0 * y) + 1.0))


@part
def _logistic(x):
    """Single precision in and out."""
    y = clip(np.float64(x), -80.0, 80.0)
    return np.float32(1.0 / (1.0 + _exponential(-y)))


@stage
def _linear(work, x, y, weights, w, inputs, outputs):
    """``work[y…] = weight·work[x…] + bias``, input by input; four inputs at a time, which saves stores."""
    bias = w + inputs * outputs
    for o in range(outputs):
        work[y + o] = weights[bias + o]
    fours = inputs // _U4
    for k in range(fours):
        i, v = x + k * _U4, w + k * _U4 * outputs
        x0, x1, x2, x3 = work[i], work[i + U1], work[i + _U2], work[i + _U3]
        v1, v2, v3 = v + outputs, v + _U2 * outputs, v + _U3 * outputs
        for o in range(outputs):
            total = work[y + o] + x0 * weights[v + o]
            total = total + x1 * weights[v1 + o]
            total = total + x2 * weights[v2 + o]
            work[y + o] = total + x3 * weights[v3 + o]
    for i in range(fours * _U4, inputs):
        x0, v = work[x + i], w + i * outputs
        for o in range(outputs):
            work[y + o] = work[y + o] + x0 * weights[v + o]


@stage
def _activate(work, y, outputs, kind):
    """The activation of a linear layer, in place."""
    if kind == _TANH:
        for o in range(outputs):
            work[y + o] = _tanh(work[y + o])
    elif kind == _RELU:
        for o in range(outputs):
            work[y + o] = max(work[y + o], _ZERO)


@stage
def _remember(work, gates, cell, hidden, outputs):
    """The gates of an LSTM (Hochreiter and Schmidhuber 1997) change its cells and give its outputs."""
    for o in range(outputs):
        enter, forget = _logistic(work[gates + o]), _logistic(work[gates + outputs + o])
        candidate, out = _tanh(work[gates + _U2 * outputs + o]), _logistic(work[gates + _U3 * outputs + o])
        kept = forget * work[cell + o] + enter * candidate
        work[cell + o] = kept
        work[hidden + o] = out * _tanh(kept)


@stage
def _renew(work, gates, hidden, outputs):
    """The gates of a GRU (Cho et al. 2014), with the candidate as in :class:`torch.nn.GRU`, change its outputs."""
    for o in range(outputs):
        reset, update = _logistic(work[gates + o]), _logistic(work[gates + outputs + o])
        given = reset * work[gates + _U3 * outputs + o]
        candidate = _tanh(work[gates + _U2 * outputs + o] + given)
        kept = update * (work[hidden + o] - candidate)
        work[hidden + o] = candidate + kept


@stage
def _normalise(work, x, y, size, scales, means, length):
    """``work[y…]``: the ``size`` numbers of ``work[x…]`` scaled."""
    limit = scales[U0]
    for i in range(size):
        scaled = (np.float64(work[x + i]) - scales[means + i]) / scales[means + length + i]
        work[y + i] = np.float32(clip(scaled, -limit, limit))


@stage
def _run(io, machine_):
    """The network of one machine: its action for its observation."""
    work = singles(io[IO.work] + _U4 * machine_ * io[IO.stride], io[IO.stride])
    observations, actions = singles(io[IO.observations], _ANY), singles(io[IO.actions], _ANY)
    weights, scales = singles(io[IO.weights], _ANY), doubles(io[IO.scales], _ANY)
    layers = words(io[IO.layers], io[IO.depth] * _U4)
    size, frames = io[IO.size], io[IO.frames]
    all_frames = size * frames
    newest = all_frames - size
    for i in range(newest):
        work[i] = work[i + size]
    for i in range(size):
        work[newest + i] = observations[machine_ * size + i]
    x = U0
    if io[IO.normaliser] == U1:
        _normalise(work, newest, newest, size, scales, U1, size)
    elif io[IO.normaliser] == _U2:
        _normalise(work, U0, all_frames, all_frames, scales, U1, all_frames)
        x = all_frames
    y, w, inputs = _U2 * all_frames, U0, all_frames
    for k in range(io[IO.depth]):
        memory, outputs, kind = layers[k * _U4], layers[k * _U4 + U1], layers[k * _U4 + _U2]
        if memory > U0:
            # What it takes and its hidden state side by side, then its gates, then its cells.
            hidden = y + inputs
            gates = hidden + outputs
            cell = gates + _U4 * outputs
            for i in range(inputs):
                work[y + i] = work[x + i]
            _linear(work, y, gates, weights, w, inputs + outputs, _U4 * outputs)
            if memory == U1:
                _remember(work, gates, cell, hidden, outputs)
            else:
                _renew(work, gates, hidden, outputs)
            w += (inputs + outputs + U1) * _U4 * outputs
            x, y = hidden, cell + outputs
        else:
            _linear(work, x, y, weights, w, inputs, outputs)
            _activate(work, y, outputs, kind)
            w += (inputs + U1) * outputs
            x, y = y, y + outputs
        inputs = outputs
    for j in range(io[IO.width]):
        u = work[x + j]
        if io[IO.output] == _SQUASHED:
            actions[machine_ * io[IO.width] + j] = _tanh(u)
        else:
            actions[machine_ * io[IO.width] + j] = max(-_ONE, min(_ONE, u))
    if io[IO.known] > U0:
        trust = _trusted(io, machine_)
        for j in range(io[IO.width]):
            actions[machine_ * io[IO.width] + j] *= trust


@stage
def _trusted(io, machine_):
    """How much of its action the policy keeps, see :func:`network.trusted`."""
    observations, trust = singles(io[IO.observations], _ANY), singles(io[IO.trust], _ANY)
    which, bounds = words(io[IO.which], io[IO.known]), singles(io[IO.bounds], _ANY)
    most, before = _ZERO, trust[machine_]
    for k in range(io[IO.known]):
        x, low, high = observations[machine_ * io[IO.size] + which[k]], bounds[_U3 * k], bounds[_U3 * k + U1]
        most = max(most, max(low - x, x - high) / bounds[_U3 * k + _U2])
    wanted = _ONE - min(most, _ONE)
    trust[machine_] = wanted if before < _ZERO else before + min(max(wanted - before, -FALL), RISE)
    return trust[machine_]


@stage
def _forget(io, machine_):
    """An episode begins: no frames, no state."""
    work = singles(io[IO.work] + _U4 * machine_ * io[IO.stride], io[IO.stride])
    for i in range(io[IO.stride]):
        work[i] = _ZERO
    if io[IO.known] > U0:
        singles(io[IO.trust], _ANY)[machine_] = UNKNOWN


def fly(block_address, at, n, io_address, first):
    """Stage after the beginning and after each period: decides for the machines whose turn it is."""
    block, io = doubles(block_address, _ANY), words(io_address, _IO)
    since, period = doubles(io[IO.since], _ANY), np.float64(np.int64(io[IO.period]))
    for lane in range(n):
        i = first + lane
        since[i] += 1.0
        if block[at + lane + _FRESH] > 0.5:
            _forget(io, i)
            since[i] = period
    if n == U1 or io[IO.period] > U1:
        for lane in range(n):
            i = first + lane
            if since[i] >= period:
                since[i] = 0.0
                call(io[IO.observe], block_address, at + lane, U1, io[IO.environment], i)
                _run(io, i)
                call(io[IO.act], block_address, at + lane, U1, io[IO.environment], i)
    else:
        call(io[IO.observe], block_address, at, n, io[IO.environment], first)
        for lane in range(n):
            _run(io, first + lane)
        call(io[IO.act], block_address, at, n, io[IO.environment], first)
    if io[IO.next] > U0:
        call(io[IO.next], block_address, at, n, io[IO.next_io], first)


class Compiled:
    """A policy as a pilot of fleets, see :class:`envs.control.stack.Pilot`."""

    def __init__(self, policy: Any) -> None:
        self.policy = policy

    @property
    def program(self) -> list[str]:
        """What the policy does depends on its document, which knows the weights' digest."""
        document = self.policy.document
        return [json.dumps(document.model_dump(exclude={"provenance", "sha256"}), sort_keys=True)]

    def install(self, fleet: Fleet) -> None:
        """Gives all machines of the fleet over to the policy."""
        self.fly(fleet)

    def fly(self, fleet: Fleet) -> Deck:
        """The same; returns the deck with what it observes, decides and trusts, for those who watch."""
        document, task = self.policy.document, self.policy.task
        if document.control == "schedule":
            fleet.widest_window(LONGEST_WINDOW, LARGEST_TRIM)
        hook = task.hook(fleet, document.control, document.observation["kind"])
        io = _flight(self.policy.network, fleet, hook, task.period)
        fleet.pilot("job" if task.with_job else "height", stage_address(fly), io)
        return io


def _flight(network: Network, fleet: Fleet, hook: tuple[int, int, Deck], period: int) -> Deck:
    """The deck of a policy in one fleet, with the task's stages and their deck."""
    act, observe, environment = hook
    weights, layers, stride = _laid_out(network)
    n, known, count = network.normaliser, network.known, fleet.size
    return Deck(
        Io,
        act=act,
        observe=observe,
        environment=environment,
        observations=environment.owned("observations"),
        actions=environment.owned("actions"),
        size=network.size,
        width=network.actions,
        period=period,
        since=np.zeros(count),
        work=np.zeros((count, stride), np.float32),
        stride=stride,
        frames=network.frames,
        normaliser=0 if n is None else (2 if network.normalises_frames else 1),
        scales=np.concatenate([[n.clip], n.mean, n.scale]) if n else np.zeros(1),
        weights=weights,
        layers=layers,
        depth=len(layers),
        output=OUTPUTS.index(network.output),
        known=len(known.which) if known else 0,
        which=known.which.astype(np.uint64) if known else np.zeros(1, np.uint64),
        bounds=np.stack(known[1:], axis=1) if known else np.zeros(1, np.float32),
        trust=np.full(count, UNKNOWN),
    )


def _laid_out(network: Network) -> tuple[np.ndarray, np.ndarray, int]:
    """Weights in a row (transposed, then the bias, of each layer), words about the layers, numbers that a machine
    needs to work with."""
    pieces, about, stride = [], [], 2 * network.size * network.frames
    for layer in network.layers:
        pieces += [layer.weight.T.ravel(), layer.bias]
        memory = 1 + REMEMBER.index(layer.kind) if layer.kind in REMEMBER else 0
        about.append((memory, layer.outputs, ACTIVATIONS.index(layer.activation), 0))
        stride += layer.inputs + 6 * layer.outputs if memory else layer.outputs
    return np.concatenate(pieces, dtype=np.float32), np.array(about, np.uint64), stride
