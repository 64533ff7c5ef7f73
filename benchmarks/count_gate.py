"""How often the gate of eq. 4b errs: ``python -m benchmarks.count_gate --env fetch_wall``.

Algorithm 1, line 13 raises or relaxes d(s_i, a_i, s_g) where N(s_i, a_i, s_g) = 0 and N(s_j, a_j, s_g) > 0. So N has
to be 0 for goals that no data came near and above 0 for goals that were reached. Measured on the episodes of random
actions that training begins with, and on those together with episodes of the trained policy and its exploration:

*false*: N(s, a, g) > 0 for a goal g that no episode came within two radii of. Two kinds of g: places all over the goal
space that nobody came near, and goals of the task, with the episodes that came near them left out of the counts.
*true*: N(s, a, g) > 0 for a goal half a radius beside a state that the same episode reached later.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.cells import RESULTS, as_text, replace_results
from benchmarks.command import read_options
from napsp import envs as tasks
from napsp.config import TrainConfig, preset
from napsp.data.collect import ExploringActor, roll
from napsp.data.episodes import Episodes, concatenate
from napsp.distance.counts import CountModel, scaled_pairs
from napsp.envs.actions import used_actions
from napsp.errors import run_command
from napsp.learner import scaling_of
from napsp.run import EVALUATION_SEED, warm_up
from napsp.settings import to_dict
from napsp.storage.checkpoint import load_model, sizes_of
from napsp.storage.files import write_json
from napsp.storage.revision import git_revision
from napsp.storage.shipped import shipped_model, shipped_names

N_RECENT = 64  # episodes whose (s, a) are asked about: eq. 4b asks about the latest ones


@dataclass(frozen=True)
class CountGateOptions:
    """Measure the gate of eq. 4b."""

    env: str = "fetch_wall"
    """Task."""
    checkpoint: Path | None = None
    """Whose policy acts; default: the one that ships. Without one, warm-up episodes alone are measured."""
    episodes: int = 1000
    """Episodes of the trained policy."""
    goals: int = 100
    """Goals of each kind."""
    rows: int = 2000
    """Pairs (s, a)."""
    seed: int = 0
    """Seed of everything."""
    json: Path | None = None
    """JSON file for the figures."""


class Gate:
    """N(s, a, g) over some episodes, and which of them know a key.

    Args:
        episodes: all data.
        counts: hashes; its own counts are not used, so that episodes can be left out.
    """

    def __init__(self, episodes: Episodes, counts: CountModel) -> None:
        self._counts = counts
        pairs = scaled_pairs(counts.scaling, episodes.observations[:, :-1], episodes.actions)
        goals = counts.scaling.goal(episodes.achieved_goals)
        first, later = np.triu_indices(goals.shape[1], k=1)
        self._known = []
        for table in counts.reached_tables:
            starts, ends = table.pair_part(pairs), table.goal_part(goals)
            found = [np.unique(start[first] + end[later]) for start, end in zip(starts, ends, strict=True)]
            keys, owners = np.concatenate(found), np.repeat(np.arange(len(found)), [len(own) for own in found])
            order = np.argsort(keys, kind="stable")
            self._known.append((keys[order], owners[order]))

    def open(self, pairs: np.ndarray, goals: np.ndarray, counted: np.ndarray | None = None) -> np.ndarray:
        """Whether N(s, a, g) > 0 for scaled rows ``(B, .)``; ``counted`` bool ``(E,)`` are the episodes counted."""
        found = np.zeros(len(pairs), bool)
        for table, (keys, owners) in zip(self._counts.reached_tables, self._known, strict=True):
            asked = table.pair_part(pairs) + table.goal_part(goals)
            places = [np.searchsorted(keys, asked, side) for side in ("left", "right")]
            kept = np.ones(len(keys), bool) if counted is None else counted[owners]
            before = np.concatenate([[0], np.cumsum(kept)])
            found |= before[places[1]] > before[places[0]]
        return found


def rates(world: Any, episodes: Episodes, wanted: np.ndarray, counts: CountModel, options: CountGateOptions) -> dict:
    """False rates, of both kinds, and the true rate on some episodes; ``wanted`` ``(n, G)`` are goals of the task."""
    rng, length = np.random.default_rng(options.seed), episodes.actions.shape[1]
    gate, achieved = Gate(episodes, counts), episodes.achieved_goals
    e = rng.integers(max(0, len(episodes) - N_RECENT), len(episodes), options.rows)
    i = rng.integers(length, size=options.rows)
    pairs = scaled_pairs(counts.scaling, episodes.observations[e, i], episodes.actions[e, i])

    places = np.concatenate([achieved.reshape(-1, achieved.shape[-1]), wanted])
    anywhere = rng.uniform(places.min(0), places.max(0), (4 * options.goals, places.shape[1])).astype(np.float32)
    shunned = anywhere[~np.array([near(world, achieved, goal).any() for goal in anywhere])][: options.goals]
    false_anywhere = [gate.open(pairs, scaled(counts, goal, len(pairs))).mean() for goal in shunned]
    false_left_out = [
        gate.open(pairs, scaled(counts, goal, len(pairs)), ~near(world, achieved, goal)).mean()
        for goal in wanted[: options.goals]
    ]
    later = achieved[e, rng.integers(i + 1, length + 1)]
    true = gate.open(pairs, counts.scaling.goal(beside(world, later, rng)))
    return {
        "false_anywhere": float(np.mean(false_anywhere)) if len(shunned) else float("nan"),
        "false_left_out": float(np.mean(false_left_out)),
        "true": float(true.mean()),
    }


def scaled(counts: CountModel, goal: np.ndarray, n: int) -> np.ndarray:
    """One goal ``(G,)`` as n scaled rows."""
    return np.broadcast_to(counts.scaling.goal(goal), (n, len(goal)))


def near(world: Any, achieved: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Which episodes ``(E, T + 1, G)`` came within two radii of a goal: half way to it counts as being there."""
    return world.reached(0.5 * (achieved + goal), np.broadcast_to(goal, achieved.shape)).any(1)


