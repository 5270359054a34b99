"""The policy artefact: a folder that anyone can run, check and deploy, without the library that trained it.

``policy.json`` says for which environment the policy is (id, version, control, base controller with every parameter),
what it observes and what its actions mean, its normaliser and the shape of its network, the SHA-256 of the weights, and
where it comes from; ``weights.safetensors`` holds the numbers. Nothing is unpickled. ::

    policy = Policy.load("runs/ppo/policy")
    action = policy.act(observation, start=True)    # in NumPy; start: an episode begins

``-c runs/ppo/policy`` names it as a controller (:func:`stack_of`): there the network runs compiled, with the
environment's own observation and action, see :mod:`agents.compiled`.
"""

import functools
import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..envs.control import stack as stacks
from ..envs.control.stack import Stack
from ..envs.engine.quantity import InvalidInput, check_choice, did_you_mean
from ..envs.plant.controller import Law
from ..envs.safety import files
from ..envs.tasks.all_tasks import TASKS
from .network import REMEMBER, Known, Layer, Memory, Network, Normaliser, run

FORMAT = 1
"""Version of the folder's format."""

LARGEST = 4096
"""Numbers that a layer may take or give."""

RAWEST = 1e4
"""Largest number of an observation that is not normalised."""

FARTHEST = 1e30
"""Largest number within a network; beyond 3e38 there is none in single precision."""

FROM_BASE = ("residual", "weights")
"""Controls by which an action of 0 leaves the base controller as it is."""

DOCUMENT, WEIGHTS = "policy.json", "weights.safetensors"


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class LayerShape(_Table):
    """One layer; a ``linear`` one has an activation."""

    kind: Literal["linear", "lstm", "gru"]
    inputs: int = Field(ge=1, le=LARGEST)
    outputs: int = Field(ge=1, le=LARGEST)
    activation: Literal["none", "tanh", "relu"] = "none"


class NetworkShape(_Table):
    """The network; the weights hold its numbers."""

    frames: int = Field(ge=1, le=64)
    normaliser: Literal["none", "observation", "frames"]
    clip: float = Field(gt=0)  # of the normalised observation
    layers: list[LayerShape] = Field(min_length=1, max_length=16)
    output: Literal["clip", "tanh"]


class Range(_Table):
    """Where a policy was trained: bounds of some of the signals that it observes; it hands over to its base beyond."""

    names: list[str] = Field(min_length=1, max_length=64)
    low: list[float]
    high: list[float]
    margin: list[float]  # beyond the bounds, until nothing is left of its action


class Base(_Table):
    """A controller that does what the actions leave open: a law's name and every parameter of its stack."""

    name: str
    law: str
    parameters: dict[str, float]
    provenance: dict[str, Any] = Field(default_factory=dict)  # how it was tuned


class Document(_Table):
    """What ``policy.json`` holds."""

    format: int
    environment: str
    version: int
    control: str
    base: dict[str, Base]  # by slot
    observation: dict[str, Any]
    action: dict[str, Any]
    network: NetworkShape
    weights: str  # SHA-256 of the file
    provenance: dict[str, Any]
    range: Range | None = None
    sha256: str = ""  # of all the rest of the document; the first policies have none


