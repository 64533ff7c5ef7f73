"""Three fingers turn a valve to an angle (paper, section 6 "Claw Manipulation").

The model is ``claw.xml``. A goal is an angle as (sin, cos), so that it has no seam; two goals
are as far apart as the chord between them, which grows with the angle between them.

The paper does not say how an episode starts, when the goal counts as reached, nor how actions
are scaled. Start pose, 0.1 rad, 40 steps of 0.1 s and the range of the joint targets are those
of ROBEL (Ahn et al., 2020), with two exceptions: targets are absolute, without ROBEL's bound
on their change (which depends on the simulated joints), and the valve has no stop.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from napsp.envs.open_loop import OpenLoopDynamics, OpenLoopEnv

MODEL_FILE = Path(__file__).with_name("claw.xml")
N_JOINTS = 9
ANGLE_THRESHOLD = 0.1  # radians between the valve's angle and the goal
MARKER = np.array([0.10, 0.10, 0.102])  # radius twice and height, metres: just beyond the marked arm's tip


class ClawDynamics(OpenLoopDynamics):
    """Position control of the fingers: a control row holds the targets of the nine joints.

    Features: joint angles (9), valve angle, then their velocities. The valve's angle counts
    its turns; only its sine and cosine are seen.
    """

    substeps, reads_shapes = 40, False

    def __init__(self, model: mujoco.MjModel) -> None:
        super().__init__(model)
        self._largest_target = model.actuator_ctrlrange[:, 1].copy()

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Joint targets ``(..., 9)`` in rad: actions clipped to [-1, 1], 0 is the finger hanging straight."""
        return np.clip(np.asarray(actions, np.float64), -1.0, 1.0) * self._largest_target

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles [rad], sine and cosine of the valve ``(..., 11)``; the latter two ``(..., 2)``."""
        # Contiguous, alone or in a batch: numpy picks its sine by the memory layout.
        valve = features[..., N_JOINTS].copy()
        achieved_goal = direction(valve)
        return np.concatenate([features[..., :N_JOINTS], achieved_goal], axis=-1), achieved_goal


class ClawEnv(OpenLoopEnv):
    """Goal-conditioned valve turning.

    Action: joint targets in [-1, 1] ``(9,)``, three per finger: abduction (1 is 0.48 rad),
    flexion (pi/3) and flexion of the tip (pi/2). Observation ``(11,)``: joint angles, sine and
    cosine of the valve's angle. Goal: (sin, cos) of an angle uniform on the circle, reached
    within 0.1 rad. Reward: 0 when reached, else -1. One control step lasts 0.1 s.
    """

    camera = "front"
    # Chord per control step, mean of planned turns with regrasping; a push alone makes up to 0.6.
    step_length = 0.23
    goal_circle = float(MARKER[0])
    """Radius of the circle that goals lie on in the world, metres."""

    def __init__(self, render_mode: str | None = None) -> None:
        self.model_spec = spec = mujoco.MjSpec.from_file(str(MODEL_FILE))
        dynamics = ClawDynamics(spec.compile())
        super().__init__(dynamics, 2.0 * np.sin(0.5 * ANGLE_THRESHOLD), render_mode)

    @property
    def goal_radius(self) -> float:
        """Radius of the goal in the world, metres, for pictures."""
        return self.distance_threshold * MARKER[0]

    def _start(self) -> None:
        """Fingers spread and clear of the valve, the valve at angle 0, any goal."""
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("home").id)
        self.goal = direction(np.array(self.np_random.uniform(-np.pi, np.pi)))

    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """Where goals ``(..., 2)`` put the tip of the marked arm, ``(..., 3)`` in metres, for pictures."""
        return np.stack([goals[..., 1], goals[..., 0], np.ones(goals.shape[:-1])], axis=-1) * MARKER


def direction(angle: np.ndarray) -> np.ndarray:
    """Goals (sin, cos) ``(..., 2)`` of angles ``(...)`` in rad."""
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1)
