"""What does a coarser planning model cost and bring? ``python -m benchmarks.coarse_model --env fetch_wall``.

The same action sequences are rolled out, from the same states of executed episodes, in the environment's own model and
in coarser ones: how much CPU time less, and how far apart are the achieved goals at the end. Three kinds of actions:
fresh random ones at every step, one random action held throughout (which drives an arm into table and wall), and those
of the policy. Rows go to ``results/coarse_model.csv``; measured again, they replace the old ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from benchmarks.cells import RESULTS, replace_results
from benchmarks.command import read_options
from benchmarks.machine import machine
from benchmarks.rollout_speed import clocked
from mpc.rollout import Actor, RolloutEngine, Trajectories
from napsp import envs as tasks
from napsp.envs.coarse import coarse
from napsp.envs.dynamics import get_state
from napsp.errors import UserError, run_command
from napsp.policy.greedy import GreedyPolicy
from napsp.storage.checkpoint import load_model
from napsp.storage.shipped import shipped_model
from planners.app.config import PlanConfig

KEY = ("env", "actions", "horizon", "substeps")
ENVS = ("point_maze", "fetch_wall", "fetch_pick_place_wall", "claw")
HELD_STEPS = 5  # of random actions that make an episode where no policy is at hand
STEPS_BETWEEN = 3  # control steps from one start state to the next


@dataclass(frozen=True)
class CoarseOptions:
    """Compare coarser planning models with the environment's own."""

    env: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Task; repeat the option for several. Default: one of each kind."""
    substeps: tuple[int, ...] = ()
    """Physics steps per control step to try; default: all divisors of the task's own number."""
    horizon: int | None = None
    """Control steps per rollout; default: the planners' for the task."""
    samples: int = 16
    """Random action sequences of each kind per start state."""
    episodes: int = 4
    """Episodes that start states are taken from."""
    seed: int = 0
    """Seed of episodes and actions."""
    threads: int = 1
    """Simulation threads."""
    checkpoint: Path | None = None
    """Whose policy acts; default: the one that ships with the package, or none."""


class Comparison:
    """Errors and CPU times of one kind of actions in one model."""

    def __init__(self) -> None:
        self.errors: list[np.ndarray] = []
        self.seconds = np.zeros(2)  # environment's model, coarse model
        self.n_diverged = 0

    def add(self, exact: Trajectories, found: Trajectories, seconds: tuple[float, float]) -> None:
        """Take in one batch."""
        offset = found.achieved_goals[:, -1] - exact.achieved_goals[:, -1]
        self.errors.append(np.linalg.norm(offset, axis=-1)[~exact.diverged & ~found.diverged])
        self.n_diverged += int((found.diverged & ~exact.diverged).sum())
        self.seconds += seconds

    def figures(self) -> dict[str, Any]:
        """Columns of a row."""
        errors = np.concatenate(self.errors)
        low, high, most = np.quantile(errors, (0.5, 0.9, 1.0)) if len(errors) else [float("nan")] * 3
        exact, found = self.seconds
        return {
            "rollouts": len(errors) + self.n_diverged, "speedup_cpu": round(exact / found, 3),
            "error_median": f"{low:.3g}", "error_p90": f"{high:.3g}", "error_max": f"{most:.3g}",
            "diverged": self.n_diverged,
        }  # fmt: skip


def start_states(
    world: Any, name: str, actor: Actor | None, options: CoarseOptions
) -> Iterator[tuple[np.ndarray, Any]]:
    """States and observations along executed episodes."""
    rng = np.random.default_rng(options.seed)
    for episode in range(options.episodes):
        # Pushing a box by chance is rare; every other episode starts with it in the gripper.
        held = {"box_held": True} if getattr(world, "grasps", False) and episode % 2 else None
        observation, _ = world.reset(seed=options.seed + episode, options=held)
        action = np.zeros(world.action_space.shape, np.float32)
        for step in range(tasks.episode_length(name)):
            if step % STEPS_BETWEEN == 0:
                yield get_state(world.model, world.data), observation
            if actor is not None:
                goal = observation["desired_goal"].astype(np.float32)[None]
                action = actor(observation["observation"].astype(np.float32)[None], goal)[0]
            elif step % HELD_STEPS == 0:
                action = rng.uniform(-1, 1, action.shape).astype(np.float32)
            observation, *_ = world.step(action)


