"""A task as a batch simulator, for planning libraries that leave the simulation to their user.

``mujoco.rollout`` advances all samples at once, by one control step or, where the task allows it, by the whole plan.
Such a call cannot return the constraint solver's warm start, so none is passed on. On Fetch, whose mocap is re-anchored
to the gripper at every control step, the target is computed for the whole batch from sensors in the model: the fastest
way there is. They lag by one physics step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from benchmarks.raw_rollout import HELD
from napsp.envs.dynamics import INTEGRATION_STATE
from napsp.envs.fetch import FetchReachDynamics
from napsp.envs.fetch_arm import GRIPPER_ROTATION

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


class UnavailableError(Exception):
    """A peer is not installed, or cannot express a task."""


@dataclass(frozen=True)
class Problem:
    """What every planner is given.

    Attributes:
        world: the environment, unwrapped.
        samples: N, plans per call.
        horizon: H, control steps per plan.
        noise_scale: standard deviation of the noise; actions lie in [-1, 1].
        threads: simulations at once, where the peer leaves the choice.
    """

    world: Any
    samples: int
    horizon: int
    noise_scale: float
    threads: int

    def cost(self, achieved_goals: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Straight-line distance of goals ``(..., G)`` to one goal ``(G,)``, in steps at full speed, ``(...)``."""
        return np.linalg.norm(achieved_goals - goal, axis=-1) / self.world.step_length


