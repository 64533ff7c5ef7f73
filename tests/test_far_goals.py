"""Goals far from the origin: plans are judged in float64; training, in float32, is refused where that is too coarse."""

import sys
from pathlib import Path

import numpy as np
import pytest
from tiny import tiny

import napsp
import planners
from napsp.errors import UserError
from napsp.train import train

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
import two_link_arm

OFFSET = np.array([1e6, -3e6])


class FarArmDynamics(two_link_arm.TwoLinkArmDynamics):
    def observe(self, features):
        observation, tip = super().observe(features)
        return observation, tip + OFFSET


class FarArm(two_link_arm.TwoLinkArm):
    """The same arm, its fingertip in coordinates of another origin."""

    def __init__(self, render_mode=None):
        super().__init__(render_mode)
        self.dynamics = FarArmDynamics(self.model)

    def _start(self):
        super()._start()
        self.goal = self.goal + OFFSET


def run(name):
    env = napsp.make(name)
    observation, _ = env.reset(seed=3)
    actions, successes = [], []
    with planners.controller("mppi", env, cost="euclidean", samples=24, horizon=8, threads=1) as controller:
        for _ in range(12):
            actions.append(controller.plan(observation).action)
            observation, _, _, _, info = env.step(actions[-1])
            successes.append(info["is_success"])
    return np.array(actions), successes


def test_plans_are_those_of_the_task_at_the_origin():
    near, far = run("two_link_arm:TwoLinkArm"), run(f"{__name__}:FarArm")
    np.testing.assert_allclose(far[0], near[0], atol=1e-3)
    assert far[1] == near[1]


def test_training_far_from_the_origin_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(
        UserError, match=r"coordinates of 1e\+06, where float32 numbers are 0\.06 apart.* near its goals"
    ):
        train(tiny("far:FarPoint"), tmp_path / "far")
    with pytest.raises(UserError, match=r"coordinates of 3e\+06"):
        train(tiny(f"{__name__}:FarArm"), tmp_path / "arm")
    assert train(tiny("far:NotSoFarPoint"), tmp_path / "near")
