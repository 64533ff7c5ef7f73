"""Soft actor-critic (Haarnoja et al. 2018) for goal-conditioned rewards in [-1, 0]."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from napsp.execution import Execution, Slow, descend, held, mean
from napsp.networks import rescale
from napsp.policy.actors import GaussianPolicy, squash
from napsp.policy.agent import PolicyBatch, PolicyConfig
from napsp.policy.critic import Critic
from napsp.scaling import Scaling

Metrics = dict[str, Tensor]


class SAC:
    """Policy, twin critics with a slow copy, and the entropy weight alpha.

    Args:
        sizes: of observation, action and goal.
        hidden: widths of the hidden layers.
        config: settings.
        lost_step: what one lost step costs in return, the unit of alpha's floor.
        execution: device and so on.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        hidden: tuple[int, ...],
        config: PolicyConfig,
        lost_step: float = 1.0,
        execution: Execution | None = None,
    ) -> None:
        execution = execution or Execution()
        self.device, self.config = execution.torch_device, config
        self.policy = GaussianPolicy(sizes, hidden).to(self.device)
        self.critic = Critic(sizes, hidden, n_critics=2).to(self.device)
        self._slow_critic = Slow(self.critic, config.polyak)
        self.target_critic = self._slow_critic.network
        self._critic_parameters = list(self.critic.parameters())
        start = 0.1 if config.entropy_weight is None else config.entropy_weight
        self.log_alpha = torch.tensor(float(start), dtype=torch.float32, device=self.device).log().requires_grad_()
        self.min_log_alpha = math.log(config.min_entropy_weight * lost_step)
        self.target_entropy = -float(sizes[1])
        self.adapts = config.entropy_weight is None
        adapted = [self.log_alpha] if self.adapts else []  # in one step with the policy: neither asks the other
        self.optimizers = {
            "policy_optimizer": execution.adam([*self.policy.parameters(), *adapted], config.learning_rate),
            "critic_optimizer": execution.adam(self.critic.parameters(), config.learning_rate),
        }
        self._critic_loss, self._policy_loss = execution.loss(critic_loss), execution.loss(policy_loss)
        self._update = execution.update(self._update_once)

    @property
    def trusted(self) -> GaussianPolicy:
        """The policy: it has no slow copy."""
        return self.policy

    def train(self, transitions: PolicyBatch, batch_size: int, generator: torch.Generator) -> dict[str, float]:
        """Update everything once per batch of raw transitions ``(n * batch_size, .)``; figures to log.

        Goal reaching goes on after success and beyond a time limit, unless the batch says that nothing follows.
        """
        noise = torch.randn((2, *transitions.actions.shape), generator=generator, dtype=torch.float32).to(self.device)
        batches = transitions.scaled(self.policy.scaling).split(batch_size)
        draws = noise.split(batch_size, dim=1)
        rows = [self._update(*batch, draw) for batch, draw in zip(batches, draws, strict=True)]
        return {name: mean([row[name] for row in rows]) for name in rows[0]}

    def _update_once(self, *tensors: Tensor) -> Metrics:
        """Critics, policy, alpha, target critics, from a scaled batch and the noise of two samples ``(2, B, A)``."""
        batch, (next_noise, noise) = PolicyBatch(*tensors[:-1]), tensors[-1]
        alpha = self.log_alpha.detach().exp()
        loss, metrics = self._critic_loss(self, batch, next_noise, alpha)
        descend(loss, self.optimizers["critic_optimizer"])
        with held(self._critic_parameters):
            loss, log_density = self._policy_loss(self, batch, noise, alpha)
            loss = loss + alpha_loss(self, log_density) if self.adapts else loss
            descend(loss, self.optimizers["policy_optimizer"])
        if self.adapts:
            with torch.no_grad():
                self.log_alpha.clamp_(min=self.min_log_alpha)
        self._slow_critic.follow()
        return {**metrics, "entropy_weight": alpha}

    def rescale(self, scaling: Scaling) -> None:
        """Read inputs under another scaling, with the same actions and values."""
        for network in (self.policy, self.critic, self.target_critic):
            rescale(network, scaling)

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        return {"policy": self.policy, "critic": self.critic, "target_critic": self.target_critic}

    def tensors(self) -> dict[str, Tensor]:
        """What else belongs to the agent's state."""
        return {"log_alpha": self.log_alpha}


def critic_loss(sac: SAC, batch: PolicyBatch, noise: Tensor, alpha: Tensor) -> tuple[Tensor, Metrics]:
    """Squared errors of both critics against r + discount * (min Q'(s', a') - alpha log pi(a')), a' ~ pi(s').

    Metrics: the second critic's mean squared error, and the mean target.
    """
    with torch.no_grad():
        outputs = sac.policy.outputs(batch.next_observations, batch.goals)
        actions, log_density, _ = squash(outputs, noise)
        next_values = sac.target_critic.values(batch.next_observations, actions, batch.goals).amin(0)
        limits = sac.config.values_range
        targets = batch.targets(next_values - alpha * log_density, sac.config.discount, limits)
    errors = (sac.critic.values(batch.observations, batch.actions, batch.goals) - targets).square()
    return errors.mean(1).sum(), {"critic_loss": errors[-1].mean().detach(), "mean_value": targets.mean()}


def policy_loss(sac: SAC, batch: PolicyBatch, noise: Tensor, alpha: Tensor) -> tuple[Tensor, Tensor]:
    """Mean of alpha log pi(a) - min Q(s, a), a ~ pi(s); and log pi(a) ``(B,)``."""
    actions, log_density, _ = squash(sac.policy.outputs(batch.observations, batch.goals), noise)
    values = sac.critic.values(batch.observations, actions, batch.goals).amin(0)
    return (alpha * log_density - values).mean(), log_density.detach()


def alpha_loss(sac: SAC, log_density: Tensor) -> Tensor:
    """Alpha falls while the policy's entropy exceeds the target, and rises below it."""
    return -sac.log_alpha * (log_density.mean() + sac.target_entropy)
