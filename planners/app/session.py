"""One planning session: environment, model, controller, and the episodes they run."""

from __future__ import annotations

import inspect
import time
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any, Protocol

import numpy as np

from mpc.controller import Controller, Plan, Planner, Smoother
from mpc.cost import Cost
from mpc.filters import LowPass
from mpc.motion import action_rate, jerk
from mpc.rollout import Actor, RolloutEngine
from mpc.speed import raw_speed_fraction
from napsp import envs as tasks
from napsp.envs.cards import CARDS
from napsp.envs.check import check_finite
from napsp.envs.coarse import coarse
from napsp.envs.dynamics import Dynamics, get_state
from napsp.envs.lean import lean, refresh
from napsp.errors import UserError
from napsp.policy.greedy import GreedyPolicy
from napsp.policy.greedy_distance import GreedyDistance
from napsp.storage.checkpoint import Model
from napsp.storage.revision import git_revision
from planners.app.episode import EpisodeResult, Step
from planners.app.estimates import load_models, steps_to_go
from planners.app.options import PlanOptions
from planners.cem import CEM
from planners.icem import ICEM
from planners.mppi import MPPI
from planners.predictive_sampling import PredictiveSampling
from planners.smooth import Held

PLANNERS: dict[str, Any] = {
    "mppi": MPPI,
    "cem": CEM,
    "icem": ICEM,
    "predictive_sampling": PredictiveSampling,
    "smooth": Held,
}


class Watcher(Protocol):
    """Looks on while an episode is planned; see :class:`planners.app.video.Video`."""

    def frame(self, observation: dict[str, np.ndarray], plan: Plan) -> None:
        """Called at every control step before the plan's action is executed."""
        ...


