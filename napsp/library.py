"""The package as a library: a trained distance to call, its task, its policy's success.

``import napsp`` hands these out by name, and imports torch and MuJoCo when the first of them is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
import torch
from torch import Tensor

from napsp import envs as tasks
from napsp.config import PAPER, preset
from napsp.data.outcomes import Outcomes
from napsp.data.outcomes import evaluate as run_episodes
from napsp.distance.network import DistanceNetwork
from napsp.envs.goal_task import make_goal_task, saves_its_state
from napsp.execution import Execution
from napsp.interruption import says_no
from napsp.policy.greedy import GreedyPolicy
from napsp.settings import FIRST_SEED
from napsp.storage.checkpoint import Model, load_model
from napsp.storage.record import RECORD_FILE, command_line
from napsp.train import train as run_training
from napsp.train import usual_folder
from napsp.unread import tell_of_unread

Array = np.ndarray | Tensor
"""What distances take and give: numpy in, numpy out; torch in, torch out, of the same float type and device."""


class Gradient(NamedTuple):
    """Partial derivatives of d, steps per unit of each input: at a point ``(O,)``, ``(A,)``, ``(G,)``; at several,
    with the leading dimensions that the inputs broadcast to.
    """

    observation: Any
    action: Any
    goal: Any


@dataclass(frozen=True)
class Distance:
    """A trained d(s, a, g) in steps, with the policy that was trained beside it.

    Leading dimensions of observation ``(..., O)``, action ``(..., A)`` and goal ``(..., G)`` may be any that broadcast;
    a single point gives a single number. An action of None is the policy's. Torch inputs carry gradients through.

    Attributes:
        model: networks, configuration and header of the file.
    """

    model: Model

    def __repr__(self) -> str:
        """A line, not all weights' shapes: notebooks show it."""
        trained = f"{self.model.config.method}, {self.model.header['episodes']} episodes"
        return f"<d(s, a, g) of {self.task}: {trained}, at most {self.episode_length} steps>"

    @property
    def task(self) -> str:
        """Name of the task that it was trained on."""
        return self.model.config.env

    @property
    def episode_length(self) -> int:
        """T, steps: no distance is larger."""
        return self._network.episode_length

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Widths of observation, action and goal."""
        observation, action, goal = self.model.header["sizes"]
        return observation, action, goal

    def __call__(self, observation: Array, action: Array | None, goal: Array) -> Any:
        """Steps ``(...)``, within [0, T], from the observation to the goal with ``action`` as the first action.

        Raises:
            ValueError: an input has another width than the model's, or they do not broadcast.
        """
        rows, leading = self._rows(observation, action, goal)
        carries = any(isinstance(part, Tensor) for part in (observation, action, goal))
        with torch.set_grad_enabled(carries and torch.is_grad_enabled()):
            steps = self._network.steps(*rows)
        return _like(_first(observation, action, goal), steps.reshape(leading))

    def gradient(self, observation: Array, action: Array | None, goal: Array) -> Gradient:
        """Derivatives of d by its inputs, of the network itself: they do not vanish where d is cut off at 0 or T.

        An action of None is the policy's, held fixed.

        Raises:
            ValueError: see :meth:`__call__`.
        """
        rows, leading = self._rows(observation, action, goal)
        rows = [part.detach().requires_grad_() for part in rows]
        with torch.enable_grad():
            found = torch.autograd.grad(self._network(*rows).sum(), rows)
        like = _first(observation, action, goal)
        return Gradient(*(_like(like, part.reshape(*leading, -1)) for part in found))

    def action(self, observation: Array, goal: Array) -> Any:
        """The policy's action ``(..., A)``, in [-1, 1].

        Raises:
            ValueError: see :meth:`__call__`.
        """
        rows, leading = self._rows(observation, None, goal)
        return _like(_first(observation, None, goal), rows[1].reshape(*leading, -1))

    def explain(self) -> str:
        """Task, T, sizes and how it was trained, in a few lines."""
        header, (observation, action, goal) = self.model.header, self.sizes
        return "\n".join([
            f"d(s, a, g) in steps for {self.task}: {observation} numbers of s, {action} of a, {goal} of g, at most "
            f"T = {self.episode_length}",
            f"method {self.model.config.method}, {header['episodes']} episodes, seed {self.model.config.seed}, "
            f"revision {header['revision']}",
            f"trained with: {command_line(self.model.config)}",
        ])  # fmt: skip

    @property
    def _network(self) -> DistanceNetwork:
        if self.model.distance is None:
            raise ValueError(f"this model of {self.task} was trained with --method sparse, which learns no distance")
        return self.model.distance

    def _rows(self, observation: Array, action: Array | None, goal: Array) -> tuple[list[Tensor], tuple[int, ...]]:
        """Rows ``(B, .)`` of all three for the networks, and what B stands for; a = pi(s, g) if there is none."""
        names, given = ("observation", "action", "goal"), (observation, action, goal)
        parts = {name: _tensor(part) for name, part in zip(names, given, strict=True) if part is not None}
        for name, size in zip(names, self.sizes, strict=True):
            if name in parts and parts[name].shape[-1:] != (size,):
                shape = tuple(parts[name].shape)
                raise ValueError(f"{name} has shape {shape}; {self.task} wants {size} numbers in its last dimension")
        try:
            leading = torch.broadcast_shapes(*(part.shape[:-1] for part in parts.values()))
        except RuntimeError:
            shapes = ", ".join(f"{name} {tuple(part.shape)}" for name, part in parts.items())
            raise ValueError(f"leading dimensions do not fit each other: {shapes}") from None
        rows = {name: part.expand(*leading, -1).reshape(-1, part.shape[-1]) for name, part in parts.items()}
        if "action" not in rows:
            rows["action"] = self.model.policy.mode(rows["observation"], rows["goal"])
        return [rows[name] for name in names], tuple(leading)


def _tensor(part: Array) -> Tensor:
    """Numbers as the networks read them; numpy's may lie in any order, and be read-only."""
    return torch.as_tensor(part if isinstance(part, Tensor) else np.array(part, np.float32)).to("cpu", torch.float32)


