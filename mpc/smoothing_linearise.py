"""How the states of a plan answer its actions, measured on the true simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpc.rollout import RolloutEngine, Trajectories


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
    engine: RolloutEngine, state: np.ndarray, actions: np.ndarray, n_simulated: int, step: float = 0.1
) -> Linearisation:
    """Roll out the plan ``actions`` ``(H, A)`` and, in the same batch, copies with one number changed each.

    Forward differences. A ``step`` as large as the changes that will be asked for is meant: in contact it averages
    over the kinks that a small one falls into, and in free space the map is close to linear anyhow. It points away
    from the nearer action bound, because actions are clipped there.
    """
    horizon, n_actions = actions.shape
    signed = np.where(actions > 0.0, -step, step).astype(actions.dtype)
    changed = np.repeat(actions[None], n_simulated * n_actions, axis=0)
    index = np.arange(len(changed))
    time, which = index // n_actions, index % n_actions
    changed[index, time, which] += signed[time, which]
    # What moves nothing (Fetch's blocked gripper) needs no simulation.
    control = engine.dynamics.control
    moves = (control(changed) != control(actions[None])).any((1, 2)) if n_simulated else np.zeros(0, bool)
    batch = np.concatenate([actions[None], changed[moves]])
    found = engine.rollout(state, batch[:, :n_simulated])
    nominal = Trajectories(found.observations[:1], found.achieved_goals[:1], found.diverged[:1])
    done = (batch[1:] - actions)[np.arange(moves.sum()), time[moves], which[moves]].astype(float)
    sensitivities = np.zeros((n_simulated, found.observations.shape[-1], horizon * n_actions))
    slopes = (found.observations[1:] - found.observations[:1]) / done[:, None, None]
    sensitivities[:, :, index[moves]] = slopes.transpose(1, 2, 0)
    if found.diverged[1:].any():
        sensitivities[:] = np.nan  # no linear model; whoever solves with it checks
    return Linearisation(nominal, sensitivities)
