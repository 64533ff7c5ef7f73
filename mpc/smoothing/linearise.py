"""How the states of a plan answer its actions, measured on the true simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpc.rollout import RolloutEngine, Trajectories
from mpc.simulators import State


@dataclass(frozen=True)
class Linearisation:
    """The simulator around one plan.

    Attributes:
        nominal: the plan's own trajectory, a batch of one.
        sensitivities: d observation_t / d action, ``(n, O, H * A)``, for t = 1 .. n; columns in the order of time.
    """

    nominal: Trajectories
    sensitivities: np.ndarray


def linearise(
    engine: RolloutEngine, state: State, actions: np.ndarray, n_simulated: int, step: float = 0.1
) -> Linearisation:
    """Roll out the plan ``actions`` ``(H, A)``, and copies with one number changed each.

    Forward differences. A ``step`` as large as the changes that will be asked for is meant: in contact it averages
    over the kinks that a small one falls into, and in free space the map is close to linear anyhow. It points away
    from the nearer action bound, because actions are clipped there.
    """
    horizon, n_actions = actions.shape
    plan, signed = actions[:n_simulated], np.where(actions > 0.0, -step, step).astype(actions.dtype)
    copies, moving = [], []
    for t in range(n_simulated):
        changed = np.repeat(plan[None], n_actions, axis=0)
        changed[:, t] += np.diag(signed[t])
        # What moves nothing (Fetch's blocked gripper) needs no simulation.
        moves = (engine.dynamics.control(changed) != engine.dynamics.control(plan[None])).any((1, 2))
        copies.append(changed[moves])
        moving.append(np.flatnonzero(moves))
    nominal, found = _simulate(engine, state, plan, copies)
    sensitivities = np.zeros((n_simulated, nominal.observations.shape[-1], horizon * n_actions))
    for t, (changed, which, answers) in enumerate(zip(copies, moving, found, strict=True)):
        done = (changed[np.arange(len(which)), t, which] - plan[t, which]).astype(float)
        slopes = (answers.observations - nominal.observations[:, t:]) / done[:, None, None]
        sensitivities[t:, :, t * n_actions + which] = slopes.transpose(1, 2, 0)
        if nominal.diverged.any() or answers.diverged.any():
            sensitivities[:] = np.nan  # no linear model; whoever solves with it checks
            break
    return Linearisation(nominal, sensitivities)


def _simulate(
    engine: RolloutEngine, state: State, plan: np.ndarray, copies: list[np.ndarray]
) -> tuple[Trajectories, list[Trajectories]]:
    """The trajectory of the plan ``(n, A)``, and those of its copies that differ from step t on, from there on.

    Copies of step t start from the state before it, so the steps that they share are simulated once. With many cores
    one large batch is sooner done than n small ones, and the answer is the same to the bit.
    """
    n, sizes = len(plan), [len(changed) for changed in copies]
    rounds = [-(-size // engine.n_threads) for size in (1 + sum(sizes), *sizes)]
    if rounds[0] * n > n + sum(count * (n - t) for t, count in enumerate(rounds[1:])):
        nominal, states = engine.trace(state, plan)
        return nominal, [engine.rollout(states[t], changed[:, t:]) for t, changed in enumerate(copies)]
    together = engine.rollout(state, np.concatenate([plan[None], *copies]))
    ends = np.cumsum([1, *sizes])
    parts = [(slice(0, 1), 0), *((slice(*ends[t : t + 2]), t) for t in range(n))]
    nominal, *found = (
        Trajectories(together.observations[rows, t:], together.achieved_goals[rows, t:], together.diverged[rows])
        for rows, t in parts
    )
    return nominal, found
