"""From a trained model of stable-baselines3 or sb3-contrib to a policy artefact. ::

    export(model, folder, provenance={"command": …, "cpu_seconds": …, "seeds": …}, env=None) -> Exported

``folder`` then holds ``policy.json``, ``weights.safetensors`` and, if the package onnx is there, ``policy.onnx``
(:mod:`agents.policy` says what they are). The environment is the model's own, wrapped in ``VecNormalize``,
``VecFrameStack`` or not at all, unless ``env`` gives another; the normaliser goes inside. What is exported is the
deterministic policy.

The artefact is proved before it is written: model and artefact act on the same recorded observations, and the largest
difference must not exceed :data:`BOUND`. :attr:`Exported.difference` and the document's provenance keep it.
"""

import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np

from ..envs.engine.quantity import InvalidInput
from . import known_range
from .network import Layer, Memory, Network, Normaliser, run
from .policy import FORMAT, Document, Policy, Range, check, describe, describe_base, known_of, shape_of

SUPPORTED = (
    "PPO, SAC, TD3, TQC, RecurrentPPO, gradient with one-dimensional observations; layers: linear with tanh, ReLU or "
    "no activation, LSTM, GRU; output: tanh (squashing) or clipping to −1 … 1; VecNormalize, VecFrameStack"
)
"""What can be exported; anything else is refused."""

BOUND = 1e-5
"""Largest difference of an action (of −1 … 1) between model and artefact; they round differently."""

