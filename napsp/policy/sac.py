"""Soft actor-critic (Haarnoja et al. 2018) for goal-conditioned rewards in [-1, 0]."""

from __future__ import annotations

import copy
import math

import torch
from torch import Tensor

from napsp.backprop import Adam, Backprop, flatten
from napsp.compiled import compiled
from napsp.config import TrainConfig
from napsp.policy.actors import GaussianPolicy, squash
from napsp.policy.agent import PolicyBatch, critic_targets_range
from napsp.policy.critic import Critic


class SAC:
    """Policy, twin critics with a slow copy, and the entropy weight alpha."""

    def __init__(self, sizes: tuple[int, int, int], config: TrainConfig) -> None:
        self.policy = GaussianPolicy(sizes, config.hidden)
        self.critic = Critic(sizes, config.hidden, n_critics=2)
        self.target_critic = copy.deepcopy(self.critic)
        vectors = [flatten([network]) for network in (self.policy, self.critic, self.target_critic)]
        self._critic_vector, self._target_vector = vectors[1:]
        self.optimizers = {
            "policy_optimizer": Adam(vectors[0], config.policy_learning_rate),
            "critic_optimizer": Adam(vectors[1], config.policy_learning_rate),
        }
        self._policy = Backprop(self.policy.net, vectors[0])
        self._critics = [Backprop(net, vectors[1]) for net in self.critic.nets]
        self._targets = [Backprop(net, vectors[2]) for net in self.target_critic.nets]
        self._min_log_alpha = math.log(config.min_entropy_weight)
        start = 0.1 if config.entropy_weight is None else config.entropy_weight
        self.log_alpha = torch.tensor(float(start)).log()
        if config.entropy_weight is None:
            self.optimizers["alpha_optimizer"] = Adam(self.log_alpha, config.policy_learning_rate)
        self._target_entropy = -float(sizes[1])
        self._discount, self._polyak = config.discount, config.polyak
        self._value_range = critic_targets_range(config)
        self._step = compiled(self._gradient_step, config.compiled)

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
        noise = torch.randn((2 * len(batch.rewards), batch.actions.shape[1]), generator=generator)
        return self._step(batch, noise)

    def _gradient_step(self, batch: PolicyBatch, noise: Tensor) -> dict[str, Tensor]:
        alpha, n = self.log_alpha.exp(), len(batch.rewards)
        # The policy does not change before both of its passes are done, so they are one pass.
        states = torch.cat([batch.next_observations, batch.observations])
        outputs, tape = self._policy.forward(torch.cat([states, batch.goals.repeat(2, 1)], dim=1))
        actions, log_density, log_std = squash(outputs, noise)
        metrics = self._update_critics(batch, actions[:n], log_density[:n], alpha)
        current = slice(n, None)
        value_slope = self._value_slope(batch, actions[current])
        outputs_slope = _outputs_slope(
            outputs[current], actions[current], noise[current], log_std[current], value_slope, alpha
        )
        tape = tape.part(current)
        slopes = self._policy.slopes(tape, outputs_slope)
        self.optimizers["policy_optimizer"].update(self._policy.gradients(tape, slopes))
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
        gradients = []
        for critic in self._critics:
            values, tape = critic.forward(inputs)
            errors = values - targets
            gradients += critic.gradients(tape, critic.slopes(tape, errors * (2.0 / len(errors))))
        self.optimizers["critic_optimizer"].update(gradients)
        return {"critic_loss": errors.square().mean(), "mean_value": targets.mean()}

    def _value_slope(self, batch: PolicyBatch, actions: Tensor) -> Tensor:
        """Return d min Q / d a ``(B, A)``: that of the critic with the smaller value, row by row."""
        inputs = torch.cat([batch.observations, actions, batch.goals], dim=1)
        (first, first_tape), (second, second_tape) = (critic.forward(inputs) for critic in self._critics)
        chosen, width = (first < second).to(first.dtype), batch.observations.shape[1]
        columns = slice(width, width + actions.shape[1])
        first_slopes = self._critics[0].slopes(first_tape, chosen)
        second_slopes = self._critics[1].slopes(second_tape, 1.0 - chosen)
        return self._critics[0].input_slope(first_slopes, columns) + self._critics[1].input_slope(
            second_slopes, columns
        )

    def _update_alpha(self, log_density: Tensor) -> None:
        """Alpha falls while the policy's entropy exceeds the target, and rises below it."""
        if "alpha_optimizer" in self.optimizers:
            # The gradient of -log_alpha * (log pi + target entropy).
            self.optimizers["alpha_optimizer"].update([-(log_density.mean() + self._target_entropy)])
            self.log_alpha.clamp_(min=self._min_log_alpha)


def _outputs_slope(
    outputs: Tensor, actions: Tensor, noise: Tensor, log_std: Tensor, value_slope: Tensor, alpha: Tensor
) -> Tensor:
    """Gradient of mean(alpha * log pi(a) - min Q(a)), a = tanh(mean + std * noise), by the outputs ``(B, 2 A)``."""
    # Before tanh: log pi grows by 2 tanh(u) du (the squashing), Q by Q'(a) (1 - tanh(u)^2) du.
    mean_slope = (alpha * 2.0 * actions - value_slope * (1.0 - actions.square())) / len(actions)
    log_std_slope = mean_slope * log_std.exp() * noise - alpha / len(actions)
    inside = outputs[:, actions.shape[1] :] == log_std  # no gradient through the clamp
    return torch.cat([mean_slope, log_std_slope * inside], dim=1)
