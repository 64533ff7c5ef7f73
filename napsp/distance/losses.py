"""Losses that fit d to labels. Errors are in units of T, so that learning rates do not depend on the episode length.

A loss maps the distance network and a batch of labels to ``(loss, metrics)``; a new one is a function of a file of its
own and a line in ``LOSSES``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from napsp.distance.network import DistanceNetwork


class Labelled(NamedTuple):
    """Rows and what d should be there.

    Attributes:
        rows: scaled and joined inputs, ``(B, O + A + G)``.
        labels: in steps, ``(B,)``.
        n_sampled: what the sum of errors is divided by. Eq. 4a averages over the batch. Eq. 4b has only the tuples that
            passed the test as rows: divided by all tuples drawn, the others count as "do nothing" (Algorithm 1, line
            16); divided by their own number it is the conditional expectation of eq. 4b.
    """

    rows: Tensor
    labels: Tensor
    n_sampled: int


Metrics = dict[str, Tensor]
Loss = Callable[[DistanceNetwork, Labelled], tuple[Tensor, Metrics]]


def squared(distance: DistanceNetwork, batch: Labelled) -> tuple[Tensor, Metrics]:
    """The paper's: squared errors of every member's d / T against labels / T.

    Metrics: ``predictions``, d in steps before the update ``(B,)``.
    """
    members = distance.members(batch.rows)
    errors = members - batch.labels / distance.episode_length
    predictions = members.mean(0) * distance.episode_length
    return errors.square().sum() / batch.n_sampled, {"predictions": predictions.detach()}


RELATIVE_FLOOR = 5.0  # steps


def relative(distance: DistanceNetwork, batch: Labelled) -> tuple[Tensor, Metrics]:
    """Squared errors weighed by 2 c / (label + c), c = 5 steps: near and far goals err by alike shares.

    Metrics: ``predictions``, d in steps before the update ``(B,)``.
    """
    members = distance.members(batch.rows)
    errors = members - batch.labels / distance.episode_length
    weights = 2.0 * RELATIVE_FLOOR / (batch.labels + RELATIVE_FLOOR)
    predictions = members.mean(0) * distance.episode_length
    return (weights * errors.square()).sum() / batch.n_sampled, {"predictions": predictions.detach()}


LOSSES: dict[str, Loss] = {"squared": squared, "relative": relative}
