"""The two losses of the distance (eq. 4a, 4b), as pure functions.

Both are in units of T: a squared error of steps / T, so that learning rates do not depend
on the episode length. Each returns ``(loss, metrics)``.
"""

from __future__ import annotations

import torch
from torch import Tensor

from napsp.networks import DistanceNetwork

Metrics = dict[str, float]


def temporal_label(steps_between: Tensor, target_steps: Tensor, uncertainty: Tensor) -> Tensor:
    """min[j - i, d_old + U] in steps (eq. 4a); all ``(B,)``."""
    return torch.minimum(steps_between, target_steps + uncertainty)


def temporal_loss(
    distance: DistanceNetwork,
    observations: Tensor,
    actions: Tensor,
    goals: Tensor,
    labels: Tensor,
) -> Tensor:
    """Mean squared error of d(s_i, a_i, phi(s_j)) against labels in steps (eq. 4a)."""
    predictions = distance(observations, actions, goals)
    return ((predictions - labels) / distance.horizon).square().mean()


def hypotenuse(first_leg: Tensor, second_leg: Tensor, cap: float | None) -> Tensor:
    """d*(s_i, a_i, s_g) = d(s_i, a_i, s_j) + d(s_j, a_j, s_g), capped (eq. 3); ``(B,)``."""
    total = first_leg + second_leg
    return total if cap is None else total.clamp(max=cap)


def triangular_loss(
    distance: DistanceNetwork,
    observations: Tensor,
    actions: Tensor,
    goals: Tensor,
    labels: Tensor,
    n_sampled: int | None = None,
) -> tuple[Tensor, Metrics]:
    """Squared error of d(s_i, a_i, s_g) against hypotenuses of the tuples that passed (eq. 4b).

    Averaged over the ``n_sampled`` tuples drawn, so that those that failed the test count as
    "do nothing" (Algorithm 1, line 16); None averages over the passed ones (the conditional
    expectation of eq. 4b). Metrics are counts: how many labels raise the distance (``merged``) or lower it
    (``relaxed``); divided by all sampled tuples they are the rates of figure 5.
    """
    predictions = distance(observations, actions, goals)
    loss = ((predictions - labels) / distance.horizon).square().sum() / (n_sampled or len(labels))
    raised = float((labels > predictions.detach()).sum())
    return loss, {"merged": raised, "relaxed": float(len(labels)) - raised}
