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
    """Roll out the plan ``actions`` ``(H, A)`` and, from each of its states on, copies with one number changed each.

    Forward differences. A ``step`` as large as the changes that will be asked for is meant: in contact it averages
    over the kinks that a small one falls into, and in free space the map is close to linear anyhow. It points away
    from the nearer action bound, because actions are clipped there.
    """
    horizon, n_actions = actions.shape
    nominal, states = engine.trace(state, actions[:n_simulated])
    sensitivities = np.zeros((n_simulated, nominal.observations.shape[-1], horizon * n_actions))
    signed = np.where(actions > 0.0, -step, step).astype(actions.dtype)
    control = engine.dynamics.control
    for t in range(n_simulated):  # what an action does not change, the steps before it, is not simulated again
        rest = actions[t:n_simulated]
        changed = np.repeat(rest[None], n_actions, axis=0)
        changed[:, 0] += np.diag(signed[t])
        # What moves nothing (Fetch's blocked gripper) needs no simulation either.
        moving = np.flatnonzero((control(changed) != control(rest[None])).any((1, 2)))
        if not len(moving):
            continue
        found = engine.rollout(states[t], changed[moving])
        done = (changed[moving, 0, moving] - rest[0, moving]).astype(float)
        slopes = (found.observations - nominal.observations[:, t:]) / done[:, None, None]
        sensitivities[t:, :, t * n_actions + moving] = slopes.transpose(1, 2, 0)
        if nominal.diverged.any() or found.diverged.any():
            sensitivities[:] = np.nan  # no linear model; whoever solves with it checks
            break
    return Linearisation(nominal, sensitivities)
