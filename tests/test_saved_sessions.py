"""Planning commands, sessions and controllers in environments that save and restore their state."""

import json

import numpy as np
import pytest
import savers
from tiny import tiny

import napsp
import planners
from napsp import envs
from napsp.errors import UserError
from napsp.train import train
from planners.app.cli import run
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session
from planners.app.studio.choices import Choices
from planners.app.studio.opening import open_session

STRAIGHT = {"cost": "euclidean", "search.samples": 24, "horizon": 6}


def session(name, threads=1, checkpoint=None, **changes):
    config = PlanConfig.of("mppi", {"env": f"savers:{name}", **STRAIGHT, **changes})
    return Session.open(config, RunOptions(threads=threads, checkpoint=checkpoint))


def episode(name, seed=0, threads=1, **changes):
    opened = session(name, threads, **changes)
    try:
        return opened, opened.run_episode(seed, hold=1)  # until the goal
    finally:
        opened.close()


@pytest.mark.parametrize("name", ["Plane", "Arriving"])
def test_the_straight_line_leads_to_goals_in_about_as_many_steps_as_it_takes(name):
    opened, result = episode(name)
    straight = np.abs(result.desired_goal - result.achieved_goals[0]).max() / savers.FULL
    assert result.success and straight - 1 <= result.first_hit <= straight + 5
    assert len(result.steps) == result.first_hit
    assert np.isfinite(result.column("cost")).all() and opened.verified.difference is None
    assert opened.control_period is None


def test_plans_do_not_depend_on_workers():
    (_, one), (_, other) = episode("Noisy", threads=1), episode("Noisy", threads=2)
    np.testing.assert_array_equal(one.actions, other.actions)
    np.testing.assert_array_equal(one.column("cost"), other.column("cost"))


def test_plans_lead_around_a_crash():
    changes = {"horizon": 14, "search.samples": 48, "spline.knots": 4}
    _, result = episode("Pit", **changes)
    assert result.success and np.linalg.norm(result.achieved_goals, axis=1).min() >= savers.Pit.pit
    _, blind = episode("Plane", **changes)
    assert np.linalg.norm(blind.achieved_goals, axis=1).min() < savers.Pit.pit  # the straight way leads through it


def test_a_goal_of_the_users_own_is_planned_to():
    _, result = episode("Plane", goal=(-0.8, 0.7))
    assert result.success and np.linalg.norm(result.achieved_goals[-1] - [-0.8, 0.7]) < savers.RADIUS


def test_a_coarser_model_is_refused_in_a_sentence():
    with pytest.raises(UserError, match="one physics step per control step, none to leave out"):
        session("Plane", **{"model.kind": "coarse"})


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dense")
    train(tiny("savers:Dense", reached="0.3", n_episodes=8), folder)
    return folder


def test_a_checkpoint_brings_the_success_test_of_its_training(trained):
    opened = session("Dense", checkpoint=trained, cost="distance", smooth=True, horizon=3)
    assert opened.env.unwrapped.goal_radius == 0.3
    result = opened.run_episode(0, hold=1)
    opened.close()
    assert len(result.steps) and opened.smoothing_summary()["calls"] == len(result.steps)
    with pytest.raises(UserError, match="--reached RADIUS"):
        session("Dense")
    own = session("Dense", reached="0.2")
    assert own.env.unwrapped.goal_radius == 0.2 and own.config.identity()["reached"] == "0.2"
    own.close()


def test_a_command_leaves_what_it_leaves_of_every_task(tmp_path, capsys):
    small = ["--cost", "euclidean", "--samples", "8", "--horizon", "3", "--threads", "1", "--episodes", "1"]
    found = {}
    for name in ("Plane", "Drawn"):
        out = tmp_path / name
        assert run("mppi", ["--env", f"savers:{name}", *small, "--out", str(out)]) == 0
        found[name] = json.loads((out / "summary.json").read_text())
        assert {"episodes.csv", "steps.csv", "steps.png", "distance_to_go.png"} <= {path.name for path in out.iterdir()}
    said = capsys.readouterr().out
    assert "no video: the environment does not draw itself" in said and f"video: {tmp_path}/Drawn/video.mp4" in said
    assert (tmp_path / "Drawn" / "video.mp4").stat().st_size > 0
    assert found["Plane"]["control_period_ms"] is None and found["Plane"]["keeps_control_rate"] is None
    assert found["Drawn"]["control_period_ms"] == 50.0 and said.count("pace: plans take") == 1


def test_a_controller_plans_in_what_the_library_makes():
    env = napsp.make("savers:Plane")
    observation, _ = env.reset(seed=0)
    with planners.controller("mppi", env, cost="euclidean", samples=16, horizon=6, threads=1) as controller:
        before = np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"])
        for _ in range(4):
            observation, *_ = env.step(controller.plan(observation).action)
    assert np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"]) < before - 3 * savers.FULL
    with pytest.raises(UserError, match=r"Plane is planned in by its own state as what napsp\.make makes of it"):
        planners.controller("mppi", savers.Plane(), cost="euclidean")


def test_the_studio_says_that_it_has_no_scene_to_draw():
    config = PlanConfig.of("mppi", {"env": "savers:Plane", **STRAIGHT})
    with pytest.raises(UserError, match="the studio draws MuJoCo's scenes, and savers:Plane has none"):
        open_session(Choices(config, RunOptions(threads=1)))


def test_the_viewer_is_the_environments_own_affair():
    env = envs.make("savers:Drawn", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (32, 64, 3)
