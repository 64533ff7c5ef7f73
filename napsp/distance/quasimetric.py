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
        self.mixture = nn.Parameter(
            torch.zeros((), dtype=torch.float32)
        )  # logit of the mean's weight against the maximum's
        self.log_scale = nn.Parameter(torch.zeros((), dtype=torch.float32))

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


LATENT = 128  # numbers of a latent


class LatentHead(nn.Module):
    """d(s, a, g) = 1 + IQE(P(z + F(z, a)), P(h(g))), z = f(s), in steps: latent dynamics, and the way on from there.

    Wang et al. 2023, section 3.4; the IQE weighs mean and maximum of its components.

    Args:
        sizes: of observation, action and goal.
        hidden: widths of the hidden layers of f, F and h; P has the first alone.
        layer_norm: normalise each hidden layer.
    """

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], layer_norm: bool = False) -> None:
        super().__init__()
        self._n_observation, self._n_action, self._n_goal = sizes
        self.observation = mlp(self._n_observation, hidden, LATENT, layer_norm)
        self.goal = mlp(self._n_goal, hidden, LATENT, layer_norm)
        self.dynamics = mlp(LATENT + self._n_action, hidden, LATENT, layer_norm)
        with torch.no_grad():
            for parameter in self.dynamics[-1].parameters():
                parameter.zero_()  # to begin with, nothing moves
        self.projector = mlp(LATENT, hidden[:1], N_COMPONENTS * COMPONENT_SIZE, layer_norm)
        self.mixture = nn.Parameter(
            torch.zeros((), dtype=torch.float32)
        )  # logit of the mean's weight against the maximum's

    def after(self, latents: Tensor, actions: Tensor) -> Tensor:
        """Latents a step later ``(B, LATENT)``."""
        return latents + self.dynamics(torch.cat([latents, actions], dim=-1))

    def distance(self, start: Tensor, end: Tensor) -> Tensor:
        """Steps ``(B,)`` between latents ``(B, LATENT)``."""
        ends = (self.projector(x).unflatten(-1, (N_COMPONENTS, COMPONENT_SIZE)) for x in (start, end))
        components, share = interval_lengths(*ends), self.mixture.sigmoid()
        return share * components.mean(-1) + (1.0 - share) * components.amax(-1)

    def forward(self, inputs: Tensor) -> Tensor:
        """Steps ``(B,)`` of scaled and joined rows ``(B, O + A + G)``."""
        observations, actions, goals = inputs.split((self._n_observation, self._n_action, self._n_goal), dim=-1)
        return 1.0 + self.distance(self.after(self.observation(observations), actions), self.goal(goals))

    def readers(self) -> Iterator[tuple[nn.Linear, dict[str, slice]]]:
        """See :class:`napsp.networks.Scaled`."""
        yield first_linear(self.observation), {"observation": slice(None)}
        yield first_linear(self.goal), {"goal": slice(None)}


def interval_lengths(x: Tensor, y: Tensor) -> Tensor:
    """Length of the union of the intervals from x_i to max(x_i, y_i), ``(..., k)`` -> ``(...)``: a quasimetric."""
    starts, order = x.sort(-1)
    ends = torch.maximum(x, y).gather(-1, order)
    covered = torch.cat([starts[..., :1], ends.cummax(-1).values[..., :-1]], dim=-1)
    return (ends - torch.maximum(starts, covered)).clamp(min=0.0).sum(-1)
