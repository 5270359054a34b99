"""The learner of stable-baselines3 (Raffin et al. 2021) or sb3-contrib that settings ask for, and its first policy."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..envs.engine.quantity import InvalidInput
from ..envs.safety import files
from .settings import PRESETS, Settings, algorithm_class, environment_class

NUM_ENVS = 64
"""Environments unless the settings say otherwise."""


def environment(settings: Settings, **changes: Any) -> Any:
    """The native VecEnv of the settings, with some arguments changed.

    Raises:
        InvalidInput: an argument that the environment refuses.
    """
    arguments = {"num_envs": NUM_ENVS, **settings.environment, **changes}
    if "scenario" in arguments:
        arguments["scenario"] = _found(arguments["scenario"])
    return environment_class(settings.env)(arguments.pop("num_envs"), **arguments)


def _found(scenario: Any) -> Any:
    """A scenario or several, files of the presets' own in place of their names."""
    if isinstance(scenario, list):
        return [_found(each) for each in scenario]
    if not isinstance(scenario, str) or not scenario.endswith(".toml") or files.is_file(scenario):
        return scenario
    mine = PRESETS / "scenarios" / scenario
    return str(mine) if files.is_file(mine) else scenario


def falling(first: float, last: float) -> Callable[[float], float]:
    """Learning rate over the share of training that is left: geometric from ``first`` to ``last``."""

    def rate(left: float) -> float:
        return last * (first / last) ** left

    return rate


def learner(settings: Settings, env: Any, seed: int, device: str = "cpu") -> Any:
    """An untrained model on ``env``.

    Raises:
        InvalidInput: an algorithm's or network's argument that the library refuses, or an unknown device.
    """
    import torch
    from stable_baselines3.common.noise import NormalActionNoise
    from torch import nn

    options, network = dict(settings.algorithm), dict(settings.policy)
    if "final_learning_rate" in options:
        last = options.pop("final_learning_rate")
        options["learning_rate"] = falling(options.get("learning_rate", 3e-4), last)
    if "noise" in options:
        width = env.action_space.shape[0]
        options["action_noise"] = NormalActionNoise(np.zeros(width), np.full(width, options.pop("noise")))
    spread, gain = network.pop("spread", None), network.pop("output_gain", 1.0)
    network["activation_fn"] = {"tanh": nn.Tanh, "relu": nn.ReLU}[network.pop("activation", "tanh")]
    policy: Any = "MlpLstmPolicy" if settings.name == "recurrent-ppo" else "MlpPolicy"
    if network.pop("spread_by_state", False):
        from .spread import SpreadPolicy

        policy = SpreadPolicy
    try:
        torch.empty(0, device=device)  # the library would take the processor where there is no such device
    except (RuntimeError, AssertionError) as error:
        reason = str(error).split("\n")[0]
        raise InvalidInput(f"device '{device}' cannot be used: {reason}; cpu always can") from error
    try:
        model = algorithm_class(settings.name)(policy, env, seed=seed, device=device, policy_kwargs=network, **options)
    except (TypeError, ValueError, AssertionError, RuntimeError) as error:
        reason = str(error).split("\n")[0] or type(error).__name__
        raise InvalidInput(f"{settings.name} refuses its settings: {reason}") from error
    with torch.no_grad():
        _begin(model, gain, None if spread is None else torch.as_tensor(_spreads(spread, env)).log())
    return model


def _spreads(spread: float | list[float], env: Any) -> np.ndarray:
    """One number for each action.

    Raises:
        InvalidInput: not as many numbers as actions.
    """
    width = env.action_space.shape[0]
    if isinstance(spread, list) and len(spread) != width:
        raise InvalidInput(f"policy.spread has {len(spread)} numbers; one, or {width}, one for each action")
    return np.broadcast_to(np.asarray(spread, np.float32), width).copy()


def _begin(model: Any, gain: float, log_spread: Any) -> None:
    """Scales the action's layer, and sets the spread of the first actions."""
    policy = model.policy
    if hasattr(policy, "net"):  # gradient
        policy.net[-1].weight.mul_(gain)
        policy.net[-1].bias.mul_(gain)
        return
    if hasattr(policy, "action_net"):  # PPO
        policy.action_net.weight.mul_(gain)
        if log_spread is not None:
            policy.log_std.copy_(log_spread)
        return
    last = policy.actor.mu
    last = last if hasattr(last, "weight") else [layer for layer in last if hasattr(layer, "weight")][-1]  # TD3
    last.weight.mul_(gain)
    last.bias.mul_(gain)
    if log_spread is not None and hasattr(policy.actor, "log_std"):  # SAC, TQC
        policy.actor.log_std.weight.mul_(gain)
        policy.actor.log_std.bias.copy_(log_spread)
    if hasattr(policy, "actor_target"):
        policy.actor_target.load_state_dict(policy.actor.state_dict())
