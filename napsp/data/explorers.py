"""Episodes that go on where the last one ended, to see what a task's own starts never show. Beyond the paper."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import gymnasium
import numpy as np

from napsp import envs as tasks
from napsp.config import TrainConfig
from napsp.data.collect import Actor, ExplorationConfig, ExploringActor
from napsp.envs.blowups import BlowUpDetector
from napsp.envs.goal_task import make_goal_task
from napsp.envs.state import get_state, put_state
from napsp.learner import Learner

ROLES = ("walk", "seek")
"""walk: random actions, held for a while. seek: the policy, towards a goal of a random cell, then a random walk."""


def exact(share: float) -> Fraction:
    """A share as it was written: 0.7 of 90 are 63, and not the 62.99 of floating point."""
    return Fraction(str(float(share)))


class Ongoing(gymnasium.Wrapper):
    """An environment whose episodes begin where the last one was cut by its time limit, with a goal of our choice.

    Now and then one begins with a reset, and always after an end by the environment itself or a blow-up. Rewards are
    worked out anew from the goals that are stored, so the environment itself need not know.

    Args:
        env: a task; one whose state is not MuJoCo's begins with a reset after :meth:`restore`.
        anew: episodes from one reset to the next.
    """

    def __init__(self, env: gymnasium.Env, anew: int) -> None:
        super().__init__(env)
        self._anew, self._n_episodes, self._n_steps, self._detector = anew, 0, 0, BlowUpDetector(env)
        self._counts = False
        self.last: dict[str, Any] | None = None
        self.goal: np.ndarray | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Go on, or begin anew."""
        begins = self.last is None or self._n_episodes % self._anew == 0
        last: Any = self.env.reset(seed=seed, options=options)[0] if begins else self.last
        self._n_episodes += 1
        self._n_steps = 0
        self._detector.begin()
        for limit in self._time_limits():
            limit._elapsed_steps = 0  # its episode begins as well
        self.last = last if self.goal is None else {**last, "desired_goal": self.goal}
        return self.last, {}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Advance one control step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._n_steps += 1
        late = any(limit._elapsed_steps >= limit._max_episode_steps for limit in self._time_limits())
        # A first step that is the last: the environment counts its steps itself, and has none left to go on with.
        self._counts |= truncated and self._n_steps == 1
        over = terminated or (truncated and (self._counts or not late))
        self.last = None if self._detector.blew_up(observation, over) or over else observation
        if terminated and self.goal is not None and self._arrived(observation):
            terminated, truncated = False, True  # at a goal that is not ours: our way was cut there, not lost
        return observation, reward, terminated, truncated, info

    def _arrived(self, observation: dict[str, Any]) -> bool:
        """Whether the environment is at the goal that it knows of."""
        reached = self.env.get_wrapper_attr("reached")
        return bool(reached(observation["achieved_goal"], observation["desired_goal"]))

    def _time_limits(self) -> list[Any]:
        env, found = self.env, []
        while isinstance(env, gymnasium.Wrapper):
            found += [env] if isinstance(env, gymnasium.wrappers.TimeLimit) else []
            env = env.env
        return found

    def state(self) -> dict[str, np.ndarray]:
        """What :meth:`restore` needs to go on elsewhere."""
        world: Any = self.env.unwrapped
        count = {"n_episodes": np.array(self._n_episodes)}
        if self.last is None or tasks.lacks(world):
            return count
        return {**count, "physics": get_state(world.model, world.data), **self.last}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on where another one was."""
        self._n_episodes = int(state["n_episodes"])
        if "physics" not in state:
            return
        world: Any = self.env.unwrapped
        self.env.reset(seed=0)
        put_state(world.dynamics.bind(world.data), world.model, world.data, state["physics"])
        self.last = {name: value for name, value in state.items() if name not in ("n_episodes", "physics")}
        if getattr(getattr(world, "goal", None), "shape", None) == self.last["desired_goal"].shape:
            world.goal = self.last["desired_goal"].copy()  # the task's own, as its reset had drawn it


class RoleActor:
    """Lets some environments walk at random: ``walk`` all the time, ``seek`` from half of the episode on."""

    def __init__(self, policy: Actor, walk: Actor, roles: list[str], length: int) -> None:
        self._policy, self._walk, self._roles, self._length = policy, walk, np.array(roles), length
        self._t = 0

    def __call__(self, observations: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Actions ``(E, A)``."""
        walking = (self._roles == "walk") | ((self._roles == "seek") & (self._t >= self._length // 2))
        self._t += 1
        return np.where(walking[:, None], self._walk(observations, goals), self._policy(observations, goals))


class Explorers:
    """Takes the place of some of the environments of an iteration; every other one walks, every other one seeks.

    Args:
        worlds: the environments.
        config: how many, and how random actions are drawn.
        length: T.
    """

    def __init__(self, worlds: list[Ongoing], config: ExplorationConfig, length: int) -> None:
        self.worlds, self._config, self._length = worlds, config, length
        self._walking = replace(config, hold=config.walk_hold or config.hold)

    @classmethod
    def of(cls, config: TrainConfig) -> Explorers:
        """As a configuration describes them, at least one of each role."""
        explore, n = config.explore, math.ceil(exact(config.explore.explorers) * config.episodes_per_iteration)
        worlds = [Ongoing(make_goal_task(config.env, config.reached), explore.anew) for _ in range(max(n, len(ROLES)))]
        return cls(worlds, explore, config.episode_length)

    def states(self) -> list[dict[str, np.ndarray]]:
        """Where each one is."""
        return [world.state() for world in self.worlds]

    def restore(self, states: list[dict[str, np.ndarray]]) -> None:
        """Go on there."""
        for world, state in zip(self.worlds, states, strict=True):
            world.restore(state)

    def join(self, envs: list[Any], actor: Actor, learner: Learner) -> tuple[list[Any], Actor]:
        """Environments and actor of one iteration."""
        n, n_warmup = len(envs), learner.config.n_warmup
        done, share = learner.buffer.n_seen - n_warmup, exact(self._config.explorers)
        due = range(int(done * share), int((done + n) * share))  # of all explorers' episodes, by number
        rng, graph = learner.rng, learner.graph
        ready = graph is not None and graph.n_cells > 0
        if not due or (not ready and learner.buffer.n_seen > self._config.patience):
            return envs, actor
        chosen = [(self.worlds[i % len(self.worlds)], ROLES[i % len(self.worlds) % len(ROLES)]) for i in due]
        wanted = (learner.warmup or learner.buffer.episodes()).desired_goals[:n_warmup]
        for world, role in chosen:
            world.goal = wanted[rng.integers(len(wanted))].astype(np.float64)
            if role == "seek" and graph is not None and ready:
                world.goal = graph.draw(rng).astype(np.float64)
        roles = ["policy"] * (n - len(chosen)) + [role for _, role in chosen]
        walk = ExploringActor(None, envs[0].action_space.shape[0], self._walking, rng, learner.generator)
        joined = [*envs[: n - len(chosen)], *(world for world, _ in chosen)]
        return joined, RoleActor(actor, walk, roles, self._length)
