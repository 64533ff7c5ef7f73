"""The surroundings of Algorithm 1: environments, evaluation, saving, interruption, resuming."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from napsp.config import TrainConfig, to_dict
from napsp.data.collect import Actor, ExplorationConfig, ExploringActor, roll
from napsp.data.episodes import Episodes, concatenate
from napsp.data.explorers import Explorers
from napsp.data.outcomes import evaluate
from napsp.distance.graph import explained
from napsp.envs.actions import used_actions
from napsp.envs.gap import goal_gap
from napsp.envs.goal_check import check_resolution
from napsp.envs.goal_task import is_goal_task, make_goal_task, own_box
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.interruption import Interruption, says_no
from napsp.learner import Learner
from napsp.parts import build_learner
from napsp.policy.greedy import GreedyPolicy
from napsp.settings import as_flags
from napsp.storage.checkpoint import save_model, sizes_of
from napsp.storage.files import sound
from napsp.storage.progress import Progress, Row, read_rows
from napsp.storage.record import CURVE_FILE, RECORD_FILE, write_record
from napsp.storage.resume import FIX, begun, explorers_of, read_training, restore_training, warmup_episodes
from napsp.storage.revision import git_revision
from napsp.storage.segments import remove_segments
from napsp.storage.shipped import MODEL_FILE
from napsp.storage.state import STATE_FILE, TrainingState, warmup_of
from napsp.storage.trackers import forget, open_trackers, require

EVALUATION_SEED = 10_000_000  # the same evaluation goals for every method and seed


@dataclass
class Run:
    """The surroundings of the loop: environments, evaluation, checkpoints, interruption."""

    config: TrainConfig
    execution: Execution
    folder: Path
    envs: list[Any]
    sizes: tuple[int, int, int]
    learner: Learner
    state: TrainingState
    iteration: int
    progress: Progress
    seconds_before: float
    started: float
    revisions: list[str]
    explorers: Explorers | None
    interruption: Interruption
    on_evaluation: Callable[[Row], Any] | None = None
    _previous_precision: str = "highest"
    _saved_at: int = -1

    @classmethod
    def open(
        cls, config: TrainConfig, folder: Path, restart: bool, trackers: Sequence[str], execution: Execution
    ) -> Run:
        """Start a run in ``folder`` or continue the one it holds; ``trackers`` are names of ``TRACKERS``."""
        require(trackers)
        git_revision()  # now, not when the first checkpoint is written
        envs = [make_goal_task(config.env, config.reached) for _ in range(config.episodes_per_iteration)]
        path = folder / STATE_FILE
        saved = read_training(path, config) if path.is_file() and not restart else None
        if saved and saved[1]["inherited"]:
            config = begun(config, saved[1])
            print(f"this run began before an option existed and goes on as it was: {as_flags(saved[1]['inherited'])}")
        if saved and list(sizes_of(envs[0])) != saved[1]["sizes"]:
            raise UserError(f"{folder} holds a run of another version of {config.env}; --restart begins anew")
        if not saved and not restart and (folder / MODEL_FILE).is_file():
            raise UserError(
                f"{folder} holds a model and not the state of its training, so it cannot be continued; choose another "
                "--out, or --restart to overwrite it"
            )
        warmup = warmup_episodes(folder, saved, config) if saved else None
        learner = new_learner(config, envs, warmup, execution)
        if restart:  # not before all settings have proved possible
            for name in (STATE_FILE, MODEL_FILE, RECORD_FILE, CURVE_FILE, "metrics.csv"):
                (folder / name).unlink(missing_ok=True)
            remove_segments(folder)
            forget(folder)
        iteration, rows, seconds, revisions = 0, [], 0.0, [git_revision()]
        if saved:
            iteration = restore_training(folder, learner, saved)
            rows = read_rows(folder / "metrics.csv", learner.buffer.n_seen)
            seconds = saved[1]["seconds"]
            revisions = list(dict.fromkeys([*saved[1]["revisions"], *revisions]))
            if iteration > config.n_iterations:
                raise UserError(f"{folder} has {learner.buffer.n_seen} episodes already; ask for as many with "
                                "--n-episodes, or choose another --out")  # fmt: skip
            print(f"continuing {folder} at episode {learner.buffer.n_seen}")
        explorers = None
        if config.jointly and config.graph.every and learner.graph is None:
            share = explained(warmup_of(learner))
            print(f"actions explain {share:.2f} of how the achieved goal changes: neither graph nor explorers below "
                  f"{config.graph.control:g} (--graph.control 0 forces them)")  # fmt: skip
        if config.explore.explorers and learner.graph is not None:
            explorers = Explorers.of(config)
            if saved:
                with sound(path, FIX):
                    explorers.restore(explorers_of(saved[0], len(explorers.worlds)))
        folder.mkdir(parents=True, exist_ok=True)
        unit = goal_gap(envs[0].unwrapped, np.zeros(1))[1]
        seeing = open_trackers(trackers, folder, to_dict(config), bool(rows))
        progress = Progress(folder, rows, seeing, config.method, unit)
        run = cls(
            config,
            execution,
            folder,
            envs,
            sizes_of(envs[0]),
            learner,
            TrainingState(folder, saved),
            iteration,
            progress,
            seconds,
            time.monotonic(),
            revisions,
            explorers,
            Interruption(),
        )
        if iteration < config.n_iterations:
            for name in (RECORD_FILE, CURVE_FILE):  # they belong to a shorter run
                (folder / name).unlink(missing_ok=True)
        run._saved_at = learner.buffer.n_seen if saved else -1
        run._previous_precision = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(config.matmul_precision)
        return run

    def collect(self, policy: Any) -> Episodes:
        """Algorithm 1, line 3: roll the exploring policy once in every environment."""
        config, learner = self.config, self.learner
        actor: Actor = ExploringActor(policy, self.sizes[1], config.explore, learner.rng, learner.generator)
        seeds = [int(seed) for seed in learner.rng.integers(EVALUATION_SEED, size=len(self.envs))]
        starts = _starts(config.explore, len(self.envs), learner.rng)
        envs = self.envs
        if self.explorers is not None:
            envs, actor = self.explorers.join(envs, actor, learner)
        return roll(envs, actor, seeds, config.episode_length, starts)

    def finish_iteration(self, iteration: int, metrics: Row) -> bool:
        """Evaluate and save when due; return True to stop."""
        config, done = self.config, self.learner.buffer.n_seen
        seconds = self.seconds_before + time.monotonic() - self.started
        session = (time.monotonic() - self.started) / max(1, iteration + 1 - self.iteration)
        seconds_left = session * (config.n_iterations - iteration - 1)
        self.progress.tick(done, config.n_episodes, seconds_left)
        last = iteration == config.n_iterations - 1
        due = done // config.evaluate.every > (done - config.episodes_per_iteration) // config.evaluate.every
        if due or last:
            self._report(metrics, seconds, seconds_left)
        if due or last or self.interrupted:
            self._save(iteration + 1, seconds)
        return self.interrupted

    def _report(self, metrics: Row, seconds: float, seconds_left: float) -> None:
        """Evaluate, and write a row."""
        timing = {"seconds": seconds, "steps_per_second": self.learner.buffer.n_steps / seconds}
        timing |= {"minutes_left": seconds_left / 60}
        done = float(self.learner.buffer.n_seen)
        row: Row = {"episodes": done, **self._evaluate(), **metrics, **self._blow_ups(), **timing}
        self.progress.report(row)
        if self.on_evaluation is not None and says_no(self.on_evaluation(row)):
            self.interruption.asked = True

    def _evaluate(self) -> Row:
        config, actor = self.config, GreedyPolicy(self.learner.agent.trusted)
        seeds = [EVALUATION_SEED + i for i in range(config.evaluate.n_episodes)]
        result, episodes = evaluate(self.envs, actor, seeds, config.episode_length)
        row = {
            "success_rate": result.success_rate,
            "any_success_rate": result.any_success_rate,
            "mean_gap": float(result.gaps[:, -1].mean()),
            **self._degrees(result.gaps[:, -1]),
            "max_reward": float(-result.gaps.min(1).mean()),  # the paper's: least distance to the goal, negated
        }
        at_goal = result.reached[:, -1]
        if config.learns_distance and at_goal.any():
            last, goals = episodes.observations[at_goal, -1], episodes.desired_goals[at_goal]
            distance = self.learner.distance
            row["distance_at_goal"] = float(distance.steps(distance.rows(last, actor(last, goals), goals)).mean())
        return row

    def _degrees(self, gaps: np.ndarray) -> Row:
        """The gaps ``(E,)`` where goals are angles."""
        shown, unit = goal_gap(self.envs[0].unwrapped, gaps)
        return {"mean_degrees": float(shown.mean())} if unit == "deg" else {}

    def _blow_ups(self) -> Row:
        """How many of the episodes so far ended because the simulation blew up, if any did; also said."""
        n = self.learner.buffer.n_blown
        if not n:
            return {}
        print(f"the simulation blew up in {n} of {self.learner.buffer.n_seen} episodes, which end before", flush=True)
        return {"blow_ups": float(n)}

    def _save(self, iteration: int, seconds: float) -> None:
        places = self.explorers.states() if self.explorers else []
        self.state.save(self.learner, iteration, seconds, self.revisions, places)
        self._saved_at = self.learner.buffer.n_seen
        self._save_model()

    def _save_model(self) -> None:
        learner = self.learner
        distance, visits = None, None
        if self.config.learns_distance:
            distance, visits = learner.distance.trusted, learner.counts.visit_counts
        path, episodes = self.folder / MODEL_FILE, learner.buffer.n_seen
        save_model(
            path, learner.agent.trusted, distance, self.config, self.sizes, episodes, visits, own_box(self.envs[0])
        )

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C asked for an end."""
        return self.interruption.asked

    def close(self) -> None:
        """Release environments; say how to go on after an interruption."""
        self.interruption.close()
        torch.set_float32_matmul_precision(self._previous_precision)
        self.progress.close()
        for env in [*self.envs, *(self.explorers.worlds if self.explorers else [])]:
            env.close()
        if self.interrupted and not (self.folder / RECORD_FILE).is_file():
            done = self.learner.buffer.n_seen
            print(f"saved in {self.folder}; the same command continues it" if self._saved_at == done else
                  f"what came last was not saved; {how_it_goes_on(self.folder)}")  # fmt: skip

    def record(self) -> None:
        """Write what describes the finished run, once."""
        if self.interrupted or (self.folder / RECORD_FILE).is_file():
            return
        config, done, rows = self.config, self.learner.buffer.n_seen, self.progress.rows
        if not rows and done // config.evaluate.every > config.n_warmup // config.evaluate.every:
            raise UserError(f"{self.folder} has lost the metrics.csv of its finished run; begin anew with --restart")
        if not rows or rows[-1]["episodes"] < done:  # it was interrupted, and ends where it was
            self._report({}, self.seconds_before, 0.0)
        self._save_model()  # a kill after the last state may have left the one before
        write_record(self.folder, self.config, self.progress.rows, self.revisions)


