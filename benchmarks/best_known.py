"""The fewest steps anybody needed: ``python -m benchmarks.best_known --env fetch_wall --checkpoint fetch_wall``.

Plans every episode of a fixed set with a large budget and keeps, over all calls, the shortest way to each goal, as the
actions that lead there (``results/best_known/TASK.json``). An upper bound of the true distance, and called so. With
``--hold 10`` also the shortest ways to arrivals that are held ten control steps (``TASK_hold_10.json``): a box or a
valve at speed is past its goal again a step after it got there.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
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
    hold: int = 1
    """Also ways to arrivals that are held so many control steps in succession, the arriving one among them."""


def path_of(env_name: str, hold: int = 1) -> Path:
    """Where ways are kept."""
    return FOLDER / f"{tasks.file_name(env_name)}{'' if hold == 1 else f'_hold_{hold}'}.json"


def ways(env_name: str, hold: int = 1) -> dict[str, dict[str, Any]]:
    """The shortest way of each episode by its seed: steps, actions ``(steps + hold - 1, A)``, and who found it."""
    path = path_of(env_name, hold)
    return read_json(path, AGAIN) if path.is_file() else {}


def check_hold(env_name: str, hold: int) -> None:
    """Check that a goal can be held so long.

    Raises:
        UserError: episodes are shorter.
    """
    longest = tasks.episode_length(env_name)
    if hold > longest:
        raise UserError(f"--hold is {hold}; episodes of {env_name} have {longest} steps")


def known_probe(env_name: str, hold: int = 1) -> Probe:
    """Every state on the shortest ways, with the action taken there and the steps that were left to the goal.

    Args:
        env_name: task.
        hold: control steps for which the arrivals are held; 1 is first arrivals.

    Raises:
        UserError: no ways are known for the task, one no longer leads to its goal, or episodes are shorter.
    """
    check_hold(env_name, hold)
    known = ways(env_name, hold)
    if not known:
        command = f"python -m benchmarks.best_known --env {env_name}" + (f" --hold {hold}" * (hold > 1))
        raise UserError(f"no ways are known for {env_name}; {command} looks for some")
    env = tasks.make(env_name)
    parts: list[tuple[np.ndarray, ...]] = []
    places, achieved = [], []
    for seed, way in known.items():
        actions = np.array(way["actions"], np.float32)
        seen, goal = _follow(env, int(seed), actions)
        if not all(env.unwrapped.reached(values["achieved_goal"], goal) for values in seen[-hold:]):  # type: ignore[attr-defined]
            raise UserError(f"the stored way of episode {seed} of {env_name} does not lead to its goal any more")
        n = len(actions) + 1 - hold
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


def arrival(reached: Sequence[bool], hold: int) -> int | None:
    """Control steps until the first arrival that is held; ``reached[t]`` says whether the goal is after t steps."""
    return next((t for t in range(1, len(reached) + 1 - hold) if all(reached[t : t + hold])), None)


def main() -> int:
    """Plan, compare with what is known, keep the shorter ways."""
    options = read_options(KnownOptions, "best_known")
    env_name = tasks.canonical_name(options.env)
    check_hold(env_name, options.hold)
    changes = {"env": env_name, "search.samples": options.samples}
    config = PlanConfig.of(options.planner, changes | ({"horizon": options.horizon} if options.horizon else {}))
    session = Session.open(config, RunOptions(seed=options.seed, checkpoint=options.checkpoint))
    found = {"planner": options.planner, "samples": options.samples, "horizon": session.horizon,
             "checkpoint": str(options.checkpoint or env_name), "revision": git_revision()}  # fmt: skip
    # The beginning of a way that holds is a way to a first arrival, so that these are never the longer ones.
    known = {hold: ways(env_name, hold) for hold in sorted({1, options.hold})}
    before, shorter = {hold: [way["steps"] for way in some.values()] for hold, some in known.items()}, 0
    for seed in range(options.seed, options.seed + options.episodes):
        result = session.run_episode(seed, hold=options.hold)
        reached = [bool(session.env.unwrapped.reached(g, result.desired_goal)) for g in result.achieved_goals]
        for hold, some in known.items():
            steps, best = arrival(reached, hold), some.get(str(seed))
            if steps is not None and (best is None or steps < best["steps"]):
                actions = np.asarray(result.actions[: steps + hold - 1], np.float32).tolist()
                some[str(seed)] = {"steps": steps, **found, "actions": actions}
                shorter += hold == options.hold
    session.close()
    if not known[options.hold]:
        raise UserError(
            f"no episode of {env_name} held its goal {options.hold} steps; "
            "give a smaller --hold, or another --planner or --checkpoint"
        )
    FOLDER.mkdir(parents=True, exist_ok=True)
    for hold, some in known.items():
        write_json(path_of(env_name, hold), dict(sorted(some.items())))
    after, was = [way["steps"] for way in known[options.hold].values()], before[options.hold]
    print(f"{env_name}: {len(after)} episodes known, {shorter} shorter than before; mean steps "
          f"{np.mean(was) if was else np.nan:.2f} -> {np.mean(after):.2f}")  # fmt: skip
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
