"""Which numbers of an action change anything: Fetch reads four, and with the gripper blocked the last does nothing."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from napsp.envs.dynamics import get_state

N_STEPS = 3  # control steps


def used_actions(env: Any) -> np.ndarray:
    """Bool ``(A,)``: whether moving one number of an action moves anything that the task observes.

    A few control steps are simulated from where ``env`` (unwrapped, and reset) stands, beside it, at both ends of each
    number. A task that offers no dynamics to do so is said to use all.
    """
    n_actions = env.action_space.shape[0]
    if not hasattr(env, "dynamics"):
        return np.ones(n_actions, bool)
    state = get_state(env.model, env.data)

    def features(action: np.ndarray) -> np.ndarray:
        simulation = env.dynamics.bind(mujoco.MjData(env.model))
        seen = np.zeros((N_STEPS, env.dynamics.n_features))
        simulation.restore(state)
        simulation.advance(env.dynamics.control(np.tile(action, (N_STEPS, 1)).astype(np.float32)), seen)
        return seen

    used = np.empty(n_actions, bool)
    for k in range(n_actions):
        low, high = (features(np.where(np.arange(n_actions) == k, end, 0.25)) for end in (-0.75, 0.75))
        used[k] = not np.array_equal(low, high)
    return used
