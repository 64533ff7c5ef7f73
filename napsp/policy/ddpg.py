"""Deep deterministic policy gradient (Lillicrap et al. 2016), as HER uses it for pick-and-place."""

from __future__ import annotations

import copy

import torch
from torch import Tensor

from napsp.backprop import Adam, Backprop, flatten
from napsp.compiled import compiled
from napsp.config import TrainConfig
from napsp.policy.actors import DeterministicPolicy
from napsp.policy.agent import PolicyBatch, critic_targets_range
from napsp.policy.critic import Critic


class DDPG:
    """Deterministic policy and one critic, or two, each with a slow copy.

    With ``clipped_double_q`` the critics learn from the smaller of two values (Fujimoto et al. 2018)
    and the policy follows the first. One critic alone overrates states that it sees with few of their
    goals, and rewards -d / T, with their small differences, seldom correct it.
    """

    def __init__(self, sizes: tuple[int, int, int], config: TrainConfig) -> None:
        self.policy = DeterministicPolicy(sizes, config.hidden, config.action_noise)
        self.critic = Critic(sizes, config.hidden, 1 + config.clipped_double_q)
        self.target_policy, self.target_critic = copy.deepcopy(self.policy), copy.deepcopy(self.critic)
        self._vectors = [flatten([self.policy]), flatten([self.critic])]
        self._target_vectors = [flatten([self.target_policy]), flatten([self.target_critic])]
        self.optimizers = {
            "policy_optimizer": Adam(self._vectors[0], config.policy_learning_rate),
            "critic_optimizer": Adam(self._vectors[1], config.policy_learning_rate),
        }
        self._policy = Backprop(self.policy.net, self._vectors[0])
        self._critics = [Backprop(net, self._vectors[1]) for net in self.critic.nets]
        self._next_policy = Backprop(self.target_policy.net, self._target_vectors[0])
        self._next_critics = [Backprop(net, self._target_vectors[1]) for net in self.target_critic.nets]
        self._discount, self._polyak = config.discount, config.polyak
        self._action_penalty = config.action_penalty
        self._value_range = critic_targets_range(config)
        self._step = compiled(self._gradient_step, config.compiled)

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        return {
            "policy": self.policy,
            "critic": self.critic,
            "target_policy": self.target_policy,
            "target_critic": self.target_critic,
        }

    def tensors(self) -> dict[str, Tensor]:
        """Nothing beside the networks."""
        return {}

    @torch.no_grad()
    def update(self, batch: PolicyBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """One update of critic, policy and their targets; no terminal flag, as in SAC."""
        del generator  # deterministic
        return self._step(batch)

    def _gradient_step(self, batch: PolicyBatch) -> dict[str, Tensor]:
        metrics = self._update_critic(batch)
        self._update_policy(batch)
        for target, vector in zip(self._target_vectors, self._vectors, strict=True):
            target.lerp_(vector, self._polyak)
        return metrics

    def _update_critic(self, batch: PolicyBatch) -> dict[str, Tensor]:
        states = batch.next_observations
        next_actions = self._next_policy.forward(torch.cat([states, batch.goals], dim=1))[0].tanh()
        inputs = torch.cat([states, next_actions, batch.goals], dim=1)
        next_values = torch.stack([critic.forward(inputs)[0] for critic in self._next_critics]).amin(0)
        targets = batch.rewards.unsqueeze(1) + self._discount * next_values
        targets = targets.clamp(*self._value_range)
        inputs = torch.cat([batch.observations, batch.actions, batch.goals], dim=1)
        losses, gradients = [], []
        for critic in self._critics:
            values, tape = critic.forward(inputs)
            errors = values - targets
            gradients += critic.gradients(tape, critic.slopes(tape, errors * (2.0 / len(errors))))
            losses.append(errors.square().mean())
        self.optimizers["critic_optimizer"].update(gradients)
        return {"critic_loss": torch.stack(losses).mean(), "mean_value": targets.mean()}

    def _update_policy(self, batch: PolicyBatch) -> None:
        """Descend mean(-Q(s, tanh(u), g)) + penalty * mean(tanh(u)^2)."""
        outputs, policy_tape = self._policy.forward(torch.cat([batch.observations, batch.goals], dim=1))
        actions = outputs.tanh()
        critic = self._critics[0]
        values, tape = critic.forward(torch.cat([batch.observations, actions, batch.goals], dim=1))
        width = batch.observations.shape[1]
        columns = slice(width, width + actions.shape[1])
        value_slope = critic.input_slope(critic.slopes(tape, torch.ones_like(values)), columns)
        slope = (2.0 * self._action_penalty / actions.shape[1]) * actions - value_slope
        slopes = self._policy.slopes(policy_tape, slope * (1.0 - actions.square()) / len(actions))
        self.optimizers["policy_optimizer"].update(self._policy.gradients(policy_tape, slopes))
