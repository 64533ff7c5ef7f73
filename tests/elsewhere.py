"""What tests do in processes other than their own; importable there."""

import multiprocessing

import napsp
import planners


def planned(task="fetch_reach"):
    """Two plans' first actions, how they were simulated, and whether this process may have children."""
    env = napsp.make(task)
    with planners.controller("mppi", env, cost="euclidean", samples=8, horizon=3, threads=2) as controller:
        observation, _ = env.reset(seed=0)
        actions = [controller.plan(observation).action.tolist() for _ in range(2)]
        path = controller.controller.engine.path
    env.close()
    return actions, path, multiprocessing.current_process().daemon


def planned_by(held):
    """The same by an environment and a controller that the parent has used: this process is its fork."""
    observation, controller = held
    controller.reset(seed=0)
    return controller.plan(observation).action.tolist(), controller.controller.engine.path
