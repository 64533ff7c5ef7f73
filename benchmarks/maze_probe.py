"""Questions to a distance whose answers are known exactly: pairs of places of a maze, balanced over its rooms."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import AGAIN, RESULTS
from benchmarks.maze_truth import MazeSearch
from napsp import envs as tasks
from napsp.errors import UserError
from napsp.storage.files import read_json, sound, write_json

ROOMS = ((-1, -1), (-1, 1), (1, 1), (1, -1))
"""Signs of x and y of the rooms in the order in which doors chain them; episodes begin in the first, goals lie in the
third."""
N_ACTIONS, SEVERAL = 3, 4
"""Actions of every fourth start; the others have one."""
N_SPEEDS, N_SPEEDS_LARGE = 5, 3
"""Cells of velocity per axis. Three are a third of the work, and ways .7 % longer on the small maze."""
TRUTHS = RESULTS / "maze_truth"


@dataclass(frozen=True)
class Probe:
    """What a distance is asked, and the truth.

    Attributes:
        observations: ``(n, O)``.
        actions: ``(n, A)``.
        goals: ``(n, G)``.
        steps: true ones, or the best that is known, ``(n,)``.
        kinds: what pairs are of, by name, bool ``(n,)`` each.
        alternatives: rows that differ in the action alone share a number, ``(n,)``.
        places: some observations ``(m, O)`` ...
        achieved: ... and their achieved goals ``(m, G)``, for triangles.
    """

    observations: np.ndarray
    actions: np.ndarray
    goals: np.ndarray
    steps: np.ndarray
    kinds: dict[str, np.ndarray]
    alternatives: np.ndarray
    places: np.ndarray
    achieved: np.ndarray


def maze_probe(env_name: str, n_starts: int, n_goals: int, seed: int = 0) -> Probe:
    """Starts at rest and goals anywhere in the rooms, uniform actions, several of them at some starts.

    Args:
        env_name: a maze.
        n_starts: starts in each room.
        n_goals: goals in each room, drawn anew for every start.
        seed: of the draw.
    """
    world: Any = tasks.make(env_name).unwrapped
    rng, n_rooms = np.random.default_rng(seed), len(ROOMS)

    def places(room: int, n: int) -> np.ndarray:
        return np.array(ROOMS[room]) * rng.uniform(0.1, 0.9, (n, 2)) * world.scale

    starts = np.concatenate([places(room, n_starts) for room in range(n_rooms)])
    starts = np.concatenate([starts, np.zeros_like(starts)], axis=1)
    actions = rng.uniform(-1.0, 1.0, (len(starts), N_ACTIONS, 2))
    goals = np.stack([np.concatenate([places(room, n_goals) for room in range(n_rooms)]) for _ in starts])
    spots = np.concatenate([places(room, 100) for room in range(n_rooms)])
    steps = _truth(TRUTHS / f"{env_name}-{n_starts}-{n_goals}-{seed}.json", world, starts, actions, goals)
    shape = steps.shape  # (start, action, goal)
    i, j, k = (index.ravel() for index in np.indices(shape))
    room, other = i // n_starts, k // n_goals
    kinds = {"same room": room == other, "onwards": room < other, "backwards": room > other,
             "of the task": (room == 0) & (other == 2), "last room": (room == 3) | (other == 3)}  # fmt: skip
    at_rest = np.concatenate([spots, np.zeros_like(spots)], axis=1)
    rows = starts[i], actions[i, j], goals[i, k], steps.ravel()
    return Probe(*rows, kinds, i * shape[2] + k, at_rest, spots)


def _truth(path: Path, world: Any, starts: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """True steps ``(S, A, M)``; a search of many seconds for each start and action, so they are kept in a file.

    Raises:
        UserError: the file answers other questions.
    """
    tolerance = world.distance_threshold / world.scale  # what the task itself counts as being there
    questions = (starts, actions, goals, np.array(tolerance))
    asked = hashlib.sha256(b"".join(np.round(part, 9).tobytes() for part in questions)).hexdigest()
    n_speeds = N_SPEEDS if world.scale <= 1.0 else N_SPEEDS_LARGE
    if path.is_file():
        stored = read_json(path, AGAIN)
        if stored.get("asked") != asked or stored.get("n_speeds", N_SPEEDS) != n_speeds:
            raise UserError(f"{path} answers other questions; remove it, and the search begins again")
        with sound(path, AGAIN):
            steps = np.array(stored["steps"], float).reshape(*actions.shape[:2], goals.shape[1])
        return np.where(steps < 0, np.inf, steps)
    search = MazeSearch(world, n_speeds=n_speeds, tolerance=tolerance)
    steps = np.empty((*actions.shape[:2], goals.shape[1]))
    for i, state in enumerate(starts):
        print(f"\rsearching from start {i + 1} of {len(starts)}", end="", flush=True)
        steps[i] = np.inf  # not asked
        for j, action in enumerate(actions[i] if i % SEVERAL == 0 else actions[i, :1]):
            following = search.step(state[None], action[None])[0]
            steps[i, j] = 1.0 + search.steps_to(following, goals[i])
    print()
    search.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = np.where(np.isinf(steps), -1, steps).astype(int).tolist()
    write_json(path, {"asked": asked, "n_speeds": n_speeds, "steps": kept})
    return steps
