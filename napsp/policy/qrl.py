"""Quasimetric RL, an external yardstick: d is pushed apart everywhere but along observed steps.

Wang, Torralba, Isola and Zhang 2023, "Optimal Goal-Reaching Reinforcement Learning via Quasimetric Learning". Here
goals are achieved goals and not states, so a goal has an encoder of its own, and arriving at it is a step of no length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import softplus

from napsp.distance.learned import LearnedDistance
from napsp.distance.quasimetric import LatentHead
from napsp.execution import Execution, descend, held, mean
from napsp.networks import rescale
from napsp.policy.actors import DeterministicPolicy
from napsp.policy.agent import PolicyConfig
from napsp.policy.descent import DescentBatch, Metrics
from napsp.scaling import Scaling
from napsp.settings import MANY, TINY, check_ranges


@dataclass(frozen=True)
class QRLConfig:
    """Quasimetric RL; the defaults are its published ones for online goal reaching."""

    push_until: float = 15.0
    """Steps up to which states and goals are pushed apart."""
    push_softness: float = 0.1
    """Sharpness of that limit, the beta of a softplus."""
    tolerance: float = 0.25
    """Root mean square by which observed steps may be longer than one step."""
    multiplier: float = 0.01
    """Lagrange multiplier of that constraint at the start."""
    multiplier_learning_rate: float = 0.01
    """Adam's step size for the multiplier."""
    dynamics_weight: float = 0.1
    """Weight of the squared distance between predicted and observed next latents."""

    def __post_init__(self) -> None:
        positive = ("push_until", "push_softness", "tolerance", "multiplier", "multiplier_learning_rate")
        check_ranges(self, dynamics_weight=(0, MANY), **dict.fromkeys(positive, (TINY, MANY)))


class QRL:
    """A deterministic policy that descends the larger of K quasimetric distances.

    Args:
        sizes: of observation, action and goal.
        hidden: widths of the policy's hidden layers.
        config: settings of the policy.
        qrl: settings of the distances.
        distance: its networks are trained here.
        execution: device and so on.

    Raises:
        TypeError: the distances have another head than :class:`napsp.distance.quasimetric.LatentHead`.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        hidden: tuple[int, ...],
        config: PolicyConfig,
        qrl: QRLConfig,
        distance: LearnedDistance,
        execution: Execution | None = None,
    ) -> None:
        execution, self.config, self.qrl, self.learned = execution or Execution(), config, qrl, distance
        self.heads: list[LatentHead] = []
        for head in distance.distance.heads:
            if not isinstance(head, LatentHead):
                raise TypeError("QRL trains distances with --distance.head latent")
            self.heads.append(head)
        self.policy = DeterministicPolicy(sizes, hidden, config.action_noise).to(execution.torch_device)
        start = torch.full((len(self.heads),), math.log(math.expm1(qrl.multiplier)), dtype=torch.float32)
        self.multipliers = start.to(execution.torch_device).requires_grad_()  # before their softplus
        self._distance_parameters = list(distance.distance.parameters())
        self.optimizers = {
            "policy_optimizer": execution.adam(self.policy.parameters(), config.learning_rate),
            "multiplier_optimizer": execution.adam([self.multipliers], qrl.multiplier_learning_rate),
        }
        self._distance_loss, self._policy_loss = execution.loss(distance_loss), execution.loss(policy_loss)
        self._update = execution.update(self._update_once)

    @property
    def trusted(self) -> DeterministicPolicy:
        """The policy: it has no slow copy."""
        return self.policy

    def train(self, transitions: DescentBatch, batch_size: int, generator: torch.Generator) -> dict[str, float]:
        """Update everything once per batch of raw transitions ``(n * batch_size, .)``; figures to log."""
        del generator  # deterministic
        batches = transitions.scaled(self.policy.scaling).split(batch_size)
        figures = [self._update(*batch) for batch in batches]
        return {name: mean([row[name] for row in figures]) for name in figures[0]}

    def _update_once(self, *tensors: Tensor) -> Metrics:
        """Distances, their multipliers, policy, from a scaled batch."""
        batch = DescentBatch(*tensors)
        loss, violations, metrics = self._distance_loss(self, batch)
        descend(loss, self.learned.optimizer)
        descend(-(softplus(self.multipliers) * violations).sum(), self.optimizers["multiplier_optimizer"])
        with held(self._distance_parameters):
            descend(self._policy_loss(self, batch), self.optimizers["policy_optimizer"])
        self.learned.update_target()
        return metrics

    def rescale(self, scaling: Scaling) -> None:
        """Read inputs under another scaling, with the same actions; the distance has its own."""
        rescale(self.policy, scaling)

    def networks(self) -> dict[str, torch.nn.Module]:
        """Networks by name, those of the distance apart."""
        return {"policy": self.policy}

    def tensors(self) -> dict[str, Tensor]:
        """What else belongs to the agent's state."""
        return {"multipliers": self.multipliers}


def distance_loss(agent: QRL, batch: DescentBatch) -> tuple[Tensor, Tensor, Metrics]:
    """Loss of the distances, by how much each violates its constraint ``(K,)``, and figures to log.

    Constraints: one observed step is at most 1 long; where an episode arrived, nothing is left. The push runs over
    states and the goals of other transitions of the batch.
    """
    config, losses, violations = agent.qrl, [], []
    with torch.no_grad():
        multipliers = softplus(agent.multipliers)
    for head, multiplier in zip(agent.heads, multipliers, strict=True):
        here, there = head.observation(batch.observations), head.observation(batch.next_observations)
        achieved, goals = head.goal(batch.next_achieved), head.goal(batch.goals)
        apart = head.distance(here, achieved.roll(1, 0))
        push = softplus(config.push_until - apart, beta=config.push_softness).mean()
        longer = (head.distance(here, there) - 1.0).relu().square().mean()
        arrived = batch.arrived.to(here.dtype)
        left = head.distance(there, achieved).square().mean()
        left = left + (arrived * head.distance(there, goals).square()).sum() / arrived.sum().clamp(min=1.0)
        violation = longer + left - config.tolerance**2
        predicted = head.after(here, batch.actions)
        both = head.distance(predicted, there).square() + head.distance(there, predicted).square()
        losses.append(push + multiplier * violation + config.dynamics_weight * 0.5 * both.mean())
        violations.append(violation.detach())
    loss = torch.stack(losses).sum()
    figures = {"mean_distance": 1.0 + apart.detach().mean(), "distance_loss": loss.detach(),
               "multiplier": multipliers.mean()}  # fmt: skip
    return loss, torch.stack(violations), figures


def policy_loss(agent: QRL, batch: DescentBatch) -> Tensor:
    """Mean of max_k d_k(s, a, g) + penalty * a^2 in steps, a = pi(s, g)."""
    actions = agent.policy.outputs(batch.observations, batch.goals).tanh()
    rows = torch.cat([batch.observations, actions, batch.goals], dim=-1)
    steps = torch.stack([head(rows) for head in agent.heads]).amax(0)
    return steps.mean() + agent.config.action_penalty * actions.square().mean()
