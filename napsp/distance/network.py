"""The distance network d_theta(s, a, g)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from napsp.distance.quasimetric import LatentHead, QuasimetricHead
from napsp.errors import UserError
from napsp.networks import InputScaling, first_linear, joined_columns, mlp
from napsp.settings import TINY, check_choice, check_ranges


@dataclass(frozen=True)
class DistanceConfig:
    """The network and how it follows its labels."""

    learning_rate: float = 1e-3
    """Adam's step size."""
    head: str = "mlp"
    """mlp; beyond the paper: quasimetric, whose distances keep the triangle inequality by construction, or latent, the
    one of quasimetric RL, which predicts where an action leads."""
    output: Literal["linear", "softplus"] = "linear"
    """Output layer of d / T of the mlp."""
    unit: Literal["episode", "step"] = "episode"
    """What an output of 1 means. Adam's steps are of one size whatever the outputs mean: in steps they are T times
    finer, which a policy that descends d needs, for an action changes it by a step or two."""
    layer_norm: bool = False
    """Normalise each hidden layer."""
    n_members: int = 1
    """Networks whose mean is d; each is fitted on its own."""
    loss: str = "squared"
    """How d is fitted to its labels, see napsp/distance/losses.py; the paper squares the error."""
    target_polyak: float = 1.0
    """Weight of the new parameters in the target update, per iteration (line 9; 1 copies), or per update for plus."""
    slow: bool = False
    """Reward the policy with the target network, and save that one. With a small target_polyak it averages out what
    the last iteration's few episodes did to d."""

    def __post_init__(self) -> None:
        check_ranges(self, learning_rate=(TINY, 1), n_members=(1, 100), target_polyak=(TINY, 1))
        check_choice(self, head=tuple(HEADS), output=("linear", "softplus"), unit=("episode", "step"))
        if self.head == "latent" and self.unit != "step":
            raise UserError("--distance.head latent speaks in steps; add --distance.unit step")


class MLPHead(nn.Module):
    """One network; a linear output may be slightly negative."""

    def __init__(
        self, sizes: tuple[int, int, int], hidden: tuple[int, ...], layer_norm: bool = False, output: str = "linear"
    ) -> None:
        super().__init__()
        self._sizes = sizes
        self.net = mlp(sum(sizes), hidden, 1, layer_norm)
        self.output = output

    def forward(self, inputs: Tensor) -> Tensor:
        """Outputs ``(B,)``, d in ``unit``, of scaled and joined rows ``(B, O + A + G)``."""
        outputs = self.net(inputs).squeeze(-1)
        return functional.softplus(outputs) if self.output == "softplus" else outputs

    def readers(self) -> Iterator[tuple[nn.Linear, dict[str, slice]]]:
        """See :class:`napsp.networks.Scaled`."""
        yield first_linear(self.net), joined_columns(self._sizes[0], self._sizes[2])


HEADS: dict[str, Callable[[tuple[int, int, int], tuple[int, ...], DistanceConfig], Any]] = {
    "mlp": lambda sizes, hidden, config: MLPHead(sizes, hidden, config.layer_norm, config.output),
    "quasimetric": lambda sizes, hidden, config: QuasimetricHead(sizes, hidden, config.layer_norm),
    "latent": lambda sizes, hidden, config: LatentHead(sizes, hidden, config.layer_norm),
}
"""Modules that map scaled and joined rows ``(B, O + A + G)`` to d in ``unit`` ``(B,)``."""


class DistanceNetwork(nn.Module):
    """d_theta(s, a, g) in steps: how long from s to g when a is the first action.

    The network predicts d / T. ``forward`` returns the raw prediction that the losses fit; :meth:`steps` is the
    distance to use, clipped to [0, T].

    Args:
        sizes: of observation, action and goal.
        hidden: widths of the hidden layers.
        episode_length: T, in steps.
        config: head, members and so on.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        hidden: tuple[int, ...],
        episode_length: int,
        config: DistanceConfig | None = None,
    ) -> None:
        super().__init__()
        config = config or DistanceConfig()
        self.scaling = InputScaling(sizes[0], sizes[2])
        self.heads = nn.ModuleList([HEADS[config.head](sizes, hidden, config) for _ in range(config.n_members)])
        self.episode_length = episode_length
        self._per_output = 1.0 / episode_length if config.unit == "step" else 1.0

    def inputs(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """What the heads read: scaled and joined rows ``(B, O + A + G)``."""
        observation, goal = self.scaling(observation, goal)
        return torch.cat([observation, action, goal], dim=-1)

    def members(self, inputs: Tensor) -> Tensor:
        """D / T of every member ``(K, B)`` for rows of :meth:`inputs`: what is fitted."""
        return torch.stack([head(inputs) for head in self.heads]) * self._per_output

    def first(self, inputs: Tensor) -> Tensor:
        """D / T of the first member ``(B,)``: what a policy descends."""
        return self.heads[0](inputs) * self._per_output

    def fractions(self, inputs: Tensor) -> Tensor:
        """D / T ``(B,)`` for rows of :meth:`inputs`."""
        return self.first(inputs) if len(self.heads) == 1 else self.members(inputs).mean(0)

    def forward(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Raw prediction in steps ``(B,)`` for rows ``(B, O)``, ``(B, A)``, ``(B, G)``."""
        return self.fractions(self.inputs(observation, action, goal)) * self.episode_length

    def steps(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Distance in steps ``(B,)``, within [0, T]."""
        return self(observation, action, goal).clamp(0.0, self.episode_length)

    def readers(self) -> Iterator[tuple[nn.Linear, dict[str, slice]]]:
        """See :class:`napsp.networks.Scaled`."""
        for head in self.heads:
            yield from head.readers()

    def plain(self) -> list[MLPHead]:
        """The plain mlps whose mean d is, for those who write it out; none if it is more than that."""
        heads = [head for head in self.heads if isinstance(head, MLPHead)]
        normed = any(isinstance(layer, nn.LayerNorm) for head in heads for layer in head.net)
        return [] if normed or len(heads) < len(self.heads) else heads

    @property
    def steps_per_output(self) -> float:
        """Steps that an output of 1 of a head means."""
        return self.episode_length * self._per_output
