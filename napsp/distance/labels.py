"""The labels of eq. 4a and 4b, as pure functions, and the loss that fits d to them.

Both equations are squared errors of d against a label. Errors are in units of T, so that
learning rates do not depend on the episode length.
"""

from __future__ import annotations

import torch
from torch import Tensor


def temporal_label(steps_between: Tensor, target_steps: Tensor, uncertainty: Tensor) -> Tensor:
    """min[j - i, d_old + U] in steps (eq. 4a); all ``(B,)``."""
    return torch.minimum(steps_between, target_steps + uncertainty)


def hypotenuse(first_leg: Tensor, second_leg: Tensor, cap: float | None) -> Tensor:
    """d*(s_i, a_i, s_g) = d(s_i, a_i, s_j) + d(s_j, a_j, s_g), capped (eq. 3); ``(B,)``."""
    total = first_leg + second_leg
    return total if cap is None else total.clamp(max=cap)


def squared_error(fractions: Tensor, labels: Tensor, n_sampled: int) -> tuple[Tensor, Tensor]:
    """Sum of squared errors of d / T ``(B,)`` against labels / T, over ``n_sampled``.

    Eq. 4a averages over the batch. Eq. 4b has only the tuples that passed the test as rows:
    divided by all tuples drawn, the others count as "do nothing" (Algorithm 1, line 16);
    divided by their own number it is the conditional expectation of eq. 4b.

    Returns:
        The loss and its gradient with respect to ``fractions`` ``(B,)``.
    """
    errors = fractions - labels
    return errors.square().sum() / n_sampled, errors * (2.0 / n_sampled)
