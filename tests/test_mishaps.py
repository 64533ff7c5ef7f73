"""Threads, pools, notebooks, torch: wherever a program plans and trains, it does the same and leaves nothing."""

import asyncio
import gc
import multiprocessing
import os
import threading
import time

import mujoco
import numpy as np
import pytest
import torch
from elsewhere import planned, planned_by
from explosive import Explosive
from tiny import TINY

import napsp
import planners
from mpc.rollout import RolloutEngine
from mpc.workers import CAN_FORK
from napsp.envs.dynamics import get_state

HELD = []
pytestmark = pytest.mark.skipif(not CAN_FORK, reason="helper processes exist on Linux only")


def wait_until(true, seconds=20.0):
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.02)
    return true()


def runs(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def used(open_loop, n_threads, fork):
    dynamics = Explosive(open_loop)
    engine = RolloutEngine(dynamics, n_threads, fork)
    engine.rollout(get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((6, 2, 1)))
    return engine


@pytest.mark.parametrize("main", [True, False])
@pytest.mark.parametrize(("open_loop", "fork"), [(False, True), (False, False), (True, True)])
def test_an_engine_that_nobody_closes_leaves_nothing_behind(open_loop, fork, main):
    before, helpers = set(os.listdir("/proc/self/task")), []

    def once():
        nonlocal helpers
        engine = used(open_loop, 3, fork)
        helpers = [process.pid for process in engine._helpers._processes] if engine._helpers else []

    if main:
        once()
    else:
        thread = threading.Thread(target=once)
        thread.start()
        thread.join()
    assert len(helpers) == (2 if fork and not open_loop else 0)
    gc.collect()
    assert wait_until(lambda: not any(map(runs, helpers)))
    assert wait_until(lambda: set(os.listdir("/proc/self/task")) <= before)


@pytest.fixture(scope="module")
def here():
    return planned()


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow),
                                    pytest.param("forkserver", marks=pytest.mark.slow)])  # fmt: skip
def test_a_daemon_of_a_pool_plans_the_same_in_threads(method, here):
    with multiprocessing.get_context(method).Pool(1) as pool:
        actions, path, daemon = pool.apply_async(planned).get(120)
    assert here[1:] == ("2 processes", False) and (path, daemon) == ("2 threads", True)
    assert actions == here[0]


def planned_in_child(queue):
    queue.put(planned_by(HELD[0]))


@pytest.mark.parametrize("daemon", [True, False])
@pytest.mark.parametrize(("task", "path"), [("fetch_reach", None), ("point_maze", "mujoco.rollout, 2 threads")])
def test_a_fork_of_a_program_that_has_planned_plans_the_same(task, path, daemon):
    env = napsp.make(task)
    with planners.controller("mppi", env, cost="euclidean", samples=8, horizon=3, threads=2) as controller:
        HELD[:] = [(env.reset(seed=0)[0], controller)]
        wanted = planned_by(HELD[0])
        context = multiprocessing.get_context("fork")
        queue = context.Queue()
        child = context.Process(target=planned_in_child, args=(queue,), daemon=daemon)
        child.start()
        found = queue.get(timeout=60)
        child.join(60)
        assert child.exitcode == 0
        assert found == (wanted[0], path or ("2 threads" if daemon else "2 processes"))
        assert planned_by(HELD[0]) == wanted, "the parent's helpers and threads are as they were"
        HELD.clear()
    env.close()


def trained(folder, method):
    options = {name: value for name, value in TINY.items() if name != "n_episodes"}
    distance = napsp.train("point_maze", method, episodes=12, options=options, out=folder)
    env = napsp.make("point_maze")
    observation, _ = env.reset(seed=0)
    state, goal = observation["observation"], observation["desired_goal"]
    steps = distance(state, None, goal)
    with planners.controller("mppi", env, cost=distance, samples=8, horizon=4, threads=1) as controller:
        action = controller.plan(observation).action
    env.close()
    learned = [p for net in (distance.model.distance, distance.model.policy) for p in net.parameters()]
    return [*(p.detach().numpy() for p in learned), np.asarray(steps), action]


@pytest.mark.filterwarnings("ignore:method .* does not read")  # one set of small options for all methods
@pytest.mark.parametrize("method", ["ours", pytest.param("plus", marks=pytest.mark.slow),
                                    pytest.param("qrl", marks=pytest.mark.slow)])  # fmt: skip
def test_torchs_default_type_and_a_running_event_loop_change_nothing(method, tmp_path):
    """As in a notebook, where a cell runs inside a loop, after others that have set what they like."""
    wanted = trained(tmp_path / "plain", method)

    async def cell():
        return trained(tmp_path / "cell", method)

    torch.set_default_dtype(torch.float64)
    try:
        found = asyncio.run(cell())
        assert torch.get_default_dtype() == torch.float64, "it is the program's own"
    finally:
        torch.set_default_dtype(torch.float32)
    for one, other in zip(wanted, found, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
