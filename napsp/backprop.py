"""Gradients of an :func:`~napsp.networks.mlp` written out, and Adam on one flat vector.

At the widths and batches used here autograd and per-tensor optimisers take as long as the
arithmetic. Written out, a gradient step is little more than its matrix products, and the
same code runs on any device.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable

import torch
from torch import Tensor, nn


class Tape:
    """What a backward pass needs of its forward pass, in memory that is used again and again.

    Fresh memory would fall out of the cache between the passes of several networks.

    Attributes:
        inputs: of the network, ``(B, n)``.
        before: outputs of each hidden layer before SiLU, ``(B, width)``.
        after: the same after SiLU.
        slopes: d loss / d before.
    """

    def __init__(self, n_rows: int, widths: list[int], like: Tensor) -> None:
        self.inputs = like
        self.before, self.after, self.slopes = ([like.new_empty(n_rows, width) for width in widths] for _ in range(3))

    def part(self, rows: slice) -> Tape:
        """The tape of some rows (views)."""
        tape = copy.copy(self)
        tape.inputs = self.inputs[rows]
        tape.before, tape.after, tape.slopes = (
            [values[rows] for values in kind] for kind in (self.before, self.after, self.slopes)
        )
        return tape


class Backprop:
    """Forward and backward passes of one network; call under ``torch.no_grad()``.

    Args:
        net: linear layers with SiLU between them.
    """

    def __init__(self, net: nn.Module) -> None:
        layers = [layer for layer in net.modules() if isinstance(layer, nn.Linear)]
        self._parameters = [(layer.weight, layer.bias) for layer in layers]
        self._widths = [layer.out_features for layer in layers[:-1]]
        self._tapes: dict[int, Tape] = {}

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tape]:
        """Outputs ``(B, n)``, and the tape for :meth:`backward`; the next forward pass overwrites it."""
        tape = self._tapes.get(len(inputs))
        if tape is None:
            tape = self._tapes[len(inputs)] = Tape(len(inputs), self._widths, inputs)
        tape.inputs = inputs
        for (weight, bias), before, after in zip(self._parameters, tape.before, tape.after, strict=False):
            torch.addmm(bias, inputs, weight.t(), out=before)
            torch.ops.aten.silu.out(before, out=after)
            inputs = after
        weight, bias = self._parameters[-1]
        return torch.addmm(bias, inputs, weight.t()), tape

    def backward(self, tape: Tape, gradient: Tensor, parameters: bool = True, inputs: slice | None = None) -> Tensor:
        """Push d loss / d outputs ``(B, n)`` back.

        Args:
            tape: of the forward pass.
            gradient: d loss / d outputs.
            parameters: write d loss / d parameters into their ``grad``.
            inputs: the columns of the inputs to differentiate.

        Returns:
            d loss / d inputs ``(B, len(inputs))``; empty columns if None.
        """
        for index in reversed(range(len(self._parameters))):
            weight, bias = self._parameters[index]
            if parameters:
                torch.mm(gradient.t(), tape.after[index - 1] if index else tape.inputs, out=weight.grad)
                torch.sum(gradient, 0, out=bias.grad)
            if index:
                slope = tape.slopes[index - 1]
                torch.mm(gradient, weight, out=slope)
                torch.ops.aten.silu_backward.grad_input(slope, tape.before[index - 1], grad_input=slope)
                gradient = slope
        return gradient @ weight[:, inputs or slice(0)]


def flatten(networks: Iterable[nn.Module]) -> Tensor:
    """Move all parameters into one vector that they become views of; so do their gradients.

    Returns:
        The vector ``(P,)``; its ``grad`` is the vector of gradients.
    """
    parameters = [parameter for network in networks for parameter in network.parameters()]
    vector = torch.cat([parameter.detach().reshape(-1) for parameter in parameters])
    vector.grad = torch.zeros_like(vector)
    start = 0
    for parameter in parameters:
        end = start + parameter.numel()
        parameter.data = vector[start:end].view_as(parameter)
        parameter.grad = vector.grad[start:end].view_as(parameter)
        start = end
    return vector


def adam(vector: Tensor, learning_rate: float) -> torch.optim.Adam:
    """Adam over a vector of :func:`flatten`."""
    return torch.optim.Adam([vector], lr=learning_rate, fused=True)
