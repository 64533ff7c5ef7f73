"""Gradients of an :func:`~napsp.networks.mlp` written out, and Adam on one flat vector.

At the widths and batches used here autograd and per-tensor optimisers take as long as the
arithmetic. Written out, a gradient step is little more than its matrix products, and the
same code runs on any device.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

Tape = list[tuple[Tensor, Tensor]]
"""Per layer, what the backward pass needs: its inputs, and its outputs before SiLU."""


class Backprop:
    """Forward and backward passes of one network; call under ``torch.no_grad()``.

    Args:
        net: linear layers with SiLU between them.
    """

    def __init__(self, net: nn.Module) -> None:
        self._layers = [(layer.weight, layer.bias) for layer in net.modules() if isinstance(layer, nn.Linear)]

    def outputs(self, inputs: Tensor) -> Tensor:
        """Outputs ``(B, n)`` alone, in as little memory as possible."""
        for index, (weight, bias) in enumerate(self._layers):
            inputs = torch.addmm(bias, nn.functional.silu(inputs, inplace=True) if index else inputs, weight.t())
        return inputs

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tape]:
        """Outputs ``(B, n)`` and the tape for :meth:`backward`."""
        tape: Tape = []
        values = outputs = inputs
        for weight, bias in self._layers:
            if tape:
                values = nn.functional.silu(outputs)
            outputs = torch.addmm(bias, values, weight.t())
            tape.append((values, outputs))
        return outputs, tape

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
        for index in reversed(range(len(self._layers))):
            weight, bias = self._layers[index]
            if parameters:
                torch.mm(gradient.t(), tape[index][0], out=weight.grad)
                torch.sum(gradient, 0, out=bias.grad)
            if index:
                gradient = gradient @ weight
                torch.ops.aten.silu_backward.grad_input(gradient, tape[index - 1][1], grad_input=gradient)
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
