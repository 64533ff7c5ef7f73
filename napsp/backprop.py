"""Gradients of an :func:`~napsp.networks.mlp` written out, and Adam on one flat vector.

At the widths and batches used here autograd and per-tensor optimisers take as long as the
arithmetic. Written out, a gradient step is little more than its matrix products, and plain
enough for ``torch.compile`` to make one program of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.optim.adam import adam


class Tape(NamedTuple):
    """What a backward pass needs of its forward pass.

    Attributes:
        inputs: of the network, ``(B, n)``.
        before: outputs of each hidden layer before SiLU, ``(B, width)``.
        after: the same after SiLU.
    """

    inputs: Tensor
    before: list[Tensor]
    after: list[Tensor]

    def part(self, rows: slice) -> Tape:
        """The tape of some rows (views)."""
        return Tape(
            self.inputs[rows], [values[rows] for values in self.before], [values[rows] for values in self.after]
        )


class Backprop:
    """Forward and backward passes of one network; call under ``torch.no_grad()``.

    Args:
        net: linear layers with SiLU between them.
        vector: where :func:`flatten` put its parameters.
    """

    def __init__(self, net: nn.Module, vector: Tensor) -> None:
        layers = [layer for layer in net.modules() if isinstance(layer, nn.Linear)]
        parameters = [parameter for layer in layers for parameter in (layer.weight, layer.bias)]
        self._vector = vector
        self._start = parameters[0].storage_offset()
        self._sizes = [parameter.numel() for parameter in parameters]
        self._shapes = [parameter.shape for parameter in parameters]
        self._views = self._read()

    def _read(self) -> list[tuple[Tensor, Tensor]]:
        parts = self._vector[self._start : self._start + sum(self._sizes)].split(self._sizes)
        parameters = [part.view(shape) for part, shape in zip(parts, self._shapes, strict=True)]
        return list(zip(parameters[::2], parameters[1::2], strict=True))

    def _layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weight and bias of each layer; a compiled step reads them off the vector, to have it as its only input."""
        return self._read() if torch.compiler.is_compiling() else self._views

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tape]:
        """Outputs ``(B, n)``, and the tape for :meth:`slopes`."""
        layers, tape = self._layers(), Tape(inputs, [], [])
        for weight, bias in layers[:-1]:
            before = torch.addmm(bias, inputs, weight.t())
            inputs = nn.functional.silu(before)
            tape.before.append(before)
            tape.after.append(inputs)
        weight, bias = layers[-1]
        return torch.addmm(bias, inputs, weight.t()), tape

    def slopes(self, tape: Tape, gradient: Tensor) -> list[Tensor]:
        """Slopes of the loss by each layer's outputs before SiLU, first layer first, from the last one's ``(B, n)``."""
        layers, slopes = self._layers(), [gradient]
        for index in reversed(range(1, len(layers))):
            slope = slopes[0] @ layers[index][0]
            slopes.insert(0, torch.ops.aten.silu_backward(slope, tape.before[index - 1]))
        return slopes

    def gradients(self, tape: Tape, slopes: list[Tensor]) -> list[Tensor]:
        """Slopes of the loss by the parameters, in the vector's order."""
        gradients = []
        for inputs, slope in zip([tape.inputs, *tape.after], slopes, strict=True):
            gradients += [slope.t() @ inputs, slope.sum(0)]
        return gradients

    def input_slope(self, slopes: list[Tensor], columns: slice) -> Tensor:
        """Slopes of the loss by some columns of the inputs ``(B, n)``."""
        return slopes[0] @ self._layers()[0][0][:, columns]


def flatten(networks: Iterable[nn.Module]) -> Tensor:
    """Move all parameters into one vector ``(P,)`` that they become views of."""
    parameters = [parameter for network in networks for parameter in network.parameters()]
    vector = torch.cat([parameter.detach().reshape(-1) for parameter in parameters])
    start = 0
    for parameter in parameters:
        end = start + parameter.numel()
        parameter.data = vector[start:end].view_as(parameter)
        start = end
    return vector


class Adam:
    """Adam (Kingma and Ba 2015) over a vector of :func:`flatten`, with torch's formulas.

    Attributes:
        state: step, exp_avg and exp_avg_sq as in :class:`torch.optim.Adam`.
    """

    def __init__(self, vector: Tensor, learning_rate: float) -> None:
        self._vector, self._learning_rate = vector, learning_rate
        moments = {name: torch.zeros_like(vector) for name in ("exp_avg", "exp_avg_sq")}
        self.state: dict[str, Tensor] = {"step": torch.zeros(()), **moments}

    @torch.no_grad()
    def update(self, gradients: Sequence[Tensor]) -> None:
        """One step down the gradients, given in the vector's order."""
        gradient = torch.cat([gradient.reshape(-1) for gradient in gradients]).view_as(self._vector)
        state = self.state
        compiling = torch.compiler.is_compiling()  # which writes a fused loop of its own
        adam(
            [self._vector], [gradient], [state["exp_avg"]], [state["exp_avg_sq"]], [], [state["step"]],
            foreach=False, fused=not compiling, amsgrad=False, beta1=0.9, beta2=0.999, lr=self._learning_rate,
            weight_decay=0.0, eps=1e-8, maximize=False,
        )  # fmt: skip
