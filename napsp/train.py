"""Algorithm 1 of the paper as one loop: ``python -m napsp.train --env NAME --method ours``."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import numpy as np
import torch
import tyro

from napsp import envs as tasks
from napsp.config import TrainConfig
from napsp.data.collect import ExploringActor, roll
from napsp.data.episodes import Episodes, concatenate
from napsp.data.outcomes import evaluate
from napsp.errors import UserError, run_command
from napsp.learner import Learner
from napsp.policy.greedy import GreedyPolicy
from napsp.presets import preset
from napsp.storage.checkpoint import MODEL_FILE, save_model, sizes_of
from napsp.storage.progress import Progress, Row, read_rows
from napsp.storage.record import RECORD_FILE, write_record
from napsp.storage.resume import STATE_FILE, read_training, restore_training, save_training, warmup_episodes
from napsp.storage.revision import git_revision

EVALUATION_SEED = 10_000_000  # the same evaluation goals for every method and seed


def train(config: TrainConfig, folder: Path, restart: bool = False, tensorboard: bool = False) -> list[Row]:
    """Run Algorithm 1; write ``model.safetensors`` and ``metrics.csv`` into ``folder``.

    A folder that holds an unfinished run with the same settings is continued, unless
    ``restart``. Returns the rows of ``metrics.csv``.
    """
    run = Run.open(config, folder, restart, tensorboard)
    learner = run.learner
    try:
        for iteration in range(run.iteration, run.n_iterations):  # Algorithm 1, line 1
            recent = run.collect(learner.agent.policy)  # 3: D_last
            learner.counts.update(recent)  # 4
            metrics: Row = {}
            if config.learns_distance:
                metrics |= learner.train_temporal(recent)  # 5-8: eq. 4a
                learner.update_target()  # 9
            if config.method == "ours":
                metrics |= learner.train_triangular(recent)  # 10-17: eq. 3, 4b
            metrics |= learner.train_policy()  # 18-21
            learner.extend_buffer(recent)  # 22
            if run.finish_iteration(iteration, metrics):
                break
    finally:
        run.close()
    if not run.interrupted and not (folder / RECORD_FILE).is_file():
        write_record(folder, config, run.progress.rows, run.revisions)
    return run.progress.rows


@dataclass
class Run:
    """The surroundings of the loop: environments, evaluation, checkpoints, interruption."""

    config: TrainConfig
    folder: Path
    envs: list[Any]
    sizes: tuple[int, int, int]
    learner: Learner
    iteration: int
    progress: Progress
    seconds_before: float
    started: float
    revisions: list[str]
    interrupted: bool = False
    _previous_handler: Any = signal.SIG_DFL
    _previous_precision: str = "highest"

    @classmethod
    def open(cls, config: TrainConfig, folder: Path, restart: bool, tensorboard: bool) -> Run:
        """Start a run in ``folder`` or continue the one it holds."""
        git_revision()  # now, not when the first checkpoint is written
        envs = [tasks.make(config.env) for _ in range(config.episodes_per_iteration)]
        state = folder / STATE_FILE
        if restart:
            for name in (STATE_FILE, MODEL_FILE, RECORD_FILE, "metrics.csv"):
                (folder / name).unlink(missing_ok=True)
        saved = read_training(state, config) if state.is_file() else None
        if saved and saved[0]["buffer.observations"].shape[-1] != sizes_of(envs[0])[0]:
            raise UserError(f"{folder} holds a run of another version of {config.env}; --restart begins anew")
        learner = new_learner(config, envs, warmup_episodes(saved[0], config) if saved else None)
        iteration, rows, seconds, revisions = 0, [], 0.0, [git_revision()]
        if saved:
            iteration = restore_training(learner, *saved)
            rows = read_rows(folder / "metrics.csv", len(learner.buffer))
            seconds = saved[1]["seconds"]
            revisions = list(dict.fromkeys([*saved[1]["revisions"], *revisions]))
            print(f"continuing {folder} at episode {len(learner.buffer)}")
        folder.mkdir(parents=True, exist_ok=True)
        progress = Progress(folder, rows, tensorboard)
        run = cls(
            config, folder, envs, sizes_of(envs[0]), learner, iteration, progress, seconds, time.monotonic(), revisions
        )
        if iteration < run.n_iterations:
            (folder / RECORD_FILE).unlink(missing_ok=True)  # it belongs to a shorter run
        run._previous_handler = signal.signal(signal.SIGINT, run._interrupt)
        run._previous_precision = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(config.matmul_precision)
        return run

    @property
    def n_iterations(self) -> int:
        """Iterations of Algorithm 1, I."""
        n_warmup = _round_up(self.config.n_warmup_episodes, self.config.episodes_per_iteration)
        return max(0, -(-(self.config.n_episodes - n_warmup) // self.config.episodes_per_iteration))

    def collect(self, policy: Any) -> Episodes:
        """Algorithm 1, line 3: roll the exploring policy once in every environment."""
        config, learner = self.config, self.learner
        actor = ExploringActor(
            policy, self.sizes[1], config.epsilon, config.exploration_hold, learner.rng, learner.generator
        )
        seeds = [int(seed) for seed in learner.rng.integers(EVALUATION_SEED, size=len(self.envs))]
        return roll(self.envs, actor, seeds, config.horizon, _starts(config, len(self.envs), learner.rng))

    def finish_iteration(self, iteration: int, metrics: Row) -> bool:
        """Evaluate and save when due; return True to stop."""
        config, done = self.config, len(self.learner.buffer)
        seconds = self.seconds_before + time.monotonic() - self.started
        session = (time.monotonic() - self.started) / max(1, iteration + 1 - self.iteration)
        seconds_left = session * (self.n_iterations - iteration - 1)
        self.progress.tick(done, config.n_episodes, seconds_left)
        last = iteration == self.n_iterations - 1
        due = done // config.evaluate_every > (done - config.episodes_per_iteration) // config.evaluate_every
        if due or last:
            timing = {"seconds": seconds, "steps_per_second": done * config.horizon / seconds}
            self.progress.report(
                {"episodes": float(done), **self._evaluate(), **metrics, **timing, "minutes_left": seconds_left / 60}
            )
        if due or last or self.interrupted:
            self._save(iteration + 1, seconds)
        return self.interrupted

    def _evaluate(self) -> Row:
        config, policy = self.config, self.learner.agent.policy
        seeds = [EVALUATION_SEED + i for i in range(config.n_evaluation_episodes)]
        result, episodes = evaluate(self.envs, GreedyPolicy(policy), seeds, config.horizon)
        row = {
            "success_rate": result.success_rate,
            "any_success_rate": result.any_success_rate,
            "mean_gap": float(result.gaps[:, -1].mean()),
            "max_reward": float(-result.gaps.min(1).mean()),  # the paper's: least distance to the goal, negated
        }
        at_goal = result.reached[:, -1]
        if config.learns_distance and at_goal.any():
            last = torch.from_numpy(episodes.observations[at_goal, -1])
            goals = torch.from_numpy(episodes.desired_goals[at_goal])
            with torch.inference_mode():
                steps = self.learner.regression.trusted.steps(last, policy.mode(last, goals), goals)
            row["distance_at_goal"] = float(steps.mean())
        return row

    def _save(self, iteration: int, seconds: float) -> None:
        learner = self.learner
        save_training(self.folder / STATE_FILE, learner, iteration, seconds, self.revisions)
        distance = learner.regression.trusted if self.config.learns_distance else None
        visits = learner.counts.visit_table if self.config.learns_distance else None  # what it is uncertain of
        save_model(
            self.folder / MODEL_FILE,
            learner.agent.policy,
            distance,
            self.config,
            self.sizes,
            len(learner.buffer),
            visits,
        )

    def _interrupt(self, signum: int, frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True
        print("\nfinishing this iteration and saving; press Ctrl-C again to stop at once", flush=True)

    def close(self) -> None:
        """Release environments; say how to go on after an interruption."""
        signal.signal(signal.SIGINT, self._previous_handler)
        torch.set_float32_matmul_precision(self._previous_precision)
        self.progress.close()
        for env in self.envs:
            env.close()
        if self.interrupted:
            print(f"saved in {self.folder}; the same command continues it")


def new_learner(config: TrainConfig, envs: list[Any], warmup: Episodes | None = None) -> Learner:
    """The learner before iteration 0; collects the warm-up episodes unless they are given."""
    torch.manual_seed(config.seed)  # initial weights
    rng, generator = np.random.default_rng(config.seed), torch.Generator().manual_seed(config.seed)
    if config.held_starts and not getattr(envs[0].unwrapped, "grasps", False):
        raise UserError(f"{config.env} has no box to hold; use --held-starts 0")
    if warmup is None:
        warmup = _warm_up(envs, config, rng, generator)
    return Learner(config, sizes_of(envs[0]), warmup, _sparse_reward(envs[0]), rng, generator)


def _warm_up(envs: list[Any], config: TrainConfig, rng: np.random.Generator, generator: torch.Generator) -> Episodes:
    """Random episodes that seed D: line 22 comes last, so iteration 0 would find D empty."""
    parts = []
    for _ in range(_round_up(config.n_warmup_episodes, len(envs)) // len(envs)):
        actor = ExploringActor(None, envs[0].action_space.shape[0], 1.0, config.exploration_hold, rng, generator)
        seeds = [int(seed) for seed in rng.integers(EVALUATION_SEED, size=len(envs))]
        parts.append(roll(envs, actor, seeds, config.horizon, _starts(config, len(envs), rng)))
    return concatenate(parts)


def _starts(config: TrainConfig, n: int, rng: np.random.Generator) -> list[dict[str, bool]] | None:
    """Reset options of n training episodes."""
    return [{"box_held": bool(held)} for held in rng.random(n) < config.held_starts] if config.held_starts else None


def _sparse_reward(env: Any) -> Any:
    return lambda achieved, goals: np.asarray(env.unwrapped.compute_reward(achieved, goals, {}), np.float32)


def _round_up(n: int, multiple: int) -> int:
    return -(-n // multiple) * multiple


@dataclass(frozen=True)
class Options:
    """Where a run lives and how it is shown."""

    out: Path | None = None
    """Folder of the run; default runs/ENV-METHOD-sSEED."""
    restart: bool = False
    """Overwrite the run in that folder instead of continuing it."""
    tensorboard: bool = False
    """Write TensorBoard event files as well (needs the tensorboard extra)."""
    threads: int = 1
    """CPU threads; two single-threaded runs finish sooner than one with two threads."""


def parse(arguments: list[str]) -> tuple[TrainConfig, Options]:
    """Read the command line; the defaults depend on ``--env`` and ``--method``."""
    chosen = {"env": "fetch_wall", "method": "ours"}
    for flag, following in zip(arguments, [*arguments[1:], ""], strict=True):
        name, joined, value = flag.removeprefix("--").partition("=")
        if flag.startswith("--") and name in chosen:
            chosen[name] = value if joined else following
    default = preset(**chosen)

    def both(
        config: Annotated[TrainConfig, tyro.conf.arg(name="")] = default,
        options: Annotated[Options, tyro.conf.arg(name="")] = Options(),
    ) -> tuple[TrainConfig, Options]:
        """Train a distance and a policy (Algorithm 1)."""
        return config, options

    return tyro.cli(both, args=arguments, prog="python -m napsp.train")


def main() -> int:
    """Run the command."""
    config, options = parse(sys.argv[1:])
    folder = options.out or Path("runs") / f"{tasks.file_name(config.env)}-{config.method}-s{config.seed}"
    print(f"{config.env}: {config.method}, seed {config.seed}, {config.n_episodes} episodes -> {folder}")
    if options.threads < 1:
        raise UserError(f"--threads is {options.threads}; it must be at least 1")
    torch.set_num_threads(options.threads)
    train(config, folder, options.restart, options.tensorboard)
    return 0 if (folder / RECORD_FILE).is_file() else 130


if __name__ == "__main__":
    run_command(main)