def substeps_of(world: Any, options: CoarseOptions) -> list[int]:
    """Which coarse models to try; the task's own number of steps only where collisions are left out."""
    own = world.dynamics.substeps
    if any(not 1 <= n <= own for n in options.substeps):
        raise UserError(f"--substeps {' '.join(map(str, options.substeps))} do not fit; give numbers from 1 to {own}")
    most = own if hasattr(world.dynamics, "simplify") else own - 1
    return list(options.substeps) or [n for n in range(most, 0, -1) if own % n == 0]


def measure(name: str, options: CoarseOptions) -> list[dict[str, Any]]:
    """Rows of one task."""
    env = tasks.make(name)
    world: Any = env.unwrapped
    horizon = options.horizon or PlanConfig.of("mppi", {"env": name}).usual.horizon
    actor, rng = policy_of(name, options), np.random.default_rng(options.seed)
    exact = RolloutEngine(world.dynamics, options.threads)
    engines = {n: RolloutEngine(coarse(world.dynamics, n), options.threads) for n in substeps_of(world, options)}
    table = {(kind, n): Comparison() for kind in ("random", "held", "policy") for n in engines}
    shape = options.samples, horizon, *world.action_space.shape
    for state, observation in start_states(world, name, actor, options):
        once = rng.uniform(-1, 1, (options.samples, 1, *shape[2:])).astype(np.float32)
        batches = {"random": rng.uniform(-1, 1, shape).astype(np.float32), "held": np.repeat(once, horizon, axis=1)}
        if actor is not None:
            batches["policy"] = exact.follow(state, observation, actor, horizon).actions[None]
        for kind, actions in batches.items():
            _, cpu, truth = rolled_out(exact, state, actions)
            for n, engine in engines.items():
                _, coarse_cpu, found = rolled_out(engine, state, actions)
                table[kind, n].add(truth, found, (cpu, coarse_cpu))
    for engine in (exact, *engines.values()):
        engine.close()
    env.close()
    own = world.dynamics.substeps
    return [
        {"env": name, "actions": kind, "horizon": horizon, "substeps": n, "own_substeps": own, **found.figures(),
         **machine()}
        for (kind, n), found in table.items() if found.errors
    ]  # fmt: skip


def policy_of(name: str, options: CoarseOptions) -> Actor | None:
    """The policy that acts; None where none ships."""
    path = options.checkpoint
    if path is None:
        try:
            path = shipped_model(name)
        except UserError:
            print(f"{name}: no checkpoint ships, so random actions make the episodes", flush=True)
            return None
    return GreedyPolicy(load_model(path, name).policy)


def rolled_out(engine: RolloutEngine, state: np.ndarray, actions: np.ndarray) -> tuple[float, float, Trajectories]:
    """Wall and CPU seconds of a rollout, and where it led."""
    found: list[Trajectories] = []
    seconds = clocked(lambda: found.append(engine.rollout(state, actions)), engine)
    return *seconds, found[0]


def main() -> int:
    """Measure every task, write the rows, print the table."""
    options = read_options(CoarseOptions, "coarse_model")
    print("errors of the achieved goal after the last control step, in the goal's unit")
    print(f"{'task':24s} {'actions':8s} {'H':>3s} {'substeps':>9s} {'speed-up':>9s} {'median':>9s} {'p90':>9s} "
          f"{'max':>9s} {'diverged':>9s}")  # fmt: skip
    for name in [tasks.canonical_name(env) for env in options.env or ENVS]:
        rows = measure(name, options)
        replace_results(RESULTS / "coarse_model.csv", KEY, rows)
        for row in rows:
            steps = f"{row['substeps']}/{row['own_substeps']}"
            print(f"{name:24s} {row['actions']:8s} {row['horizon']:3d} {steps:>9s} {row['speedup_cpu']:8.2f}x "
                  f"{row['error_median']:>9s} {row['error_p90']:>9s} {row['error_max']:>9s} "
                  f"{row['diverged']:4d}/{row['rollouts']}", flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    run_command(main)
