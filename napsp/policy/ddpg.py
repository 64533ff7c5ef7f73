"""Deep deterministic policy gradient (Lillicrap et al. 2016), as HER uses it for pick-and-place."""

from __future__ import annotations

import torch
from torch import Tensor

from napsp.execution import Execution, Slow, descend, held, mean
from napsp.networks import rescale
from napsp.policy.actors import DeterministicPolicy
from napsp.policy.agent import PolicyBatch, PolicyConfig
from napsp.policy.critic import Critic
from napsp.scaling import Scaling

Metrics = dict[str, Tensor]


class DDPG:
    """Deterministic policy and one critic, or two, each with a slow copy.

    With ``clipped_double_q`` the critics learn from the smaller of two values (Fujimoto et al. 2018)
    and the policy follows the first. One critic alone overrates states that it sees with few of their
    goals, and rewards -d / T, with their small differences, seldom correct it.

    Args:
        sizes: of observation, action and goal.
        hidden: widths of the hidden layers.
        config: settings.
        lost_step: as for SAC; there is no entropy here.
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
        execution, self.config = execution or Execution(), config
        device = execution.torch_device
        self.policy = DeterministicPolicy(sizes, hidden, config.action_noise).to(device)
        self.critic = Critic(sizes, hidden, 1 + config.clipped_double_q).to(device)
        slow_policy, slow_critic = Slow(self.policy, config.polyak), Slow(self.critic, config.polyak)
        self.target_policy, self.target_critic = slow_policy.network, slow_critic.network
        self._slow = slow_policy, slow_critic
        self._critic_parameters = list(self.critic.parameters())
        self.optimizers = {
            "policy_optimizer": execution.adam(self.policy.parameters(), config.learning_rate),
            "critic_optimizer": execution.adam(self.critic.parameters(), config.learning_rate),
        }
        self._critic_loss, self._policy_loss = execution.loss(critic_loss), execution.loss(policy_loss)
        self._update = execution.update(self._update_once)

    @property
    def trusted(self) -> DeterministicPolicy:
        """See :class:`napsp.policy.agent.Agent`."""
        return self.target_policy if self.config.slow else self.policy

    def train(self, transitions: PolicyBatch, batch_size: int, generator: torch.Generator) -> dict[str, float]:
        """Update everything once per batch of raw transitions; ends are treated as in SAC."""
        del generator  # deterministic
        batches = transitions.scaled(self.policy.scaling).split(batch_size)
        rows = [self._update(*batch) for batch in batches]
        return {name: mean([row[name] for row in rows]) for name in rows[0]}

    def _update_once(self, *tensors: Tensor) -> Metrics:
        """Critics, policy, and the slow copies of both, from a scaled batch."""
        batch = PolicyBatch(*tensors)
        loss, metrics = self._critic_loss(self, batch)
        descend(loss, self.optimizers["critic_optimizer"])
        with held(self._critic_parameters):
            descend(self._policy_loss(self, batch), self.optimizers["policy_optimizer"])
        for slow in self._slow:
            slow.follow()
        return metrics

    def rescale(self, scaling: Scaling) -> None:
        """Read inputs under another scaling, with the same actions and values."""
        for network in (self.policy, self.critic, self.target_policy, self.target_critic):
            rescale(network, scaling)

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        names = ("policy", "critic", "target_policy", "target_critic")
        return {name: getattr(self, name) for name in names}

    def tensors(self) -> dict[str, Tensor]:
        """Nothing beside the networks."""
        return {}


def critic_loss(ddpg: DDPG, batch: PolicyBatch) -> tuple[Tensor, Metrics]:
    """Squared errors of the critics against r + discount * min Q'(s', pi'(s'))."""
    with torch.no_grad():
        next_actions = ddpg.target_policy.outputs(batch.next_observations, batch.goals).tanh()
        next_values = ddpg.target_critic.values(batch.next_observations, next_actions, batch.goals).amin(0)
        targets = batch.targets(next_values, ddpg.config.discount, ddpg.config.values_range)
    errors = (ddpg.critic.values(batch.observations, batch.actions, batch.goals) - targets).square()
    return errors.mean(1).sum(), {"critic_loss": errors.mean().detach(), "mean_value": targets.mean()}


def policy_loss(ddpg: DDPG, batch: PolicyBatch) -> Tensor:
    """Mean of -Q(s, a) + penalty * a^2, a = pi(s), by the first critic."""
    actions = ddpg.policy.outputs(batch.observations, batch.goals).tanh()
    values = ddpg.critic.first(batch.observations, actions, batch.goals)
    return ddpg.config.action_penalty * actions.square().mean() - values.mean()