class Policy:
    """A policy that has been loaded or exported.

    Args:
        document: what its ``policy.json`` says.
        network: its numbers.
        name: what it is called in tables.

    Attributes:
        task: of its environment.
        document, network, name: as given.
    """

    def __init__(self, document: Document, network: Network, name: str = "policy") -> None:
        self.document, self.network, self.name = document, network, name
        self.task = TASKS[document.environment]
        self._memory: Memory | None = None

    @property
    def provenance(self) -> dict[str, Any]:
        """Where it comes from."""
        return self.document.provenance

    def act(self, observation: Any, start: Any = False) -> np.ndarray:
        """The action, float32 in −1 … 1, for an observation of shape (d,), or (n, d) of n environments.

        Args:
            observation: as the environment gives it.
            start: whether an episode begins with it, one answer or n; the first observation always begins one.

        Raises:
            InvalidInput: wrong shape, not finite, or another number of environments within an episode.
        """
        x = np.asarray(observation)
        rows = x[None] if x.ndim == 1 else x
        if x.dtype.kind not in "fiu" or x.ndim not in (1, 2) or rows.shape[1] != self.network.size:
            raise InvalidInput(
                f"the observation has shape {x.shape} and type {x.dtype}; the policy reads ({self.network.size},) or "
                f"(n, {self.network.size}), float32"
            )
        if not np.isfinite(rows).all():
            raise InvalidInput("the observation is not finite")
        begins = np.broadcast_to(np.asarray(start, bool), len(rows))
        if self._memory is None or len(self._memory.frames) != len(rows):
            if self._memory is not None and not begins.all():
                raise InvalidInput(
                    f"{len(rows)} observations after {len(self._memory.frames)} before; start=True begins episodes anew"
                )
            self._memory = Memory(self.network, len(rows))
        self._memory.forget(begins)
        actions = run(self.network, self._memory, rows)
        return actions[0] if x.ndim == 1 else actions

    # ------------------------------------------------------------------------------------------------ the folder

    @staticmethod
    def load(folder: str | Path) -> "Policy":
        """The policy in a folder.

        Raises:
            InvalidInput: no such folder, something is missing, damaged, changed, or of another environment.
        """
        folder = Path(folder)
        try:
            text = files.text(folder / DOCUMENT, files.RECORD)
            files.json_of(text, folder / DOCUMENT)  # neither too deep nor otherwise broken
            weights = files.data(folder / WEIGHTS, files.NUMBERS)
        except InvalidInput as error:
            raise InvalidInput(f"policy '{folder}' cannot be read: {error}") from None
        document = _document(text, folder)
        found = hashlib.sha256(weights).hexdigest()
        if found != document.weights:
            raise InvalidInput(
                f"policy '{folder}': {WEIGHTS} is damaged, or not this policy's: its SHA-256 is {found[:12]}…, "
                f"{DOCUMENT} says {document.weights[:12]}…"
            )
        origin = stacks.recorded(document.provenance, f"policy '{folder}': provenance")
        document = document.model_copy(update={"provenance": origin})
        check(document, f"policy '{folder}'")
        return Policy(document, _network(document, weights, folder), str(folder))

    def save(self, folder: str | Path) -> None:
        """Writes ``policy.json`` and ``weights.safetensors``, the document last, so that a folder with it is whole."""
        from safetensors.numpy import save

        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        weights = save(tensors_of(self.network))
        self.document = self.document.model_copy(update={"weights": hashlib.sha256(weights).hexdigest()})
        self.document = self.document.model_copy(update={"sha256": _digest(self.document.model_dump())})
        text = json.dumps(self.document.model_dump(), indent=1, ensure_ascii=False, allow_nan=False)
        for name, data in ((WEIGHTS, weights), (DOCUMENT, (text + "\n").encode())):
            part = folder / f".{name}.part"
            part.write_bytes(data)
            part.replace(folder / name)


# --------------------------------------------------------------------------------------------- what it is about