def _first(observation: Array, action: Array | None, goal: Array) -> Array:
    """What decides the kind of the answer: the first tensor, if any was given."""
    return next((part for part in (observation, action, goal) if isinstance(part, Tensor)), observation)


def _like(given: Array, found: Tensor) -> Any:
    """The result as the kind of thing that was given: numpy or torch, of its float type, on its device."""
    if isinstance(given, Tensor):
        return found.to(given.device, given.dtype if given.is_floating_point() else torch.float32)
    kind = np.asarray(given).dtype
    return found.detach().numpy().astype(kind if kind.kind == "f" else np.float32)[()]


def load(name: str | Path, env: str | None = None) -> Distance:
    """A trained distance: the name of one that ships, or a file or folder written by a training.

    Args:
        name: such as ``"fetch_wall"`` or ``"runs/fetch_wall-ours-s0"``.
        env: the task it has to be of, if that matters.

    Raises:
        UserError: there is no such file, it is damaged, or of another task.
    """
    return Distance(load_model(name, env))


def make(task: str, reached: str | None = None, **kwargs: Any) -> gymnasium.Env:
    """The environment of a task, as training sees it; of one that can be planned in, as planning does.

    Args:
        task: its name, a Gymnasium id, ``package:id`` or ``module:Class``.
        reached: success test of a goal environment whose rewards are dense, see docs/goal_environments.md.
        kwargs: of its class.

    Raises:
        UserError: unknown, or an environment that cannot be used.
    """
    name = tasks.canonical_name(task)
    return (tasks.make if saves_its_state(name, **kwargs) else make_goal_task)(name, reached, **kwargs)


def evaluate(distance: Distance, episodes: int = 50, seed: int = FIRST_SEED) -> Outcomes:
    """What the policy of a model comes to on its task, on the reset seeds ``seed``, ``seed + 1``, ...

    Raises:
        UserError: the task is not at hand, or has other sizes now.
        ValueError: ``episodes`` is below 1, or ``seed`` below 0.
    """
    if episodes < 1 or seed < 0:
        raise ValueError(f"episodes is {episodes} and seed {seed}; they must be at least 1 and 0")
    model, env = distance.model, make_goal_task(distance.task, distance.model.config.reached)
    model.check_sizes(env)
    try:
        actor = GreedyPolicy(model.policy)
        found, _ = run_episodes([env], actor, [seed + i for i in range(episodes)], model.config.episode_length)
    finally:
        env.close()
    return found


def train(
    task: str = "fetch_wall",
    method: str = "ours",
    *,
    episodes: int | None = None,
    seed: int = 0,
    recipe: str = PAPER,
    options: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    restart: bool = False,
    on_evaluation: Callable[[dict[str, float]], Any] | None = None,
    device: Literal["auto", "cpu", "cuda"] = "cpu",
    compiled: bool = False,
) -> Distance:
    """Train as ``python -m napsp.train`` does, in a folder that can be resumed, and load what came of it.

    Args:
        task: see :func:`make`.
        method: ours, plus, offpolicy_ddl, ddl, sparse or qrl.
        episodes: training episodes; the task's own if None.
        seed: of everything random.
        recipe: paper, or manipulation for pick and place.
        options: any other option of the command by its dotted name, such as ``{"temporal.first_arrival": True}``.
        out: folder of the run; an unfinished one with the same settings is continued.
        restart: overwrite the run in that folder instead.
        on_evaluation: is handed the figures of each evaluation; returning False ends the training, saved.
        device: where the networks are trained.
        compiled: compile the losses.

    Raises:
        UserError: an option is unknown or out of its range, or the folder holds a run with other settings.
        KeyboardInterrupt: Ctrl-C; what was done so far is saved, and the same call continues it.
    """
    changes = dict(options or {}) | ({} if episodes is None else {"n_episodes": episodes})
    config = preset(task, method, recipe, changes, seed=seed)
    tell_of_unread(config, stacklevel=4)  # whoever called the package
    folder, stopped = Path(out) if out is not None else usual_folder(config), False

    def watch(row: dict[str, float]) -> bool:
        nonlocal stopped
        stopped = on_evaluation is not None and says_no(on_evaluation(row))
        return not stopped

    run_training(config, folder, restart, execution=Execution(device, compiled), on_evaluation=watch)
    if not stopped and not (folder / RECORD_FILE).is_file():
        raise KeyboardInterrupt
    return load(folder)