def how_it_goes_on(folder: Path) -> str:
    """What the same command would do, in words."""
    return f"the same command {'continues from the last save' if (folder / STATE_FILE).is_file() else 'begins anew'}"


def new_learner(
    config: TrainConfig, envs: list[Any], warmup: Episodes | None = None, execution: Execution | None = None
) -> Learner:
    """The learner before iteration 0; collects the warm-up episodes unless they are given."""
    rng, generator = np.random.default_rng(config.seed), torch.Generator().manual_seed(config.seed)
    check_resolution(envs[0], config.env, envs[0].reset(seed=config.seed)[0])
    if config.explore.held_starts and not getattr(envs[0].unwrapped, "grasps", False):
        raise UserError(f"{config.env} has no box to hold; use --explore.held-starts 0")
    if warmup is None:
        warmup = warm_up(envs, config, rng, generator)
        if not warmup.n_steps:
            raise UserError(f"no episode of {config.env} lasts a step: its simulation blows up; correct its dynamics")
    envs[0].reset(seed=config.seed)
    used = None if is_goal_task(envs[0]) else used_actions(envs[0].unwrapped)
    with torch.random.fork_rng(devices=[]):  # the caller's own numbers stay as they were
        torch.default_generator.manual_seed(config.seed)  # initial weights
        return build_learner(config, sizes_of(envs[0]), warmup, sparse_reward(envs[0]), rng, generator, execution, used)


def warm_up(envs: list[Any], config: TrainConfig, rng: np.random.Generator, generator: torch.Generator) -> Episodes:
    """Random episodes that seed D: line 22 comes last, so iteration 0 would find D empty."""
    parts = []
    n_actions, n = envs[0].action_space.shape[0], len(envs)
    for _ in range(-(-config.n_warmup_episodes // n)):
        actor = ExploringActor(None, n_actions, config.explore, rng, generator)
        seeds = [int(seed) for seed in rng.integers(EVALUATION_SEED, size=n)]
        parts.append(roll(envs, actor, seeds, config.episode_length, _starts(config.explore, n, rng)))
    return concatenate(parts)


def _starts(config: ExplorationConfig, n: int, rng: np.random.Generator) -> list[dict[str, bool]] | None:
    """Reset options of n training episodes."""
    return [{"box_held": bool(held)} for held in rng.random(n) < config.held_starts] if config.held_starts else None


def sparse_reward(env: Any) -> Any:
    """The task's own reward, for achieved goals and goals ``(n, G)``: 0 where reached, else -1 ``(n,)``."""
    compute_reward = env.get_wrapper_attr("compute_reward")
    return lambda achieved, goals: np.asarray(compute_reward(achieved, goals, {}), np.float32)
