"""Soft actor-critic (Haarnoja et al. 2018) for goal-conditioned rewards in [-1, 0]."""

from __future__ import annotations

import copy
import math

import torch
from torch import Tensor

from napsp.agent import PolicyBatch, critic_targets_range
from napsp.backprop import Backprop, adam, flatten
from napsp.config import TrainConfig
from napsp.networks import Critic, GaussianPolicy, squash


class SAC:
    """Policy, twin critics with a slow copy, and the entropy weight alpha."""

    def __init__(self, sizes: tuple[int, int, int], config: TrainConfig) -> None:
        self.policy = GaussianPolicy(sizes, config.hidden)
        self.critic = Critic(sizes, config.hidden, n_critics=2)
        self.target_critic = copy.deepcopy(self.critic)
        self._critic_vector, self._target_vector = flatten([self.critic]), flatten([self.target_critic])
        self.optimizers = {
            "policy_optimizer": adam(flatten([self.policy]), config.policy_learning_rate),
            "critic_optimizer": adam(self._critic_vector, config.policy_learning_rate),
        }
        self._policy = Backprop(self.policy.net)
        self._critics = [Backprop(net) for net in self.critic.nets]
        self._targets = [Backprop(net) for net in self.target_critic.nets]
        self._min_log_alpha = math.log(config.min_entropy_weight)
        start = 0.1 if config.entropy_weight is None else config.entropy_weight
        self.log_alpha = torch.tensor(float(start)).log()
        if config.entropy_weight is None:
            self.log_alpha.grad = torch.zeros(())
            self.optimizers["alpha_optimizer"] = adam(self.log_alpha, config.policy_learning_rate)
        self._target_entropy = -float(sizes[1])
        self._discount, self._polyak = config.discount, config.polyak
        self._value_range = critic_targets_range(config)

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        return {"policy": self.policy, "critic": self.critic, "target_critic": self.target_critic}

    def tensors(self) -> dict[str, Tensor]:
        """What else belongs to the agent's state."""
        return {"log_alpha": self.log_alpha}

    @torch.no_grad()
    def update(self, batch: PolicyBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """One update of critics, policy, alpha and target critics.

        There is no terminal flag: goal reaching goes on after success, and a time limit is
        not an end of the task.
        """
        alpha, n = self.log_alpha.exp(), len(batch.rewards)
        # The policy does not change before both of its passes are done, so they are one pass.
        states = torch.cat([batch.next_observations, batch.observations])
        outputs, tape = self._policy.forward(torch.cat([states, batch.goals.repeat(2, 1)], dim=1))
        actions, log_density, noise, log_std = squash(outputs, generator)
        metrics = self._update_critics(batch, actions[:n], log_density[:n], alpha)
        current = slice(n, None)
        value_slope = self._value_slope(batch, actions[current])
        slopes = _policy_slopes(
            outputs[current], actions[current], noise[current], log_std[current], value_slope, alpha
        )
        self._policy.backward(tape.part(current), slopes)
        self.optimizers["policy_optimizer"].step()
        self._update_alpha(log_density[current])
        self._target_vector.lerp_(self._critic_vector, self._polyak)
        return {**metrics, "entropy_weight": alpha}

    def _update_critics(
        self, batch: PolicyBatch, next_actions: Tensor, log_density: Tensor, alpha: Tensor
    ) -> dict[str, Tensor]:
        inputs = torch.cat([batch.next_observations, next_actions, batch.goals], dim=1)
        next_values = torch.minimum(*(target.forward(inputs)[0] for target in self._targets)).squeeze(1)
        targets = batch.rewards + self._discount * (next_values - alpha * log_density)
        targets = targets.clamp(*self._value_range).unsqueeze(1)
        inputs = torch.cat([batch.observations, batch.actions, batch.goals], dim=1)
        for critic in self._critics:
            values, tape = critic.forward(inputs)
            errors = values - targets
            critic.backward(tape, errors * (2.0 / len(errors)))
        self.optimizers["critic_optimizer"].step()
        return {"critic_loss": errors.square().mean(), "mean_value": targets.mean()}

    def _value_slope(self, batch: PolicyBatch, actions: Tensor) -> Tensor:
        """Return d min Q / d a ``(B, A)``: that of the critic with the smaller value, row by row."""
        inputs = torch.cat([batch.observations, actions, batch.goals], dim=1)
        (first, first_tape), (second, second_tape) = (critic.forward(inputs) for critic in self._critics)
        chosen, width = (first < second).to(first.dtype), batch.observations.shape[1]
        columns = slice(width, width + actions.shape[1])
        slope = self._critics[0].backward(first_tape, chosen, parameters=False, inputs=columns)
        return slope + self._critics[1].backward(second_tape, 1.0 - chosen, parameters=False, inputs=columns)

    def _update_alpha(self, log_density: Tensor) -> None:
        """Alpha falls while the policy's entropy exceeds the target, and rises below it."""
        if "alpha_optimizer" in self.optimizers:
            # The gradient of -log_alpha * (log pi + target entropy).
            self.log_alpha.grad = -(log_density.mean() + self._target_entropy)
            self.optimizers["alpha_optimizer"].step()
            self.log_alpha.clamp_(min=self._min_log_alpha)


def _policy_slopes(
    outputs: Tensor, actions: Tensor, noise: Tensor, log_std: Tensor, value_slope: Tensor, alpha: Tensor
) -> Tensor:
    """Gradient of mean(alpha * log pi(a) - min Q(a)), a = tanh(mean + std * noise), by the outputs ``(B, 2 A)``."""
    # Before tanh: log pi grows by 2 tanh(u) du (the squashing), Q by Q'(a) (1 - tanh(u)^2) du.
    mean_slope = (alpha * 2.0 * actions - value_slope * (1.0 - actions.square())) / len(actions)
    log_std_slope = mean_slope * log_std.exp() * noise - alpha / len(actions)
    inside = outputs[:, actions.shape[1] :] == log_std  # no gradient through the clamp
    return torch.cat([mean_slope, log_std_slope * inside], dim=1)
