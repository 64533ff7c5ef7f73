"""Do plans come true? The engine that is to be used plans in a task, which then takes those very steps."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpc.rollout import RolloutEngine
from napsp.envs.watch import Watched

SEEDS = (0, 1)  # the second episode shows what a reset leaves behind, or changes
N_PLANS, N_STEPS, MAX_PUSHED = 3, 4, 15


@dataclass(frozen=True)
class Verified:
    """What was compared, to the bit.

    Attributes:
        n_steps: steps that came as planned.
        path: how the engine simulated them.
        touched: whether bodies were in contact; None where nobody can tell.
        difference: where the first step that came otherwise stands; None if there was none.
        forks: whether helper processes can simulate the task.
    """

    n_steps: int
    path: str
    touched: bool | None
    difference: str | None
    forks: bool

    def __str__(self) -> str:
        if self.difference is not None:
            return f"only {self.n_steps} steps came as planned, the next one did not: {self.difference} ({self.path})"
        unproven = "; without contact, so contacts are unproven" if self.touched is False else ""
        return f"{self.n_steps} steps of {len(SEEDS)} episodes came as planned, to the bit ({self.path}){unproven}"


def verify(env: Any, engine: RolloutEngine, name: str) -> Verified:
    """Plan and execute parts of two episodes of ``env``, which is reset and stepped: give one that is not needed.

    Workers of ``engine``, whose dynamics are those of ``env``, share copies of the same actions: from the start, and
    after actions held until something touches. Warns if the environment then does something else than planned, or if
    planning changes the model.
    """
    rng, n_steps = np.random.default_rng(0), 0
    touched = None if env.unwrapped.data is None else False
    for seed in SEEDS:
        env.reset(seed=seed)
        engine.reset()
        ended = False
        for i in range(N_PLANS):
            push = rng.choice([-1.0, 1.0], env.action_space.shape).astype(np.float32)
            for _ in range(MAX_PUSHED if i else 0):
                if ended or _touches(env):
                    break
                _, ended = _step(env, push)
            if ended:
                break
            actions = np.clip(push + rng.uniform(-1, 1, (N_STEPS, *push.shape)), -1, 1).astype(np.float32)
            planned = _plan(env, engine, actions, name)
            for t, action in enumerate(actions):
                observation, ended = _step(env, action)
                touched = touched if touched is None else touched or _touches(env)
                for part, found in zip(("observation", "achieved_goal"), planned, strict=True):
                    same = found[:, t].astype(observation[part].dtype) == observation[part]
                    if not (same | (np.isnan(found[:, t]) & np.isnan(observation[part]))).all():
                        where = f"{part}, step {t + 1} of plan {i + 1} in the episode of seed {seed}"
                        _warn(
                            f"{name}: a planned step differs from step() of the environment ({where}; {engine.path}), "
                            f"so plans will not come true exactly; {_repair(env)}"
                        )
                        return Verified(n_steps, engine.path, touched, where, engine.forks)
                n_steps += 1
                if ended:
                    break
            if ended:
                break
    return Verified(n_steps, engine.path, touched, None, engine.forks)


def _plan(env: Any, engine: RolloutEngine, actions: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    world = env.unwrapped
    model = None if world.model is None else Watched(world.model)
    planned = engine.rollout(engine.state_of(world), np.stack([actions] * 2 * engine.n_threads))
    if model is not None and model.changed():
        _warn(f"{name}: planning changes the environment's model; let advance move a mocap body instead")
    return planned.observations, planned.achieved_goals


def _step(env: Any, action: np.ndarray) -> tuple[dict[str, np.ndarray], bool]:
    observation, _, terminated, truncated, _ = env.step(action)
    return observation, bool(terminated or truncated)


def _touches(env: Any) -> bool:
    data = env.unwrapped.data
    return data is not None and data.ncon > 0


def _repair(env: Any) -> str:
    if env.unwrapped.model is None:
        return "let get_state and set_state hold all that step reads, its random generator included"
    return "let both call the same dynamics, which restore all that they read"


def _warn(text: str) -> None:
    warnings.warn(text, RuntimeWarning, stacklevel=4)
