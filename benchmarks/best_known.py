"""The fewest steps anybody needed: ``python -m benchmarks.best_known --env fetch_wall --checkpoint fetch_wall``.

Plans every episode of a fixed set with a large budget and keeps, over all calls, the shortest way to each goal, as the
actions that lead there (``results/best_known/TASK.json``). An upper bound of the true distance, and called so. With
``--lasting 10`` ways end where an arrival that lasts ten control steps begins (``TASK_lasting_10.json``): a box or a
valve at speed is past its goal again a step after it got there.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import AGAIN, RESULTS
from benchmarks.command import read_options
from benchmarks.maze_probe import Probe
from napsp import envs as tasks
from napsp.errors import UserError, run_command
from napsp.storage.files import read_json, write_json
from napsp.storage.revision import git_revision
from planners.app.config import PlanConfig
from planners.app.episode import EpisodeResult
from planners.app.options import RunOptions
from planners.app.session import Session

FOLDER = RESULTS / "best_known"


@dataclass(frozen=True)
class KnownOptions:
    """Look for shorter ways to the goals of a fixed set of episodes."""

    env: str = "fetch_wall"
    """Task."""
    checkpoint: Path | None = None
    """Whose distance plans; default the one that ships."""
    planner: str = "icem"
    """mppi, cem or icem."""
    samples: int = 256
    """Samples of every plan."""
    horizon: int | None = None
    """Control steps of every plan; default the task's."""
    episodes: int = 40
    """Episodes."""
    seed: int = 70_000
    """First episode seed."""
    lasting: int = 1
    """Control steps in succession that the goal is held after a way; 1 is the first arrival."""


def path_of(env_name: str, lasting: int = 1) -> Path:
    """Where ways are kept."""
    return FOLDER / f"{tasks.file_name(env_name)}{'' if lasting == 1 else f'_lasting_{lasting}'}.json"


def ways(env_name: str, lasting: int = 1) -> dict[str, dict[str, Any]]:
    """The shortest way of each episode by its seed: steps, actions ``(steps + lasting - 1, A)``, and who found it."""
    path = path_of(env_name, lasting)
    return read_json(path, AGAIN) if path.is_file() else {}


def known_probe(env_name: str, lasting: int = 1) -> Probe:
    """Every state on the shortest ways, with the action taken there and the steps that were left to the goal.

    Raises:
        UserError: no ways are known for the task.
    """
    known = ways(env_name, lasting)
    if not known:
        command = f"python -m benchmarks.best_known --env {env_name}" + (f" --lasting {lasting}" * (lasting > 1))
        raise UserError(f"no ways are known for {env_name}; {command} looks for some")
    env = tasks.make(env_name)
    parts: list[tuple[np.ndarray, ...]] = []
    places, achieved = [], []
    for seed, way in known.items():
        actions = np.array(way["actions"], np.float32)
        seen, goal = _follow(env, int(seed), actions)
        if not all(env.unwrapped.reached(values["achieved_goal"], goal) for values in seen[-lasting:]):  # type: ignore[attr-defined]
            raise UserError(f"the stored way of episode {seed} of {env_name} does not lead to its goal any more")
        n = len(actions) + 1 - lasting
        seen, actions = seen[: n + 1], actions[:n]
        rows = [values["observation"] for values in seen]
        goals = np.tile(goal, (n, 1))
        parts.append((np.stack(rows[:-1]), actions, goals, np.arange(n, 0, -1.0), np.arange(n) == 0))
        places += rows
        achieved += [values["achieved_goal"] for values in seen]
    env.close()
    observations, actions, goals, steps, first = (np.concatenate(column) for column in zip(*parts, strict=True))
    kinds = {"from the start": first}
    return Probe(
        observations, actions, goals, steps, kinds, np.arange(len(steps)), np.stack(places), np.stack(achieved)
    )


def _follow(env: Any, seed: int, actions: np.ndarray) -> tuple[list[dict[str, np.ndarray]], np.ndarray]:
    """What is seen before each action and after the last, and the goal."""
    seen = [env.reset(seed=seed)[0]]
    seen += [env.step(action)[0] for action in actions]
    return seen, seen[0]["desired_goal"]


def length_of(result: EpisodeResult, reached: Any, lasting: int) -> int | None:
    """Control steps until an arrival that lasted to the episode's end, ``lasting`` of them; None if none did."""
    n = len(result.actions) + 1 - lasting
    held = n > 0 and all(reached(place, result.desired_goal) for place in result.achieved_goals[n:])
    return n if held else None


def main() -> int:
    """Plan, compare with what is known, keep the shorter way."""
    options = read_options(KnownOptions, "best_known")
    changes = {"env": options.env, "search.samples": options.samples}
    config = PlanConfig.of(options.planner, changes | ({"horizon": options.horizon} if options.horizon else {}))
    session = Session.open(config, RunOptions(seed=options.seed, checkpoint=options.checkpoint))
    longest = tasks.episode_length(session.env_name)
    if options.lasting > longest:
        raise UserError(f"--lasting is {options.lasting}; episodes of {session.env_name} have {longest} steps")
    known, shorter = ways(session.env_name, options.lasting), 0
    before = [way["steps"] for way in known.values()]
    for seed in range(options.seed, options.seed + options.episodes):
        result, best = session.run_episode(seed, hold=options.lasting), known.get(str(seed))
        steps = length_of(result, session.env.unwrapped.reached, options.lasting)
        if steps is not None and (best is None or steps < best["steps"]):
            found = {"planner": options.planner, "samples": options.samples, "horizon": session.horizon,
                     "checkpoint": str(options.checkpoint or session.env_name), "revision": git_revision()}  # fmt: skip
            known[str(seed)] = {"steps": steps, **found, "actions": np.asarray(result.actions, np.float32).tolist()}
            shorter += 1
    session.close()
    FOLDER.mkdir(parents=True, exist_ok=True)
    write_json(path_of(session.env_name, options.lasting), dict(sorted(known.items())))
    after = [way["steps"] for way in known.values()]
    print(f"{session.env_name}: {len(known)} episodes known, {shorter} shorter than before; mean steps "
          f"{np.mean(before) if before else np.nan:.2f} -> {np.mean(after) if after else np.nan:.2f}")  # fmt: skip
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
