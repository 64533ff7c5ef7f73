"""One planning session: environment, model, controller, and the episodes they run."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from mpc.controller import Controller, Plan
from mpc.motion import action_rate, jerk
from mpc.verify import Verified
from mpc.workers import CAN_FORK
from napsp import envs as tasks
from napsp.envs.attempts import check_finite
from napsp.envs.blowups import BlowUpDetector
from napsp.envs.cards import CARDS
from napsp.errors import UserError
from napsp.storage.checkpoint import Model
from planners.app.build import build_controller
from planners.app.config import PlanConfig
from planners.app.episode import EpisodeResult, Step
from planners.app.estimates import load_models, success_test_of
from planners.app.frames import draws_itself
from planners.app.options import RunOptions
from planners.app.world import check_goal, verify_task


class Watcher(Protocol):
    """Looks on while an episode is planned; see :class:`planners.app.video.Video`."""

    def frame(self, observation: dict[str, np.ndarray], plan: Plan) -> None:
        """Called at every control step before the plan's action is executed."""
        ...


class Session:
    """Everything a planning command needs, built from its configuration.

    Attributes:
        config: how plans are made, with the task's values.
        run: the circumstances.
        models: the checkpoint's, then those of the ensemble; none for a cost that needs no distance.
        verified: what was tried of a task that does not ship; None of one that does, and of a coarse model.
    """

    def __init__(
        self,
        config: PlanConfig[Any],
        run: RunOptions,
        env: Any,
        controller: Controller,
        models: Sequence[Model] = (),
        verified: Verified | None = None,
    ) -> None:
        self.config, self.run, self.models, self.verified = config, run, models, verified
        self.env, self.env_name = env, config.env
        self.controller = controller
        self.horizon = controller.horizon

    @classmethod
    def open(cls, config: PlanConfig[Any], run: RunOptions | None = None) -> Session:
        """Build the session.

        Raises:
            UserError: unknown environment, unusable checkpoint, impossible sizes.
        """
        config, run = config.resolved(), run or RunOptions()
        models = load_models(config, run.checkpoint)
        reached = success_test_of(config, models)
        # Classes of the user's own need not know render modes, so none is named unless one is asked for.
        env = tasks.make(config.env, reached, **({"render_mode": "human"} if run.render == "human" else {}))
        if run.video and run.render == "none" and draws_itself(env):
            env.close()
            env = tasks.make(config.env, reached, render_mode="rgb_array")
        try:
            tried = config.env not in CARDS and config.model.kind == "exact"
            verified = verify_task(config, run, reached) if tried else None
            controller = build_controller(config, run, models, env.unwrapped, verified.forks if verified else CAN_FORK)
        except BaseException:
            env.close()
            raise
        return cls(config, run, env, controller, models, verified)

    @property
    def model(self) -> Model | None:
        """The checkpoint's; None for a cost that needs no distance."""
        return self.models[0] if self.models else None

    @property
    def control_period(self) -> float | None:
        """Seconds of simulated time that one action lasts; None where nobody knows."""
        world = self.env.unwrapped
        if world.model is None:
            frames = world.metadata.get("render_fps")
            return 1.0 / frames if frames else None
        return world.dynamics.substeps * world.model.opt.timestep

    @property
    def substeps(self) -> tuple[int, int]:
        """Physics steps per control step: the environment's, and those of the model planned in."""
        return self.env.unwrapped.dynamics.substeps, self.controller.engine.dynamics.substeps

    def run_episode(
        self,
        seed: int,
        watchers: Sequence[Watcher] = (),
        options: dict[str, Any] | None = None,
        hold: int | None = None,
    ) -> EpisodeResult:
        """Plan one episode; it goes on after the goal is reached, to see whether it holds, unless the task ends it.

        With ``hold`` it ends once the goal was held for so many control steps in succession.

        An episode in which the environment blows up ends there, is no success, and is warned of.

        All chance comes from ``seed``: the episode is the same alone and in a series. ``options`` are the reset's.

        Raises:
            UserError: the environment observed numbers that are not finite after its reset, blew up at once, or does
                not keep to its goal.
        """
        started = time.monotonic()
        observation = self.begin(seed, options)
        world = self.env.unwrapped
        goal = observation["desired_goal"]
        first_hit, success, held = None, False, 0
        steps: list[Step] = []
        actions: list[np.ndarray] = []
        achieved_goals, positions = [observation["achieved_goal"]], [self._effector(observation)]
        detector = BlowUpDetector(self.env)
        detector.begin()
        for step in range(tasks.episode_length(self.env_name)):
            plan = self.controller.plan(world, observation)
            for watcher in watchers:
                watcher.frame(observation, plan)
            # Not part of the plan call: a planner that averages its samples never rolls the average out.
            cost = self.controller.cost_of(world, observation, plan.actions)
            found, _, terminated, truncated, _ = self.env.step(plan.action)
            if detector.blew_up(found, terminated or truncated):
                success = False
                self._tell_of_blow_up(step)
                break
            observation = _copied(found)
            actions.append(plan.action)
            if self.config.goal is not None and not np.allclose(observation["desired_goal"], self.config.goal):
                raise UserError(f"{self.env_name} does not keep to --goal; let step observe the attribute goal")
            success = bool(world.reached(observation["achieved_goal"], observation["desired_goal"]))
            first_hit = step + 1 if success and first_hit is None else first_hit
            held = held + 1 if success else 0
            steps.append(self.record(observation, plan, cost))
            achieved_goals.append(observation["achieved_goal"])
            positions.append(self._effector(observation))
            if terminated or truncated or held == hold:
                break
        seconds = time.monotonic() - started
        return EpisodeResult(
            seed, success, first_hit, steps, np.array(actions), np.array(achieved_goals), goal,
            action_rate(np.array(actions)), jerk(np.array(positions), self.control_period or 1.0), seconds,
        )  # fmt: skip

    def _tell_of_blow_up(self, n_steps: int) -> None:
        if not n_steps:
            raise UserError(f"the simulation of {self.env_name} blows up in its first step; correct its dynamics")
        text = f"the simulation of {self.env_name} blew up after {n_steps} steps; the episode ends there, as a failure"
        warnings.warn(text, RuntimeWarning, stacklevel=3)

    def begin(self, seed: int, options: dict[str, Any] | None = None) -> dict[str, np.ndarray]:
        """Start an episode; return its first observation. ``options`` are the reset's.

        Raises:
            UserError: the environment observed numbers that are not finite.
        """
        observation = _copied(self.env.reset(seed=seed, options=options)[0])
        check_finite(observation, self.env_name)
        self.controller.reset(np.random.default_rng([seed, 1]))  # not the stream that the environment draws from
        if self.config.goal is not None:
            self.set_goal(observation, np.array(self.config.goal))
        return observation

    def set_goal(self, observation: dict[str, np.ndarray], goal: np.ndarray) -> None:
        """Make ``goal`` ``(G,)`` the episode's from here on, and that of the last ``observation``.

        Raises:
            UserError: as :func:`planners.app.world.check_goal`.
        """
        check_goal(tuple(goal.tolist()), self.env.unwrapped)
        self.env.unwrapped.goal = goal.copy()
        observation["desired_goal"] = goal.copy()

    def record(self, observation: dict[str, np.ndarray], plan: Plan, cost: float, late: int = 0) -> Step:
        """Figures of a control step: the ``observation`` that it led to, its plan, and what that one costs alone.

        ``late`` is how many control steps before this one the plan was made for.
        """
        world = self.env.unwrapped
        here, goal = (world.goal_positions(observation[key]) for key in ("achieved_goal", "desired_goal"))
        return Step(
            cost,
            self._to_go(observation, plan, late + 1),
            plan.effective_samples,
            plan.effective_samples / len(plan.costs),
            plan.milliseconds,
            plan.smoothing_ms,
            float(np.linalg.norm(here - goal)),
        )

    def _effector(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        # Of Fetch, stock or not, the grip's position comes first.
        unknown = 3 if self.env_name.lower().startswith("fetch") else 0
        n = CARDS[self.env_name].n_effector if self.env_name in CARDS else unknown
        if n:
            return observation["observation"][:n]
        # Of other tasks nothing is known but that the goal is about what they move.
        return self.env.unwrapped.goal_positions(observation["achieved_goal"])

    def _to_go(self, observation: dict[str, np.ndarray], plan: Plan, number: int) -> float:
        """Steps to go where the plan's next action, at ``number``, is due."""
        cost = self.controller.cost
        following = plan.actions[min(number, len(plan.actions) - 1)][None] if cost.action_of == "plan" else None
        rows = observation["observation"][None], observation["achieved_goal"][None]
        return float(cost.to_go(*rows, following, observation["desired_goal"])[0])

    def smoothing_summary(self) -> dict[str, Any] | None:
        """Figures of the smoothing layer so far; None without it."""
        statistics = getattr(self.controller.smoother, "statistics", None)
        return None if statistics is None else statistics.summary()

    def close(self) -> None:
        """Stop threads and release the environment."""
        self.controller.engine.close()
        self.env.close()


def _copied(observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """An observation that the environment's next step does not overwrite."""
    return {key: np.array(values) for key, values in observation.items()}