class BatchSimulator:
    """N simulations of an open-loop task with ``mujoco.rollout``, everything preallocated.

    A simulator state ``(X,)`` is MuJoCo's full physics state, which begins with the clock.

    Args:
        problem: task and sizes.
        n_steps: control steps per ``mujoco.rollout`` call.
    """

    controlled = mujoco.mjtState.mjSTATE_CTRL

    def __init__(self, problem: Problem, n_steps: int) -> None:
        self._dynamics = problem.world.dynamics
        self._model = self._make_model(problem)
        model, n, self._n_physics = self._model, problem.samples, n_steps * self._dynamics.substeps
        self._models, self._datas = [model] * n, [mujoco.MjData(model) for _ in range(problem.threads)]
        self._pool = Rollout(nthread=problem.threads)
        self.size = self._n_full = mujoco.mj_stateSize(model, FULL)
        self._states = np.empty((n, self._n_physics, self._n_full))
        self._sensors = np.empty((n, self._n_physics, model.nsensordata))
        self._controls = np.zeros((n, self._n_physics, mujoco.mj_stateSize(model, self.controlled)))
        self._n_steps, self.physics_steps = n_steps, 0

    def _make_model(self, problem: Problem) -> mujoco.MjModel:
        return problem.world.model

    def start(self, state: np.ndarray) -> np.ndarray:
        """The simulator state ``(X,)`` of an environment's state."""
        data, full = self._datas[0], np.empty(self._n_full)
        mujoco.mj_setState(self._model, data, state, INTEGRATION_STATE)
        mujoco.mj_getState(self._model, data, full, FULL)
        self.physics_steps = 0
        return full

    def advance(self, states: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Simulator states ``(N, n_steps, X)`` after each of the control steps ``(N, n_steps, A)``."""
        substeps = self._dynamics.substeps
        self._set_controls(self._controls.reshape(len(states), self._n_steps, substeps, -1), states, actions)
        self._pool.rollout(
            self._models,
            self._datas,
            np.ascontiguousarray(states[:, : self._n_full]),
            self._controls,
            control_spec=self.controlled,
            skip_checks=True,
            nstep=self._n_physics,
            state=self._states,
            sensordata=self._sensors,
        )
        simulated = self._states[:, -1, 0] - states[:, 0]
        self.physics_steps += round(float(simulated.sum()) / self._model.opt.timestep)
        return self._ends(slice(substeps - 1, None, substeps))

    def _set_controls(self, controls: np.ndarray, states: np.ndarray, actions: np.ndarray) -> None:
        """Fill in controls ``(N, n_steps, substeps, U)``."""
        controls[:] = self._dynamics.control(actions)[:, :, None]

    def _ends(self, ends: slice) -> np.ndarray:
        return self._states[:, ends].copy()

    def achieved_goals(self, states: np.ndarray) -> np.ndarray:
        """Achieved goals ``(..., G)`` of simulator states ``(..., X)``."""
        model = self._model
        return self._dynamics.observe(states[..., 1 : 1 + model.nq + model.nv])[1]

    def rollout(self, state: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Achieved goals ``(N, H, G)`` of actions ``(N, H, A)`` from an environment's state."""
        states = np.tile(self.start(state), (len(actions), 1, 1))
        goals = []
        for first in range(0, actions.shape[1], self._n_steps):
            states = self.advance(states[:, -1], actions[:, first : first + self._n_steps])
            goals.append(self.achieved_goals(states))
        return np.concatenate(goals, axis=1)

    def close(self) -> None:
        """Stop the threads."""
        self._pool.close()


class FetchSimulator(BatchSimulator):
    """N simulations of Fetch reaching, one control step per call: each re-anchors the mocap to the gripper.

    A simulator state also holds position (3) and rotation (4) of the gripper and position (3) of the grip.
    """

    controlled = HELD

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem, n_steps=1)
        self.size = self._n_full + 10
        self._held = np.empty(mujoco.mj_stateSize(self._model, HELD))
        first = int(self._model.sensor("gripper_position").adr[0])
        self._pose = slice(first, first + 10)

    def _make_model(self, problem: Problem) -> mujoco.MjModel:
        class Sensed(type(problem.world)):
            """The same task with sensors for what the next control step needs to know."""

            def _add_obstacles(self, spec: mujoco.MjSpec) -> None:
                super()._add_obstacles(spec)
                gripper, position = "robot0:gripper_link", mujoco.mjtSensor.mjSENS_FRAMEPOS
                body, site = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_SITE
                rotation = mujoco.mjtSensor.mjSENS_FRAMEQUAT
                spec.add_sensor(name="gripper_position", type=position, objtype=body, objname=gripper)
                spec.add_sensor(name="gripper_rotation", type=rotation, objtype=body, objname=gripper)
                spec.add_sensor(name="grip_position", type=position, objtype=site, objname="robot0:grip")

        return Sensed().model

    def start(self, state: np.ndarray) -> np.ndarray:
        """The simulator state ``(X,)`` of an environment's state."""
        full, data = super().start(state), self._datas[0]
        mujoco.mj_forward(self._model, data)
        mujoco.mj_getState(self._model, data, self._held, HELD)
        return np.concatenate([full, data.sensordata[self._pose]])

    def _set_controls(self, controls: np.ndarray, states: np.ndarray, actions: np.ndarray) -> None:
        held = np.tile(self._held, (len(states), 1))
        held[:, -7:-4] = states[:, self._n_full : self._n_full + 3] + self._dynamics.control(actions[:, 0])
        held[:, -4:] = states[:, self._n_full + 3 : self._n_full + 7] + GRIPPER_ROTATION
        controls[:] = held[:, None, None]

    def _ends(self, ends: slice) -> np.ndarray:
        states = np.concatenate([self._states[:, ends], self._sensors[:, ends, self._pose]], axis=-1)
        fingers = self._dynamics.fingers
        states[..., 1 + fingers.start : 1 + fingers.stop] = 0.0  # as the environment does after each step
        return states

    def achieved_goals(self, states: np.ndarray) -> np.ndarray:
        """Grip positions ``(..., 3)`` of simulator states ``(..., X)``."""
        return states[..., -3:]


def make_simulator(problem: Problem, n_steps: int) -> BatchSimulator:
    """A simulator that takes ``n_steps`` control steps per call where the task allows it, else one.

    Raises:
        UnavailableError: a task whose control depends on the state in another way than Fetch reaching.
    """
    if problem.world.dynamics.open_loop:
        return BatchSimulator(problem, n_steps)
    if isinstance(problem.world.dynamics, FetchReachDynamics):
        return FetchSimulator(problem)
    raise UnavailableError("no dynamics function written for this task")
