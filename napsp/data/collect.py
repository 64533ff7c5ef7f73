"""Collecting and evaluating episodes: the only code that steps environments for learning."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch

from napsp.data.episodes import ARRIVED, BLOWN, CUT, LOST, Episodes
from napsp.envs.attempts import check_finite
from napsp.envs.blowups import BlowUpDetector
from napsp.policy.actors import Policy
from napsp.settings import MANY, check_ranges


@dataclass(frozen=True)
class ExplorationConfig:
    """What training episodes do beside following the policy."""

    epsilon: float = 0.28
    """Share of steps with a random action instead of the policy's (the paper: 0.1 or 0.3)."""
    hold: int = 6
    """A random action is held for 1 to this many steps, each number as likely; 1 is plain epsilon exploration."""
    held_starts: float = 0.0
    """Share of training episodes that begin with the box in the gripper (pick and place only)."""
    explorers: float = 0.0
    """Share of training episodes that go on where the last one ended: half of them walk at random, half seek a place of
    a cell drawn at random. Only with a graph, see ``graph.control``. Beyond the paper."""
    patience: int = 100
    """After this many episodes, warm-up included, explorers pause while the data is too thin for a graph: in a space
    too wide for one they would go on for ever."""
    anew: int = 200
    """Every so many of its episodes an explorer begins with a reset, wherever it got stuck."""
    walk_hold: int | None = None
    """As ``hold``, for the random walks of explorers; None is ``hold``. At 1 a walk hardly gets anywhere."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            epsilon=(0, 1),
            hold=(1, MANY),
            walk_hold=(1, MANY),
            held_starts=(0, 1),
            explorers=(0, 1),
            patience=(0, MANY),
            anew=(1, MANY),
        )

    @property
    def start_chance(self) -> float:
        """Chance per step, outside random actions, that one starts: ``epsilon`` is the share it comes to.

        Stretches of the policy last 1 / chance - 1 steps in the mean, random ones (1 + hold) / 2.
        """
        length = 0.5 * (1 + self.hold)
        return self.epsilon / (length - self.epsilon * (length - 1.0))


Actor = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps observations ``(E, O)`` and goals ``(E, G)`` to actions ``(E, A)`` in [-1, 1]."""


def roll(
    envs: list[gymnasium.Env],
    actor: Actor,
    seeds: list[int],
    length: int,
    options: Sequence[dict[str, Any] | None] | None = None,
) -> Episodes:
    """Run one episode of at most ``length`` steps in each environment, in lockstep; ``options`` are its reset's.

    An episode ends where its environment says so, which is not asked any further, and before a step in which its
    simulation blew up, which is warned of.

    Raises:
        UserError: an environment observed numbers that are not finite after its reset.
    """
    resets = zip(envs, seeds, options or [None] * len(envs), strict=True)
    starts = [env.reset(seed=seed, options=chosen)[0] for env, seed, chosen in resets]
    n, spaces = len(envs), envs[0].observation_space.spaces  # type: ignore[attr-defined]
    observations = np.empty((n, length + 1, *spaces["observation"].shape), np.float32)
    achieved = np.empty((n, length + 1, *spaces["achieved_goal"].shape), np.float32)
    goals = np.stack([start["desired_goal"] for start in starts]).astype(np.float32)
    actions = np.zeros((n, length, *envs[0].action_space.shape), np.float32)  # type: ignore[misc]
    lengths, endings = np.full(n, length), np.full(n, CUT, np.uint8)
    detectors, going = [BlowUpDetector(env) for env in envs], np.ones(n, bool)
    for e, (start, detector) in enumerate(zip(starts, detectors, strict=True)):
        observations[e, 0], achieved[e, 0] = start["observation"], start["achieved_goal"]
        detector.begin()
    seen = {"observation": observations[:, 0], "achieved_goal": achieved[:, 0], "desired_goal": goals}
    check_finite(seen, type(envs[0].unwrapped).__name__)
    for t in range(length):
        observations[:, t + 1], achieved[:, t + 1] = observations[:, t], achieved[:, t]  # of those that are over
        actions[going, t] = actor(observations[:, t], goals)[going]
        for e in np.flatnonzero(going):
            values, _, terminated, truncated, _ = envs[e].step(actions[e, t])
            if detectors[e].blew_up(values, terminated or truncated):
                going[e], lengths[e], endings[e], actions[e, t] = False, t, BLOWN, 0.0
                continue
            observations[e, t + 1], achieved[e, t + 1] = values["observation"], values["achieved_goal"]
            if terminated or truncated:
                going[e], lengths[e] = False, t + 1
            if terminated:
                arrived = envs[e].get_wrapper_attr("reached")(achieved[e, t + 1], goals[e])
                endings[e] = ARRIVED if arrived else LOST
        if not going.any():
            observations[:, t + 2 :], achieved[:, t + 2 :] = observations[:, t + 1, None], achieved[:, t + 1, None]
            break
    if (endings == BLOWN).any():
        name = type(envs[0].unwrapped).__name__
        warnings.warn(f"the simulation of {name} blew up; the episode ends before", RuntimeWarning, stacklevel=2)
    return Episodes(observations, achieved, actions, goals, lengths, endings)


class ExploringActor:
    """A policy whose actions are now and then replaced by random ones, held for a while.

    ``policy=None`` acts at random all the time, held in the same way.
    """

    def __init__(
        self,
        policy: Policy | None,
        action_size: int,
        config: ExplorationConfig,
        rng: np.random.Generator,
        generator: torch.Generator,
    ) -> None:
        self._policy, self._action_size = policy, action_size
        self._chance = 1.0 if policy is None else config.start_chance
        self._hold = config.hold
        self._rng, self._generator = rng, generator
        self._random = np.empty(0)
        self._steps_left = np.zeros(0, np.int64)

    def __call__(self, observations: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Actions ``(E, A)``."""
        n = len(observations)
        if len(self._steps_left) != n:
            self._steps_left = np.zeros(n, np.int64)
            self._random = np.zeros((n, self._action_size), np.float32)
        start = (self._steps_left == 0) & (self._rng.random(n) < self._chance)
        self._steps_left[start] = self._rng.integers(1, self._hold + 1, start.sum())
        self._random[start] = self._rng.uniform(-1.0, 1.0, (start.sum(), self._action_size))
        random = self._steps_left > 0
        self._steps_left[random] -= 1
        if self._policy is None:
            return self._random.copy()
        with torch.inference_mode():
            device = self._policy.scaling.goal_mean.device
            inputs = (torch.from_numpy(rows).to(device) for rows in (observations, goals))
            actions = self._policy.explore(*inputs, self._generator).cpu().numpy()
        return np.where(random[:, None], self._random, actions)