WRAPPERS = ("Monitor", "TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "Autoreset")
"""Of Gymnasium and stable-baselines3, which change neither observations nor actions."""

STEPS, MACHINES = 200, 4
"""Steps and machines of which observations are recorded."""


@dataclass(frozen=True)
class Exported:
    """What came of an export; ``difference`` is the largest one of an action, over ``compared`` actions."""

    folder: Path
    policy: Policy
    difference: float
    compared: int
    onnx: Path | None


def export(
    model: Any,
    folder: str | Path,
    provenance: dict[str, Any] | None = None,
    env: Any = None,
    onnx: bool = True,
    known: Range | Literal["measured"] | None = None,
) -> Exported:
    """Writes the artefact of a model.

    Args:
        model: of stable-baselines3 or sb3-contrib, see :data:`SUPPORTED`.
        folder: is made if need be.
        provenance: what is known of its making: command, CPU-seconds, seeds, a ``ledger`` if more was simulated than
            the model's own steps. Algorithm, seed, decisions, simulated steps (of 1 ms) and versions are added.
        env: environment of the model (a ``VecEnv``, or a Gymnasium environment), if not ``model.get_env()``.
        onnx: whether to write ``policy.onnx`` beside, if the package is there.
        known: the range in which it was trained; beyond it the policy hands over to its base. "measured": what the
            scenarios of ``env`` hold, see :mod:`agents.known_range`.

    Raises:
        InvalidInput: the model or its environment is not supported, or artefact and model differ.
    """
    batch, normaliser, frames = _environment(env if env is not None else model.get_env())
    layers, output = _layers(model)
    network = Network(batch.observation_space.shape[0], frames, normaliser, layers, output)
    if layers[0].inputs != network.size * frames:
        raise _refused(f"a network of {layers[0].inputs} inputs for {frames} frames of {network.size} numbers")
    if known == "measured":
        known = known_range.measured(network, batch)
    environment = batch.task.id
    observation, action = describe(environment, batch.control, batch.observation, batch.base.z.law)
    steps = int(model.num_timesteps)
    about = {"algorithm": type(model).__name__, "seed": model.seed, "training_steps": steps}
    about |= {"simulated_steps": steps * batch.task.period, "versions": _versions()}
    document = Document(
        format=FORMAT,
        environment=environment,
        version=int(environment.rpartition("-v")[2]),
        control=batch.control,
        base={s.slot: describe_base(s) for s in batch.base.stacks},
        observation=observation,
        action=action,
        network=shape_of(network),
        weights="",
        provenance={**about, **(provenance or {})},
        range=known,
    )
    check(document, "the policy")
    difference, compared = equivalence(model, network, batch)
    if not difference <= BOUND:
        raise InvalidInput(
            f"the artefact's actions differ from the model's by {difference:.2g}, more than {BOUND:g}; not exported"
        )
    document.provenance["equivalence"] = {"largest_difference": difference, "actions": compared, "bound": BOUND}
    policy = Policy(document, network._replace(known=known_of(document)), str(folder))
    policy.save(folder)
    written = None
    if onnx:
        from .onnx_file import write

        written = write(policy, Path(folder) / "policy.onnx")
    return Exported(Path(folder), policy, difference, compared, written)


def equivalence(model: Any, network: Network, batch: Any) -> tuple[float, int]:
    """Largest difference between model and network, and of how many actions: both act on the observations of
    :data:`MACHINES` machines that the model drives for :data:`STEPS` steps of the *tune* seeds."""
    like = type(batch)(
        batch.task, MACHINES, batch.scenarios, batch.control, batch.observation, split="tune", base=batch.base
    )
    every = np.arange(MACHINES)
    like.sequence(every, every)
    like.restart(every)
    memory, frames = Memory(network, MACHINES), np.zeros((MACHINES, network.frames * network.size), np.float32)
    state, begins, worst = None, np.ones(MACHINES, bool), 0.0
    for _ in range(STEPS):
        memory.forget(begins)
        frames[begins] = 0.0
        ours = run(network, memory, like.observations.copy())
        frames = np.roll(frames, -network.size, axis=1)
        frames[:, -network.size :] = like.observations
        theirs, state = model.predict(_normalised(network, frames), state, begins, deterministic=True)
        worst = max(worst, float(np.abs(ours.astype(np.float64) - theirs).max()))
        like.put_actions(np.asarray(theirs, np.float32))
        like.advance()
        begins = like.terminated | like.truncated
        if begins.any():
            like.restart(np.flatnonzero(begins))
    return worst, STEPS * MACHINES


def _normalised(network: Network, frames: np.ndarray) -> np.ndarray:
    """What the wrappers would give to the model, by their own formula."""
    n = network.normaliser
    if n is None:
        return frames
    repeat = len(frames[0]) // len(n.mean)
    mean, scale = np.tile(n.mean, repeat), np.tile(n.scale, repeat)
    scaled = np.clip((frames - mean) / scale, -n.clip, n.clip).astype(np.float32)
    if not network.normalises_frames:
        empty = (frames.reshape(len(frames), -1, network.size) == 0).all(axis=2)  # frames before the episode stay 0
        scaled[np.repeat(empty, network.size, axis=1)] = 0.0
    return scaled


# ---------------------------------------------------------------------------------------------------- the model


def _layers(model: Any) -> tuple[tuple[Layer, ...], str]:
    """Layers and output of a model's deterministic policy."""
    import torch

    name, policy = type(model).__name__, model.policy
    if name not in ("PPO", "SAC", "TD3", "TQC", "RecurrentPPO", "Gradient"):
        raise _refused(f"the algorithm {name}")
    space = model.action_space
    if not isinstance(space, gym.spaces.Box) or not (np.all(space.low == -1.0) and np.all(space.high == 1.0)):
        raise _refused(f"the action space {space}")
    actor = model.actor if name in ("SAC", "TD3", "TQC") else policy
    extractor = getattr(actor, "pi_features_extractor", None) or actor.features_extractor
    if name != "Gradient" and type(extractor).__name__ != "FlattenExtractor":
        raise _refused(f"the features extractor {type(extractor).__name__}")
    found: list[Layer] = []
    if name in ("PPO", "RecurrentPPO"):
        if name == "RecurrentPPO":
            found += _lstm(policy.lstm_actor)
        modules = [*_flat(policy.mlp_extractor.policy_net), *_flat(policy.action_net)]
        output = "tanh" if policy.squash_output else "clip"
    elif name == "Gradient":
        found += _gru(policy.memory) if policy.memory is not None else []
        modules, output = _flat(policy.net), "tanh"
    elif name == "TD3":
        modules, output = _flat(actor.mu), "tanh"
        if not isinstance(modules[-1], torch.nn.Tanh):
            raise _refused("an actor of TD3 that does not end in tanh")
        modules = modules[:-1]
    else:
        modules, output = [*_flat(actor.latent_pi), *_flat(actor.mu)], "tanh"
    for module in modules:
        if isinstance(module, torch.nn.Linear):
            weight = _array(module.weight)
            bias = np.zeros(len(weight), np.float32) if module.bias is None else _array(module.bias)
            found.append(Layer("linear", weight, bias))
        elif isinstance(module, torch.nn.Tanh | torch.nn.ReLU):
            if not found or found[-1].kind != "linear" or found[-1].activation != "none":
                raise _refused("an activation that follows no linear layer")
            found[-1] = found[-1]._replace(activation=type(module).__name__.lower())
        elif not isinstance(module, torch.nn.Identity | torch.nn.Flatten):
            raise _refused(f"the layer {type(module).__name__}")
    return tuple(found), output


def _flat(module: Any) -> list[Any]:
    """The modules of a (nested) sequence, in order."""
    import torch

    if isinstance(module, torch.nn.Sequential):
        return [inner for child in module for inner in _flat(child)]
    return [module]


def _lstm(module: Any) -> list[Layer]:
    if module.bidirectional or getattr(module, "proj_size", 0) or not module.bias or module.dropout:
        raise _refused("an LSTM that is bidirectional, projected, without bias, or with dropout")
    found = []
    for i in range(module.num_layers):
        parts = {k: _array(getattr(module, f"{k}_l{i}")) for k in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")}
        weight = np.concatenate([parts["weight_ih"], parts["weight_hh"]], axis=1)
        found.append(Layer("lstm", weight, parts["bias_ih"] + parts["bias_hh"]))
    return found


def _gru(module: Any) -> list[Layer]:
    """Reset, update, and the candidate's two shares apart, because the reset is between them."""
    parts = {k: _array(getattr(module, f"{k}_l0")) for k in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")}
    n, taken, given = module.hidden_size, parts["weight_ih"], parts["weight_hh"]
    gates = np.concatenate([taken[: 2 * n], given[: 2 * n]], axis=1)
    own = np.concatenate([taken[2 * n :], np.zeros((n, n), np.float32)], axis=1)
    past = np.concatenate([np.zeros((n, taken.shape[1]), np.float32), given[2 * n :]], axis=1)
    both = parts["bias_ih"][: 2 * n] + parts["bias_hh"][: 2 * n]
    bias = np.concatenate([both, parts["bias_ih"][2 * n :], parts["bias_hh"][2 * n :]])
    return [Layer("gru", np.concatenate([gates, own, past]), bias)]


def _array(tensor: Any) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32)


# ---------------------------------------------------------------------------------------------- the environment


def _environment(env: Any) -> tuple[Any, Normaliser | None, int]:
    """Batch, normaliser and frames of the environment that a model was trained in."""
    from stable_baselines3.common.vec_env import (
        DummyVecEnv,
        VecCheckNan,
        VecEnvWrapper,
        VecFrameStack,
        VecMonitor,
        VecNormalize,
    )

    normaliser, frames = None, 1
    while isinstance(env, VecEnvWrapper):
        if isinstance(env, VecNormalize):
            if env.norm_obs:
                statistics: Any = env.obs_rms
                if normaliser is not None or not hasattr(statistics, "mean"):
                    raise _refused("two normalisers, or one for a dictionary")
                mean = np.asarray(statistics.mean, np.float64)
                scale = np.sqrt(np.asarray(statistics.var, np.float64) + env.epsilon)
                normaliser = Normaliser(mean, scale, float(env.clip_obs))
        elif isinstance(env, VecFrameStack):
            if frames > 1:
                raise _refused("two frame stacks")
            frames = env.observation_space.shape[0] // env.venv.observation_space.shape[0]  # type: ignore[index]
        elif not isinstance(env, VecMonitor | VecCheckNan):
            raise _refused(f"the wrapper {type(env).__name__}")
        env = env.venv
    if isinstance(env, DummyVecEnv):
        env = env.envs[0]
    while isinstance(env, gym.Wrapper):
        if type(env).__name__ not in WRAPPERS:
            raise _refused(f"the wrapper {type(env).__name__}")
        env = env.env
    batch = getattr(env, "batch", None)
    if batch is None:
        raise InvalidInput(
            f"the model's environment is {type(env).__name__}; give one of kerfgym's as env=, in this process"
        )
    return batch, normaliser, frames


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in ("kerfgym", "stable-baselines3", "sb3-contrib", "torch", "numpy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _refused(what: str) -> InvalidInput:
    return InvalidInput(f"cannot export {what}; supported: {SUPPORTED}")
