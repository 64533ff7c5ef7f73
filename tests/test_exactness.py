"""Models drawn from parts: whatever a task is made of, a plan is what the environment then does, in every path.

``NAPSP_MODELS=500`` draws more of them.
"""

import os

import numpy as np
from drawn import drawn_tasks
from hypothesis import HealthCheck, given, settings

from mpc.divergence import blew_up, watch
from mpc.rollout import RolloutEngine
from mpc.workers import CAN_FORK
from napsp.envs.dynamics import get_state

N_STEPS, WITHIN = 5, "from within a trace"
ENGINES = ((1, False), (2, False), (2, CAN_FORK), (8, False))
N = int(os.environ.get("NAPSP_MODELS", "60"))
drawn_often = settings(max_examples=N, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def plans_come_true(task, before):
    """Compare every path of the engine with the steps that the environment takes from there."""
    rng = np.random.default_rng(before)
    shape = task.action_space.shape
    for _ in range(before):
        task.step(np.zeros(shape) if before > 4 else rng.uniform(-1, 1, shape))
    state, actions = get_state(task.model, task.data), rng.uniform(-1, 1, (5, N_STEPS, *shape)).astype(np.float32)
    observation, found = {"observation": np.zeros(1), "desired_goal": task.goal}, {}
    for n_threads, fork in ENGINES:
        with RolloutEngine(task.dynamics, n_threads, fork) as engine:
            planned = engine.rollout(state, actions)
            path = f"{n_threads} workers{', forked' if fork else ''}"
            found[path] = planned.observations[3], planned.diverged[3]
            traced, states = engine.trace(state, actions[3])
            found["trace"] = traced.observations[0], traced.diverged[0]
            rest = engine.rollout(states[2], actions[:, 2:])
            found[WITHIN] = np.concatenate([traced.observations[0, :2], rest.observations[3]]), rest.diverged[3]
            steps = iter(actions[3])
            followed = engine.follow(state, observation, lambda o, g, steps=steps: next(steps)[None], N_STEPS)
            found["follow"] = followed.features, followed.diverged[-1]
    watch(task.data)
    executed = np.array([task.step(action)[0]["observation"] for action in actions[3]])
    lost = blew_up(task.data) or not np.isfinite(executed).all()
    for path, (observed, diverged) in found.items():
        if path != WITHIN:  # it begins after what may have blown up
            assert diverged == lost, path
        if not lost:
            np.testing.assert_array_equal(observed, executed, err_msg=path)
    return not lost


@drawn_often
@given(drawn_tasks())
def test_plans_come_true_in_every_path(drawn):
    plans_come_true(*drawn)
