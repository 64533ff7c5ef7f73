"""Helper processes of rollouts: failures are reported, nothing is left behind, changes are seen."""

import mmap
import multiprocessing
import os
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from explosive import Bound, Explosive

from mpc import workers
from mpc.rollout import RolloutEngine
from mpc.workers import CAN_FORK
from napsp.envs.dynamics import get_state

pytestmark = pytest.mark.skipif(
    not CAN_FORK, reason="helper processes exist on Linux only; elsewhere threads simulate, see test_rollout.py"
)


class Stubborn(Explosive):
    """Refuses to be controlled by worker 1, or dies there."""

    def __init__(self, dies):
        super().__init__(open_loop=False)
        self.dies, self.bound = dies, 0

    def bind(self, data):
        bound = Bound(self, data)
        advance = bound.advance
        bound.advance = self.fail if self.bound else lambda *rows: (time.sleep(0.1), advance(*rows))
        self.bound += 1
        return bound

    def fail(self, controls, features):
        if self.dies:
            os._exit(1)
        raise ValueError("worker 1 will not")


@pytest.mark.parametrize(("dies", "message"), [(False, "worker 1 will not"), (True, "has died")])
def test_a_failing_helper_process_is_reported_and_replaced(dies, message):
    dynamics = Stubborn(dies)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((4, 2, 1))
    with RolloutEngine(dynamics, 2) as engine:
        with pytest.raises(RuntimeError, match=message):
            engine.rollout(state, actions)
        engine.simulators[1] = engine.simulators[0]  # mended
        assert not engine.rollout(state, actions).diverged.any(), "a fresh helper takes over"


def test_helper_processes_keep_nothing_of_the_caller_open():
    """A video encoder, for one, waits for the end of the pipe it reads from."""
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((4, 2, 1))
    reader, writer = os.pipe()
    with RolloutEngine(dynamics, 2) as engine, RolloutEngine(dynamics, 2) as other:
        engine.rollout(state, actions)
        other.rollout(state, actions)
        os.close(writer)
        assert select.select([reader], [], [], 10.0)[0] and os.read(reader, 1) == b"", "somebody still holds the pipe"
    os.close(reader)


def test_rollouts_run_in_daemons_and_under_a_callers_signal_handler(monkeypatch):
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((4, 2, 1))
    handler = signal.signal(signal.SIGTERM, lambda *_: None)
    for _ in range(5):  # closed at once: the helper may not have its own handlers yet
        with RolloutEngine(dynamics, 2) as engine:
            engine.rollout(state, actions[:2])
    signal.signal(signal.SIGTERM, handler)
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    with RolloutEngine(dynamics, 2) as engine:
        assert not engine.rollout(state, actions).diverged.any()


def test_helper_processes_see_a_changed_model_after_reset_and_end_on_close():
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.full((4, 2, 1), 1e-9)
    engine = RolloutEngine(dynamics, 2)
    before = engine.rollout(state, actions).observations
    dynamics.model.actuator_gear[0, 0] *= 2.0
    engine.reset()
    after = engine.rollout(state, actions).observations
    assert (after[1] > before[1]).all()
    np.testing.assert_array_equal(after[0], after[1])
    (helper,) = engine._helpers._processes
    engine.close()
    assert not any(helper is child for child in multiprocessing.active_children())


class Waiting(Explosive):
    """Waits in forked processes for what only the caller's threads could bring, as torch does there."""

    def __init__(self):
        super().__init__(open_loop=False)
        self.home, self.stuck, self.lets_others_begin = os.getpid(), mmap.mmap(-1, 1), False

    def bind(self, data):
        bound = Bound(self, data)
        advance = bound.advance

        def shared(*rows):
            if os.getpid() != self.home:
                self.stuck[0] = 1
                threading.Event().wait()
            end = time.monotonic() + 30.0
            while self.lets_others_begin and not self.stuck[0] and time.monotonic() < end:
                time.sleep(0.01)
            advance(*rows)

        bound.advance = shared
        return bound


def test_a_stuck_helper_process_is_noticed_and_threads_go_on(monkeypatch):
    monkeypatch.setattr(workers, "QUIET_SECONDS", 0.5)
    dynamics = Waiting()
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.full((4, 2, 1), 1e-9)
    with RolloutEngine(dynamics, 1) as engine:
        alone = engine.rollout(state, actions)
    dynamics.lets_others_begin = True
    with RolloutEngine(dynamics, 3) as engine:
        with pytest.warns(RuntimeWarning, match="waits for ever in a forked process.*simulating in threads"):
            first = engine.rollout(state, actions)
        second = engine.rollout(state, actions)  # without another word
        assert not engine.forks and engine._helpers is None
    for found in (first, second):
        np.testing.assert_array_equal(found.observations, alone.observations)


def test_a_helper_process_that_works_long_is_waited_for(monkeypatch):
    monkeypatch.setattr(workers, "QUIET_SECONDS", 0.3)
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((2, 2, 1))
    with RolloutEngine(dynamics, 2) as engine:
        advance, end = engine.simulators[1].advance, time.monotonic() + 1.5

        def busy(*rows):
            while time.monotonic() < end:
                pass
            advance(*rows)

        engine.simulators[1].advance = busy
        assert not engine.rollout(state, actions).diverged.any()
        assert engine.forks


def test_helper_processes_of_a_thread_that_has_ended_are_replaced():
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.full((4, 2, 1), 1e-9)
    with RolloutEngine(dynamics, 2) as engine:
        found = []
        for _ in range(2):
            thread = threading.Thread(target=lambda: found.append(engine.rollout(state, actions).observations))
            thread.start()
            thread.join()
        found.append(engine.rollout(state, actions).observations)
    assert len(found) == 3
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


ORPHANS = """
import os, signal, mujoco, numpy as np
import test_workers
from mpc.rollout import RolloutEngine
from napsp.envs.dynamics import get_state
dynamics = test_workers.Waiting()
state = get_state(dynamics.model, mujoco.MjData(dynamics.model))
engine = RolloutEngine(dynamics, 3)
fork = engine._forked
def forked(*sizes):
    helpers = fork(*sizes)
    print(*(process.pid for process in helpers._processes), flush=True)
    return helpers
engine._forked = forked
engine.rollout(state, np.zeros((4, 2, 1)))
"""


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_stuck_helper_processes_do_not_outlive_their_caller(end):
    with subprocess.Popen(
        [sys.executable, "-c", ORPHANS], cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True
    ) as caller:
        helpers = [int(word) for word in caller.stdout.readline().split()]
        assert len(helpers) == 2 and all(running(pid) for pid in helpers)
        caller.send_signal(end)
        caller.wait()
    deadline = time.monotonic() + 10.0
    while any(running(pid) for pid in helpers) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(running(pid) for pid in helpers)


def running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
