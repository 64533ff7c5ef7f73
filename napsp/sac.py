"""Soft actor-critic (Haarnoja et al. 2018) for goal-conditioned rewards in [-1, 0]."""

from __future__ import annotations

import copy
import math

import torch
from torch import Tensor

from napsp.config import TrainConfig
from napsp.networks import Critic, GaussianPolicy, move_towards


class SAC:
    """Policy, twin critics with a slow copy, and the entropy weight alpha."""

    def __init__(self, sizes: tuple[int, int, int], config: TrainConfig) -> None:
        self.policy = GaussianPolicy(sizes, config.hidden)
        self.critic = Critic(sizes, config.hidden)
        self.target_critic = copy.deepcopy(self.critic).requires_grad_(False)
        rate = config.policy_learning_rate
        self.policy_optimizer = torch.optim.Adam(self.policy.parameters(), lr=rate, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.critic.parameters(), lr=rate, fused=True)
        self._fixed_alpha = config.entropy_weight
        self._min_log_alpha = math.log(config.min_entropy_weight)
        start = 0.1 if config.entropy_weight is None else config.entropy_weight
        self.log_alpha = torch.tensor(float(start)).log().requires_grad_(True)
        self.alpha_optimizer = torch.optim.Adam([self.log_alpha], lr=rate)
        self._target_entropy = -float(sizes[1])
        self._discount, self._polyak = config.discount, config.polyak
        # Rewards lie in [-1, 0], so no return leaves this interval; the entropy bonus could.
        self._value_range = (-1.0 / (1.0 - config.discount), 0.0) if config.clip_values else (-math.inf, math.inf)
        self._target_parameters = list(self.target_critic.parameters())
        self._critic_parameters = list(self.critic.parameters())

    @property
    def entropy_weight(self) -> float:
        """Alpha."""
        return float(self.log_alpha.detach().exp())

    def update(
        self,
        observations: Tensor,
        actions: Tensor,
        next_observations: Tensor,
        goals: Tensor,
        rewards: Tensor,
        generator: torch.Generator,
    ) -> dict[str, float]:
        """One update of critics, policy, alpha and target critics on B transitions.

        There is no terminal flag: goal reaching goes on after success, and a time limit is
        not an end of the task.
        """
        metrics = self._update_critic(observations, actions, next_observations, goals, rewards, generator)
        self._update_policy(observations, goals, generator)
        move_towards(self._target_parameters, self._critic_parameters, self._polyak)
        return metrics

    def _update_critic(
        self,
        observations: Tensor,
        actions: Tensor,
        next_observations: Tensor,
        goals: Tensor,
        rewards: Tensor,
        generator: torch.Generator,
    ) -> dict[str, float]:
        with torch.no_grad():
            next_actions, log_density = self.policy.sample(next_observations, goals, generator)
            next_values = self.target_critic(next_observations, next_actions, goals).amin(0)
            soft_values = next_values - self.entropy_weight * log_density
            targets = (rewards + self._discount * soft_values).clamp(*self._value_range)
        loss = (self.critic(observations, actions, goals) - targets).square().mean(-1).sum()
        self.critic_optimizer.zero_grad()
        loss.backward()
        self.critic_optimizer.step()
        return {"critic_loss": float(loss.detach()), "mean_value": float(targets.mean())}

    def _update_policy(self, observations: Tensor, goals: Tensor, generator: torch.Generator) -> None:
        actions, log_density = self.policy.sample(observations, goals, generator)
        for parameter in self._critic_parameters:
            parameter.requires_grad_(False)  # saves the weight gradients of a critic nobody updates here
        values = self.critic(observations, actions, goals).amin(0)
        loss = (self.entropy_weight * log_density - values).mean()
        self.policy_optimizer.zero_grad()
        loss.backward()
        self.policy_optimizer.step()
        for parameter in self._critic_parameters:
            parameter.requires_grad_(True)
        if self._fixed_alpha is None:
            surplus = -(log_density.detach().mean() + self._target_entropy)
            alpha_loss = self.log_alpha * surplus
            # alpha falls while the policy's entropy exceeds the target, and rises below it.
            self.alpha_optimizer.zero_grad()
            alpha_loss.backward()
            self.alpha_optimizer.step()
            with torch.no_grad():
                self.log_alpha.clamp_(min=self._min_log_alpha)