def describe(environment: str, control: str, kind: str, law: Law | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Observation and action of an environment as this version of it has them; ``law`` is that of its base.

    Raises:
        InvalidInput: unknown environment, control or kind of observation, or nothing for this law.
    """
    check_choice(environment, TASKS, "environment")
    task = TASKS[environment]
    check_choice(kind, task.observations, "observation")
    check_choice(control, task.controls, "control")
    names = task.seen(kind, law).names
    observation: dict[str, Any] = {"kind": kind, "shape": [len(names)], "names": list(names)}
    if kind == "features":
        observation["scaling"] = dict(task.scaling)
    return observation, task.decided(control, law).document()


def check(document: Document, where: str) -> None:
    """Raises :class:`InvalidInput` unless the policy is for an environment as this version has it."""
    if document.format != FORMAT:
        raise InvalidInput(f"{where} is of format {document.format}; this version of kerfgym reads format {FORMAT}")
    stem, version = document.environment.rpartition("-v")[::2]
    if document.environment not in TASKS:
        have = [name for name in TASKS if stem and name.rpartition("-v")[0] == stem]
        here = f"this version of kerfgym has {have[0]}" if have else did_you_mean(document.environment, TASKS)
        raise InvalidInput(f"{where} is for environment '{document.environment}'; {here}")
    if str(document.version) != version:
        raise InvalidInput(
            f"{where} is for version {document.version} of environment '{document.environment}'; here it is {version}"
        )
    base = _laws().get(document.base["z"].law) if "z" in document.base else None
    observation, action = describe(
        document.environment, document.control, str(document.observation.get("kind")), base.law if base else None
    )
    told = (("observation", document.observation, observation), ("action", document.action, action))
    for what, saved, present in told:
        for key in dict.fromkeys((*present, *saved)):
            if saved.get(key) != present.get(key):
                raise InvalidInput(
                    f"{where}: {what}.{key} is {_short(saved.get(key))}, in this {document.environment} it is "
                    f"{_short(present.get(key))}; it was made for another version or shape"
                )
    slots = set(document.base)
    wanted = set(TASKS[document.environment].slots)
    if slots != wanted:
        raise InvalidInput(f"{where}: base controllers for slots {sorted(slots)}; needed: {sorted(wanted)}")
    shape, last = document.network, document.observation["shape"][0] * document.network.frames
    for i, layer in enumerate(shape.layers):
        if layer.inputs != last:
            raise InvalidInput(f"{where}: network.layers.{i} takes {layer.inputs} numbers, but gets {last}")
        last = layer.outputs
    if last != document.action["shape"][0]:
        raise InvalidInput(f"{where}: the network gives {last} numbers; an action has {document.action['shape'][0]}")
    if document.range:
        _check_range(document.range, document, where)
    bases(document, where)


def _check_range(known: Range, document: Document, where: str) -> None:
    """Raises :class:`InvalidInput` unless a policy can hand over to its base by this."""
    for name in known.names:
        check_choice(name, document.observation["names"], f"{where}: range.names")
    if not len(known.low) == len(known.high) == len(known.margin) == len(known.names):
        raise InvalidInput(f"{where}: range needs a low, a high and a margin for each of {len(known.names)} names")
    if not all(low <= high and m > 0 for low, high, m in zip(known.low, known.high, known.margin, strict=True)):
        raise InvalidInput(f"{where}: range holds a low above its high, or a margin that is not above 0")
    if max(map(abs, (*known.low, *known.high, *known.margin))) > RAWEST or min(known.margin) < 1.0 / RAWEST:
        raise InvalidInput(f"{where}: range holds numbers beyond ±{RAWEST:g}, or a margin below {1.0 / RAWEST:g}")
    if document.control not in FROM_BASE:
        raise InvalidInput(f"{where}: with control '{document.control}' no action means the base; so there is no range")


def describe_base(stack: Stack) -> Base:
    """A base controller as the artefact keeps it.

    Raises:
        InvalidInput: its law is not one of kerfgym's, so nobody else could run it.
    """
    if stack.law.name not in _laws():
        raise InvalidInput(
            f"base controller '{stack.name}' is not one of kerfgym's; a policy on top of it would not run elsewhere"
        )
    values = {name: float(p.value) for name, p in stack.parameters().items()}
    return Base(name=stack.name, law=stack.law.name, parameters=values, provenance=stack.provenance)


def _laws() -> dict[str, Stack]:
    """A registered controller of each law."""
    return {stacks.get(name).law.name: stacks.get(name) for name in stacks.names()}


def bases(document: Document, where: str) -> dict[str, Stack]:
    """The base controllers by slot.

    Raises:
        InvalidInput: unknown law or parameter, wrong slot, or a value out of range.
    """
    laws, found = _laws(), {}
    for slot, base in document.base.items():
        if base.law not in laws or laws[base.law].slot != slot:
            of_slot = [name for name, stack in laws.items() if stack.slot == slot]
            raise InvalidInput(f"{where}: unknown law '{base.law}' in slot '{slot}'; {did_you_mean(base.law, of_slot)}")
        try:
            varied = laws[base.law].varied(base.parameters, base.name)
            found[slot] = replace(varied, provenance=stacks.recorded(base.provenance, f"base.{slot}.provenance"))
        except InvalidInput as error:
            raise InvalidInput(f"{where}: {error}") from None
    return found


@functools.lru_cache(maxsize=32)
def _stack(folder: Path, stamp: tuple[int, ...]) -> Stack:
    from .compiled import Compiled

    policy = Policy.load(folder)
    found = bases(policy.document, f"policy '{folder}'")
    main = found.pop(policy.task.slot)
    # What was spent on the policy comes on top of what its base was tuned with.
    made, tuned = policy.provenance, dict(main.provenance)
    tuned.pop("edited", None)  # what its training changed in the base is part of the policy, and in its record
    steps = made.get("ledger", made).get("simulated_steps", 0) + tuned.get("simulated_steps", tuned.get("steps", 0))
    if policy.document.range is not None:  # beyond it this stack is its base, which a reader of its figures must know
        made = {**made, "range": list(policy.document.range.names)}
    provenance = {**tuned, "simulated_steps": steps, "policy": made}
    summary = f"policy for {policy.document.environment}, {policy.document.control}, on {main.name}"
    return Stack(str(folder), summary, main.law, main.values, None, provenance, "", Compiled(policy), found)


def stack_of(folder: Path) -> Stack | None:
    """The policy in a folder as a controller in its task's slot, with its bases of the other slots as
    companions; None if the folder holds no policy.

    Raises:
        InvalidInput: as :meth:`Policy.load`.
    """
    if not (folder / DOCUMENT).is_file():
        return None
    files = [folder / DOCUMENT, folder / WEIGHTS]
    return _stack(folder, tuple(f.stat().st_mtime_ns if f.is_file() else 0 for f in files))


# ------------------------------------------------------------------------------------------------------ weights


def tensors_of(network: Network) -> dict[str, np.ndarray]:
    """Its numbers by name."""
    found = {}
    for i, layer in enumerate(network.layers):
        found[f"layers.{i}.weight"], found[f"layers.{i}.bias"] = layer.weight, layer.bias
    if network.normaliser:
        found["normaliser.mean"], found["normaliser.scale"] = network.normaliser.mean, network.normaliser.scale
    return {name: np.ascontiguousarray(array) for name, array in found.items()}


def shape_of(network: Network) -> NetworkShape:
    """Its shape, as the document keeps it."""
    n = network.normaliser
    place: Literal["none", "observation", "frames"]
    place = "none" if n is None else ("frames" if network.normalises_frames else "observation")
    layers = [
        LayerShape.model_validate(
            {"kind": x.kind, "inputs": x.inputs, "outputs": x.outputs, "activation": x.activation}
        )
        for x in network.layers
    ]
    output: Any = network.output
    return NetworkShape(
        frames=network.frames, normaliser=place, clip=n.clip if n else 1.0, layers=layers, output=output
    )


def known_of(document: Document) -> Known | None:
    """The document's range, as a network uses it."""
    if document.range is None:
        return None
    said = document.range
    low, high, margin = np.array([said.low, said.high, said.margin], np.float32)
    return Known(np.array([document.observation["names"].index(name) for name in said.names]), low, high, margin)


def _network(document: Document, data: bytes, folder: Path) -> Network:
    """The network out of the weights, each of which must have the shape and type that the document asks for."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    shape, size = document.network, int(document.observation["shape"][0])
    wanted: dict[str, tuple[tuple[int, ...], Any]] = {}
    for i, layer in enumerate(shape.layers):
        memory = layer.kind in REMEMBER
        gates = 4 * layer.outputs if memory else layer.outputs
        wanted[f"layers.{i}.weight"] = (gates, layer.inputs + (layer.outputs if memory else 0)), np.float32
        wanted[f"layers.{i}.bias"] = (gates,), np.float32
    if shape.normaliser != "none":
        length = size * (shape.frames if shape.normaliser == "frames" else 1)
        wanted["normaliser.mean"] = wanted["normaliser.scale"] = (length,), np.float64
    try:
        tensors = load(data)
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise InvalidInput(f"policy '{folder}': {WEIGHTS} is no safetensors file: {error}") from None
    if set(tensors) != set(wanted):
        odd = sorted(set(tensors) ^ set(wanted))
        raise InvalidInput(f"policy '{folder}': {WEIGHTS} and the network's shape do not fit: {', '.join(odd)}")
    for name, (dimensions, dtype) in wanted.items():
        array = tensors[name]
        if array.shape != dimensions or array.dtype != dtype:
            raise InvalidInput(
                f"policy '{folder}': {name} has shape {array.shape} and type {array.dtype}; the network needs "
                f"{dimensions} and {np.dtype(dtype)}"
            )
        if not np.isfinite(array).all() or (name.endswith("scale") and not (array > 0).all()):
            raise InvalidInput(f"policy '{folder}': {name} holds numbers that are not finite, or a scale not above 0")
    normaliser = None
    if shape.normaliser != "none":
        normaliser = Normaliser(tensors["normaliser.mean"], tensors["normaliser.scale"], shape.clip)
    layers = tuple(
        Layer(layer.kind, tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"], layer.activation)
        for i, layer in enumerate(shape.layers)
    )
    _bounded(layers, shape.clip if normaliser else RAWEST, f"policy '{folder}': {WEIGHTS}")
    return Network(size, shape.frames, normaliser, layers, shape.output, known_of(document))


def _bounded(layers: tuple[Layer, ...], most: float, where: str) -> None:
    """Raises :class:`InvalidInput` if a network's numbers could grow beyond what its single precision holds.

    Args:
        layers: of the network.
        most: largest number that it reads.
        where: put before the message.
    """
    for i, layer in enumerate(layers):
        rows = np.abs(layer.weight.astype(np.float64)).sum(axis=1)
        largest = float((rows * max(most, 1.0) + np.abs(layer.bias)).max())
        if not largest <= FARTHEST:
            raise InvalidInput(f"{where}: layers.{i} can give {largest:.0e}; allowed: {FARTHEST:.0e}")
        most = 1.0 if layer.kind in REMEMBER or layer.activation == "tanh" else largest


def _document(text: str, folder: Path) -> Document:
    said = files.json_of(text, folder / DOCUMENT)
    try:
        found = Document.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(x) for x in first["loc"])
        what = f"{place}: {first['msg']}" if place else first["msg"]
        raise InvalidInput(f"policy '{folder}': {DOCUMENT} is not valid; {what}") from None
    if found.sha256 and found.sha256 != _digest(said):
        raise InvalidInput(f"policy '{folder}': {DOCUMENT} is not as it was written; export or copy the policy again")
    return found


def _digest(document: dict[str, Any]) -> str:
    """SHA-256 of a document without its own."""
    rest = {key: value for key, value in document.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"