def beside(world: Any, goals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Goals half a radius beside goals ``(n, G)``, in random directions; the radius is found by bisection."""
    direction = rng.standard_normal(goals.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    low, high = np.zeros((len(goals), 1)), np.full((len(goals), 1), 10.0)
    for _ in range(40):
        middle = 0.5 * (low + high)
        inside = np.asarray(world.reached(goals + middle * direction, goals))[:, None]
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return (goals + 0.5 * low * direction).astype(np.float32)


def play(config: TrainConfig, policy: Any, options: CountGateOptions) -> tuple[Any, Episodes, Episodes | None]:
    """The task, its warm-up episodes, and those of a policy with the exploration of its training."""
    envs: list[Any] = [tasks.make(config.env) for _ in range(config.episodes_per_iteration)]
    rng, generator = np.random.default_rng(options.seed), torch.Generator().manual_seed(options.seed)
    warmup, parts = warm_up(envs, config, rng, generator), []
    while policy is not None and sum(map(len, parts)) < options.episodes:
        actor = ExploringActor(policy, envs[0].action_space.shape[0], config.explore, rng, generator)
        seeds = [int(seed) for seed in rng.integers(EVALUATION_SEED, size=len(envs))]
        parts.append(roll(envs, actor, seeds, config.episode_length))
    return envs[0], warmup, concatenate([warmup, *parts]) if parts else None


def measure(options: CountGateOptions) -> dict[str, Any]:
    """All figures of a task."""
    env_name = tasks.canonical_name(options.env)
    ships = env_name in shipped_names()
    model = load_model(options.checkpoint or shipped_model(env_name), env_name) if options.checkpoint or ships else None
    config = preset(env_name) if model is None else model.config
    counted = preset(env_name).counts
    env: Any
    env, warmup, everything = play(config, None if model is None else model.policy, options)
    wanted = np.stack([env.reset(seed=EVALUATION_SEED + i)[0]["desired_goal"] for i in range(options.goals)])
    figures: dict[str, Any] = {"env": env_name, "training": "" if model is None else as_text(config.identity())}
    figures |= {"counts": as_text(to_dict(counted)), "warmup_episodes": len(warmup), "trained_episodes": 0}
    for kind, episodes in (("warmup", warmup), ("trained", everything)):
        if episodes is None:
            continue
        scaling = scaling_of(episodes if config.rescale else warmup)
        rng = np.random.default_rng(options.seed)
        counts = CountModel(sizes_of(env), counted, scaling, rng, used_actions(env.unwrapped))
        found = rates(env.unwrapped, episodes, wanted.astype(np.float32), counts, options)
        figures |= {f"{kind}_{name}": value for name, value in found.items()}
        figures[f"{kind}_episodes"] = len(episodes)
    env.close()
    false = [value for name, value in figures.items() if "_false_" in name]
    figures["false_rate"] = float(np.nanmax(false))
    figures["true_rate"] = min(value for name, value in figures.items() if name.endswith("_true"))
    return figures


def main() -> int:
    """Measure, print, keep a row of the usual options, optionally write JSON."""
    options = read_options(CountGateOptions, "count_gate")
    torch.set_num_threads(1)
    figures = measure(options)
    for name, value in figures.items():
        print(f"{name:24s} {value:.3f}" if isinstance(value, float) else f"{name:24s} {value}")
    if replace(options, env=CountGateOptions.env, json=None) == CountGateOptions():  # what tables compare
        row = {k: round(v, 4) if isinstance(v, float) else v for k, v in figures.items()}
        replace_results(RESULTS / "count_gate.csv", ("env",), [{**row, "revision": git_revision()}])
    if options.json is not None:
        write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
