"""A head whose distances keep the triangle inequality by construction: interval quasimetric embeddings.

Wang and Isola 2022, "Improved representation of asymmetrical distances with interval quasimetric embeddings".
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn

from napsp.networks import first_linear, mlp

N_COMPONENTS, COMPONENT_SIZE = 16, 8


class QuasimetricHead(nn.Module):
    """d((s, a), g) / T = scale * IQE(f(s, a), h(g)): never negative, asymmetric, triangle inequality in f, h.

    Args:
        sizes: of observation, action and goal.
        hidden: widths of f's and h's hidden layers.
        layer_norm: normalise each hidden layer.
    """

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], layer_norm: bool = False) -> None:
        super().__init__()
        self._n_observation, _, self._n_goal = sizes
        size = N_COMPONENTS * COMPONENT_SIZE
        self.pair = mlp(sizes[0] + sizes[1], hidden, size, layer_norm)
        self.goal = mlp(self._n_goal, hidden, size, layer_norm)
        self.mixture = nn.Parameter(torch.zeros(()))  # logit of the mean's weight against the maximum's
        self.log_scale = nn.Parameter(torch.zeros(()))

    def forward(self, inputs: Tensor) -> Tensor:
        """D / T ``(B,)`` of scaled and joined rows ``(B, O + A + G)``."""
        pair, goal = self.pair(inputs[:, : -self._n_goal]), self.goal(inputs[:, -self._n_goal :])
        components = interval_lengths(*(x.unflatten(-1, (N_COMPONENTS, COMPONENT_SIZE)) for x in (pair, goal)))
        share = self.mixture.sigmoid()
        return self.log_scale.exp() * (share * components.mean(-1) + (1.0 - share) * components.amax(-1))

    def readers(self) -> Iterator[tuple[nn.Linear, dict[str, slice]]]:
        """See :class:`napsp.networks.Scaled`."""
        yield first_linear(self.pair), {"observation": slice(0, self._n_observation)}
        yield first_linear(self.goal), {"goal": slice(None)}


def interval_lengths(x: Tensor, y: Tensor) -> Tensor:
    """Length of the union of the intervals from x_i to max(x_i, y_i), ``(..., k)`` -> ``(...)``: a quasimetric."""
    starts, order = x.sort(-1)
    ends = torch.maximum(x, y).gather(-1, order)
    covered = torch.cat([starts[..., :1], ends.cummax(-1).values[..., :-1]], dim=-1)
    return (ends - torch.maximum(starts, covered)).clamp(min=0.0).sum(-1)
