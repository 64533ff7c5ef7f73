"""How the same updates are run: device, ``torch.compile``, CUDA graphs. Never another implementation of them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import torch
from torch import Tensor

from napsp.command_line import Flat
from napsp.compiled import compiled
from napsp.errors import UserError

N = TypeVar("N", bound=torch.nn.Module)


@dataclass(frozen=True)
class Execution:
    """Where and how updates run; results differ in rounding alone, so this is no part of what a result is."""

    device: Flat[Literal["auto", "cpu", "cuda"]] = "cpu"
    """Where the networks are trained; auto takes CUDA where there is one. With CUDA a phase's samples are moved once
    and every update is replayed as a CUDA graph: on an H100 14 times a core's updates at 2 x 256, batch 256."""
    compiled: Flat[bool] = False
    """Compile the losses and their gradients (torch.compile; needs a C++ compiler, the first time takes a minute)."""
    threads: Flat[int] = 1
    """CPU threads; two single-threaded runs finish sooner than one with two threads."""

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise UserError(f"threads is {self.threads}; it must be at least 1")
        if self.device == "cuda" and not torch.cuda.is_available():
            raise UserError("--device cuda needs a CUDA device and a torch built for it; use --device cpu")

    @property
    def torch_device(self) -> torch.device:
        """The device itself."""
        wanted = self.device
        if wanted == "auto":
            wanted = "cuda" if torch.cuda.is_available() else "cpu"
        return torch.device(wanted)

    def loss(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A loss function, compiled if wanted; for arguments of one shape."""
        return compiled(function, self.compiled)

    def update(self, function: Callable[..., dict[str, Tensor]]) -> Callable[..., dict[str, Tensor]]:
        """An update - losses, gradients, optimiser steps - as a CUDA graph on CUDA; takes and returns tensors."""
        return GraphedUpdate(function) if self.torch_device.type == "cuda" else function

    def adam(self, parameters: Iterable[Tensor], learning_rate: float) -> torch.optim.Adam:
        """Adam in one kernel, with its step count on the device where a graph has to advance it."""
        on_cuda = self.torch_device.type == "cuda"
        return torch.optim.Adam(list(parameters), lr=learning_rate, fused=True, capturable=on_cuda)


class GraphedUpdate:
    """Replays an update that was captured as one CUDA graph, so that the GPU never waits for Python.

    The first calls run as they are, on a stream of their own, which lets libraries set themselves up; they are real
    updates, so nothing has to be undone. Arguments of another shape than the captured ones run as they are.
    """

    N_EAGER = 3

    def __init__(self, update: Callable[..., dict[str, Tensor]]) -> None:
        self._update = update
        self._n_calls = 0
        self._graph: torch.cuda.CUDAGraph | None = None
        self._inputs: tuple[Tensor, ...] = ()
        self._outputs: dict[str, Tensor] = {}

    def __call__(self, *arguments: Tensor) -> dict[str, Tensor]:
        """Run or replay the update; returns its figures."""
        shapes = [argument.shape for argument in arguments]
        if self._graph is not None and shapes == [held.shape for held in self._inputs]:
            for held, argument in zip(self._inputs, arguments, strict=True):
                held.copy_(argument)
            self._graph.replay()
            return {name: value.clone() for name, value in self._outputs.items()}
        self._n_calls += 1
        if self._graph is not None or self._n_calls <= self.N_EAGER:
            return self._on_own_stream(arguments)
        self._capture(arguments)
        return self(*arguments)

    def _on_own_stream(self, arguments: tuple[Tensor, ...]) -> dict[str, Tensor]:
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            outputs = self._update(*arguments)
        torch.cuda.current_stream().wait_stream(stream)
        return outputs

    def _capture(self, arguments: tuple[Tensor, ...]) -> None:
        self._inputs = tuple(argument.clone() for argument in arguments)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):  # records, and does not run
            self._outputs = self._update(*self._inputs)
        self._graph = graph


def descend(loss: Tensor, optimizer: torch.optim.Optimizer) -> None:
    """One step of an optimiser down a loss; other networks that the loss runs through get no gradients."""
    parameters = optimizer.param_groups[0]["params"]
    for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
        parameter.grad = gradient
    optimizer.step()


class Slow(Generic[N]):
    """A network's slow copy, frozen; :meth:`follow` moves it.

    The list of parameters is made once: walking through modules takes longer than moving them.
    """

    def __init__(self, network: N, polyak: float) -> None:
        self.network: N = copy.deepcopy(network).requires_grad_(False)
        self._polyak = polyak
        self._pairs = list(zip(self.network.parameters(), network.parameters(), strict=True))

    @torch.no_grad()
    def follow(self) -> None:
        """theta_old <- theta_old + polyak (theta - theta_old)."""
        for own, followed in self._pairs:
            own.lerp_(followed, self._polyak)


@contextmanager
def held(parameters: Sequence[Tensor]) -> Iterator[None]:
    """Let losses run through parameters without gradients for them."""
    for parameter in parameters:
        parameter.requires_grad = False
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad = True


def mean(values: list[Tensor]) -> float:
    """Mean of scalars, read off the device once."""
    return float(torch.stack(values).mean())
