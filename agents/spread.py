"""A policy of PPO whose exploration depends on the situation.

stable-baselines3's own has one standard deviation for all observations. What a policy must try on a wavy sheet to learn
anything shakes the head on a level one by more than everything else there; so here the logarithm of the deviation is
linear in the last hidden layer, and begins the same everywhere. The deterministic policy, which is what is exported,
has the same form as without.
"""

from typing import Any

import torch
from stable_baselines3.common.distributions import DiagGaussianDistribution, Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

LEAST, MOST = -7.0, 0.0
"""Limits of the deviation's logarithm, of an action of −1 … 1."""

QUICK = 10.0
"""How much faster than the action the deviation learns: with the same rate it would hardly change within a training."""


class SpreadPolicy(ActorCriticPolicy):
    """``MlpPolicy`` with a standard deviation that is learned as a function of the observation."""

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        width = len(self.log_std)  # one for each action
        self.spread_net = nn.Linear(self.mlp_extractor.latent_dim_pi, width, bias=False)
        nn.init.zeros_(self.spread_net.weight)
        every = [*self.parameters()]  # the optimiser was made before there was this layer
        self.optimizer = self.optimizer_class(every, lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor) -> Distribution:
        assert isinstance(self.action_dist, DiagGaussianDistribution)
        # What the hidden layers are is up to the action alone.
        log_std = (self.log_std + QUICK * self.spread_net(latent_pi.detach())).clamp(LEAST, MOST)
        return self.action_dist.proba_distribution(self.action_net(latent_pi), log_std)