class Session:
    """Everything a planning command needs, built from its options."""

    def __init__(
        self,
        planner: str,
        options: PlanOptions,
        env: Any,
        env_name: str,
        controller: Controller,
        models: Sequence[Model] = (),
    ) -> None:
        self.planner, self.options = planner, options
        self.env, self.env_name = env, env_name
        self.controller = controller
        self.model = models[0] if models else None
        self._ensemble = models[1:]
        self.horizon = controller.horizon
        self._statistics = getattr(controller.smoother, "statistics", None)
        self._last_observation: dict[str, np.ndarray] = {}

    @classmethod
    def open(cls, planner: str, options: PlanOptions) -> Session:
        """Build the session.

        Raises:
            UserError: unknown environment, unusable checkpoint, impossible sizes.
        """
        env_name = tasks.canonical_name(options.env)
        models = load_models(options, env_name)
        model = models[0] if models else None
        # Classes of the user's own need not know render modes, so none is named unless one is asked for.
        env = tasks.make(env_name, **({"render_mode": "human"} if options.render == "human" else {}))
        world: Any = env.unwrapped
        if model is not None:
            model.check_sizes(world)
        horizon = options.steps_ahead
        if options.knots is not None and options.knots > horizon:
            raise UserError(f"--knots {options.knots} exceeds the horizon of {horizon} steps; use at most {horizon}")
        _check_goal(options.goal, world)
        cost = Cost(steps_to_go(options, models, world), world.reached, options.where, _action_of(options))
        engine = RolloutEngine(_planned_dynamics(options, world), options.threads)
        n_actions = world.action_space.shape[0]
        controller = Controller(
            engine,
            make_planner(planner, options, options.knots or horizon, n_actions),
            cost,
            horizon,
            np.random.default_rng(options.seed),
            options.knots,
            options.interpolation,
            options.refinements,
            _proposers(options, model, n_actions),
            _smoother(options, engine, cost, model, horizon, n_actions),
        )
        return cls(planner, options, env, env_name, controller, models)

    @property
    def control_period(self) -> float:
        """Seconds of simulated time that one action lasts."""
        world = self.env.unwrapped
        return world.dynamics.substeps * world.model.opt.timestep

    @property
    def substeps(self) -> tuple[int, int]:
        """Physics steps per control step: the environment's, and those of the model planned in."""
        return self.env.unwrapped.dynamics.substeps, self.controller.engine.dynamics.substeps

    def run_episode(self, seed: int, watchers: Sequence[Watcher] = ()) -> EpisodeResult:
        """Plan one full episode; it goes on after the goal is reached, to see whether it holds.

        All chance comes from ``seed``: the episode is the same alone and in a series.

        Raises:
            UserError: the environment observed numbers that are not finite.
        """
        started = time.monotonic()
        observation, _ = self.env.reset(seed=seed)
        check_finite(observation, self.env_name)
        refresh(self.controller.engine.dynamics)
        self.controller.reset(np.random.default_rng([seed, 1]))  # not the stream that the environment draws from
        world = self.env.unwrapped
        if self.options.goal is not None:
            world.goal = np.array(self.options.goal)
            observation["desired_goal"] = world.goal.copy()
        goal = observation["desired_goal"]
        first_hit, success = None, False
        steps: list[Step] = []
        actions: list[np.ndarray] = []
        achieved_goals, positions = [observation["achieved_goal"]], [self._effector(observation)]
        for step in range(tasks.episode_length(self.env_name)):
            plan = self.controller.plan(world, observation)
            for watcher in watchers:
                watcher.frame(observation, plan)
            # Not part of the plan call: a planner that averages its samples never rolls the average out.
            cost = self.controller.cost_of(world, observation, plan.actions)
            actions.append(plan.action)
            observation, *_ = self.env.step(plan.action)
            check_finite(observation, self.env_name)
            success = bool(world.reached(observation["achieved_goal"], observation["desired_goal"]))
            first_hit = step + 1 if success and first_hit is None else first_hit
            steps.append(self._step(observation, plan, cost))
            achieved_goals.append(observation["achieved_goal"])
            positions.append(self._effector(observation))
        self._last_observation = observation
        seconds = time.monotonic() - started
        return EpisodeResult(
            seed, success, first_hit, steps, np.array(actions), np.array(achieved_goals), goal,
            action_rate(np.array(actions)), jerk(np.array(positions), self.control_period), seconds,
        )  # fmt: skip

    def _step(self, observation: dict[str, np.ndarray], plan: Plan, cost: float) -> Step:
        world = self.env.unwrapped
        here, goal = (world.goal_positions(observation[key]) for key in ("achieved_goal", "desired_goal"))
        return Step(
            cost,
            self._to_go(observation, plan),
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

    def _to_go(self, observation: dict[str, np.ndarray], plan: Plan) -> float:
        cost = self.controller.cost
        following = plan.actions[min(1, len(plan.actions) - 1)][None] if cost.action_of == "plan" else None
        rows = observation["observation"][None], observation["achieved_goal"][None]
        return float(cost.to_go(*rows, following, observation["desired_goal"])[0])

    def raw_speed_fraction(self) -> float:
        """Simulated steps per second of a plan call, smoothing left out, over those of a bare ``mujoco.rollout``."""
        world = self.env.unwrapped
        self.controller.smoother = None
        state = get_state(world.model, world.data)
        return raw_speed_fraction(
            self.controller.engine,
            lambda: self.controller.plan_from(state, self._last_observation),
            state,
            self.controller.n_tried,
            max(1, self.controller.cost.simulated_steps(self.horizon)),
        )

    def summary(self) -> dict[str, Any]:
        """What identifies the session, for ``summary.json``."""
        config = {k: str(v) if hasattr(v, "__fspath__") else v for k, v in asdict(self.options).items()}
        config |= {"env": self.env_name, "horizon": self.horizon, "ensemble": [str(p) for p in self.options.ensemble]}
        config["planning_substeps"] = self.substeps[1]
        config["smooth_multiples"] = self.options.roughness_multiples
        config["smooth_choice"] = self.options.roughness_choice
        return {
            "env": self.env_name,
            "planner": self.planner,
            "cost": self.options.cost,
            "seed": self.options.seed,
            "config": config,
            "config_hash": self.options.hash(),
            "revision": git_revision(),
            "checkpoint": self.model.header if self.model else None,
            "ensemble": [member.header for member in self._ensemble],
        }

    def smoothing_summary(self) -> dict[str, Any] | None:
        """Figures of the smoothing layer so far; None without it."""
        return None if self._statistics is None else self._statistics.summary()

    def close(self) -> None:
        """Stop threads and release the environment."""
        self.controller.engine.close()
        self.env.close()


def _proposers(options: PlanOptions, model: Model | None, n_actions: int) -> list[Actor]:
    """Whose own rollouts join the samples."""
    actors: list[Actor] = []
    if model is not None and options.proposals:
        actors.append(GreedyPolicy(model.policy))
    if options.greedy_proposals and model is not None and model.distance is not None:
        actors.append(GreedyDistance(model.distance, n_actions))
    return actors


def make_planner(name: str, options: Any, n_knots: int, n_controls: int) -> Planner:
    """The search algorithm of a command, with the options of the same names."""
    names = {"n_samples": "samples", "n_elites": "elites", "n_refinements": "refinements"}
    planner = PLANNERS[name]
    settings = [p for p in inspect.signature(planner).parameters if p not in ("n_knots", "n_controls")]
    return planner(n_knots, n_controls, **{p: getattr(options, names.get(p, p)) for p in settings})


def _check_goal(goal: tuple[float, ...] | None, env: Any) -> None:
    size = env.observation_space["desired_goal"].shape[0]
    if goal is not None and (len(goal) != size or not np.isfinite(goal).all()):
        raise UserError(f"--goal {' '.join(map(str, goal))} does not fit; give {size} finite numbers")


def _planned_dynamics(options: PlanOptions, world: Any) -> Dynamics:
    """The physics to plan in: the environment's own, less decoration, unless coarse ones are asked for."""
    own, spec = world.dynamics.substeps, getattr(world, "model_spec", None)
    dynamics = lean(world.dynamics, spec, world.action_space.shape[0])
    if options.planning_model == "exact":
        return dynamics
    if own == 1:
        raise UserError(
            f"{options.env} has one physics step per control step, none to leave out; plan in the exact model"
        )
    if (options.planning_substeps or 1) > own:
        raise UserError(
            f"--planning-substeps {options.planning_substeps} exceeds the {own} of {options.env}; use fewer"
        )
    return coarse(dynamics, options.coarse_substeps(own))


def _smoother(
    options: PlanOptions, engine: RolloutEngine, cost: Cost, model: Model | None, horizon: int, n_actions: int
) -> Smoother | None:
    if options.low_pass:
        return LowPass(options.low_pass)
    if not options.smooth or model is None:
        return None
    from mpc.smoothing import layer as smoothing  # imports casadi, which nobody else needs

    names = [field.name for field in fields(smoothing.SmoothingConfig)]
    values: dict[str, Any] = {name: getattr(options, f"smooth_{name}") for name in names}
    values |= {"multiples": options.roughness_multiples, "choice": options.roughness_choice}
    config = smoothing.SmoothingConfig(**values)
    return smoothing.Smoother(engine, cost, model, horizon, n_actions, config)


def _action_of(options: PlanOptions) -> Any:
    if options.action_of == "plan" and options.cost != "distance":
        raise UserError(f"--action-of plan needs --cost distance: {options.cost} does not read actions")
    return options.action_of
