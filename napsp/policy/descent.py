"""Distance and critic in one: networks d_k in steps that bootstrap, and a policy that descends d. Beyond the paper."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from napsp.distance.labels import BootstrapConfig, one_step_label
from napsp.distance.learned import LearnedDistance
from napsp.distance.losses import LOSSES, Labelled
from napsp.execution import Execution, Slow, descend, held, mean
from napsp.networks import InputScaling, rescale
from napsp.policy.actors import DeterministicPolicy
from napsp.policy.agent import PolicyConfig
from napsp.scaling import Scaling

Metrics = dict[str, Tensor]


class DescentBatch(NamedTuple):
    """B goal-relabelled transitions, scaled for the networks, and what is known of their distances.

    Attributes:
        observations: ``(B, O)``.
        actions: ``(B, A)``.
        next_observations: ``(B, O)``.
        goals: ``(B, G)``.
        arrived: whether the next state is at the goal, bool ``(B,)``.
        observed: steps after which the same episode was at the goal, ``(B,)``; +inf where it was not.
        known: 1 + steps of the graph from the next state, ``(B,)``; NaN where it knows no path.
        next_achieved: achieved goal of the next state, ``(B, G)``.
        ended: 0 where the episode ended at the goal, 1 where nothing is reached any more, NaN elsewhere, ``(B,)``.
    """

    observations: Tensor
    actions: Tensor
    next_observations: Tensor
    goals: Tensor
    arrived: Tensor
    observed: Tensor
    known: Tensor
    next_achieved: Tensor
    ended: Tensor

    def scaled(self, scaling: InputScaling) -> DescentBatch:
        """The same as the networks read it, on their device."""
        device = scaling.observation_mean.device
        rows = DescentBatch(*(part.to(device) for part in self))
        observations, goals = scaling(rows.observations, rows.goals)
        following, achieved = scaling(rows.next_observations, rows.next_achieved)
        return rows._replace(
            observations=observations, goals=goals, next_observations=following, next_achieved=achieved
        )

    def split(self, size: int) -> list[DescentBatch]:
        """Batches of ``size`` transitions (views)."""
        return [DescentBatch(*part) for part in zip(*(rows.split(size) for rows in self), strict=True)]


class Descent:
    """A deterministic policy that descends the first of K distances, each with a slow copy.

    There is no reward, no discount and no further critic. The mean of the slow copies is the distance that is saved.

    Args:
        sizes: of observation, action and goal.
        hidden: widths of the hidden layers.
        config: settings of the policy.
        bootstrap: settings of the labels.
        distance: its networks are trained here.
        loss: of the distances, a name in :data:`napsp.distance.losses.LOSSES`.
        execution: device and so on.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        hidden: tuple[int, ...],
        config: PolicyConfig,
        bootstrap: BootstrapConfig,
        distance: LearnedDistance,
        loss: str,
        execution: Execution | None = None,
    ) -> None:
        execution, self.config, self.bootstrap = execution or Execution(), config, bootstrap
        self.learned, self.distance, self.target_distance = distance, distance.distance, distance.target_distance
        self.policy = DeterministicPolicy(sizes, hidden, config.action_noise).to(execution.torch_device)
        self._slow = Slow(self.policy, config.polyak)
        self.target_policy = self._slow.network
        self._distance_parameters = list(self.distance.parameters())
        self.optimizers = {"policy_optimizer": execution.adam(self.policy.parameters(), config.learning_rate)}
        self._fit = LOSSES[loss]
        self._distance_loss, self._policy_loss = execution.loss(distance_loss), execution.loss(policy_loss)
        self._update = execution.update(self._update_once)

    @property
    def trusted(self) -> DeterministicPolicy:
        """See :class:`napsp.policy.agent.Agent`."""
        return self.target_policy if self.config.slow else self.policy

    def train(self, transitions: DescentBatch, batch_size: int, generator: torch.Generator) -> dict[str, float]:
        """Update everything once per batch of raw transitions ``(n * batch_size, .)``; figures to log."""
        del generator  # deterministic
        figures = [self._update(*batch) for batch in transitions.scaled(self.policy.scaling).split(batch_size)]
        return {name: mean([row[name] for row in figures]) for name in figures[0]}

    def _update_once(self, *tensors: Tensor) -> Metrics:
        """Distances, policy, and the slow copies of both, from a scaled batch."""
        batch = DescentBatch(*tensors)
        loss, metrics = self._distance_loss(self, batch)
        descend(loss, self.learned.optimizer)
        with held(self._distance_parameters):
            descend(self._policy_loss(self, batch), self.optimizers["policy_optimizer"])
        self.learned.update_target()
        self._slow.follow()
        return metrics

    def rescale(self, scaling: Scaling) -> None:
        """Read inputs under another scaling, with the same actions; the distance has its own."""
        for network in (self.policy, self.target_policy):
            rescale(network, scaling)

    def networks(self) -> dict[str, torch.nn.Module]:
        """Networks by name, those of the distance apart."""
        return {"policy": self.policy, "target_policy": self.target_policy}

    def tensors(self) -> dict[str, Tensor]:
        """Nothing beside the networks."""
        return {}


def distance_loss(agent: Descent, batch: DescentBatch) -> tuple[Tensor, Metrics]:
    """Every d_k against the least of what is known, see :func:`napsp.distance.labels.one_step_label`."""
    length = agent.distance.episode_length
    with torch.no_grad():
        actions = agent.target_policy.outputs(batch.next_observations, batch.goals).tanh()
        following = torch.cat([batch.next_observations, actions, batch.goals], dim=-1)
        next_steps = agent.bootstrap.reduce(agent.target_distance.members(following) * length)
        known = batch.arrived, next_steps, batch.observed, batch.known
        labels = one_step_label(*known, length, agent.bootstrap.stay, batch.ended)
    rows = torch.cat([batch.observations, batch.actions, batch.goals], dim=-1)
    loss, metrics = agent._fit(agent.distance, Labelled(rows, labels, len(rows)))
    means = {"mean_distance": metrics["predictions"].mean(), "mean_label": labels.mean()}
    return loss, means | {"distance_loss": loss.detach()}


def policy_loss(agent: Descent, batch: DescentBatch) -> Tensor:
    """Mean of d_1(s, a, g) + penalty * a^2 in steps, a = pi(s, g)."""
    actions = agent.policy.outputs(batch.observations, batch.goals).tanh()
    rows = torch.cat([batch.observations, actions, batch.goals], dim=-1)
    steps = agent.distance.first(rows) * agent.distance.episode_length
    return steps.mean() + agent.config.action_penalty * actions.square().mean()
