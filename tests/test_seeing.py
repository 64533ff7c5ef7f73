"""What a planning command shows of itself: records per step, the control rate, the maze from above, the viewer."""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from gymnasium.envs.mujoco.mujoco_env import MujocoEnv
from gymnasium_robotics.envs.robot_env import MujocoRobotEnv

from mpc.controller import Plan
from mpc.cost import EuclideanSteps
from mpc.rollout import Trajectories
from napsp import envs
from napsp.envs.open_loop import OpenLoopEnv
from planners.app.cli import run
from planners.app.config import PlanConfig
from planners.app.frames import caption, captioned
from planners.app.maze_map import steps_field
from planners.app.options import RunOptions, parse
from planners.app.session import Session
from planners.app.video import Video

SMALL = ("--env", "point_maze", "--samples", "8", "--horizon", "4", "--no-video", "--threads", "1")
PNG = b"\x89PNG"


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_every_control_step_leaves_a_row(tmp_path):
    assert run("mppi", [*SMALL, "--episodes", "2", "--hold", "0", "--out", str(tmp_path)]) == 0
    steps, episodes = rows(tmp_path / "steps.csv"), rows(tmp_path / "episodes.csv")
    assert [(row["episode"], row["step"]) for row in steps] == [(str(e), str(t)) for e in (1, 2) for t in range(1, 51)]
    assert {"cost", "effective_samples", "plan_ms", "smoothing_ms", "gap"} <= set(steps[0])
    for row in steps:
        samples, share = float(row["effective_samples"]), float(row["effective_share"])
        assert 1 <= samples <= 8.001 and share == pytest.approx(samples / 8, rel=1e-4)
        assert 0 <= float(row["cost"]) < 200 and float(row["smoothing_ms"]) <= float(row["plan_ms"])
    for row, last in zip(episodes, steps[49::50], strict=True):
        assert float(last["gap"]) == pytest.approx(float(row["final_gap_m"]), abs=1e-5)
    median = np.median([float(row["plan_ms"]) for row in steps])
    assert json.loads((tmp_path / "summary.json").read_text())["plan_ms_median"] == pytest.approx(median, rel=1e-3)
    for name in ("steps.png", "distance_to_go.png", "distance_field.png"):
        assert (tmp_path / name).read_bytes()[:4] == PNG
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_the_cost_of_the_executed_plan_is_its_own():
    # Predictive sampling executes its best sample, whose cost is known.
    class Cheapest:
        def __init__(self):
            self.costs = []

        def frame(self, observation, plan):
            self.costs.append(plan.costs.min())

    watcher = Cheapest()
    config = PlanConfig.of("predictive_sampling", {"env": "point_maze", "search.samples": 8, "horizon": 4})
    session = Session.open(config, RunOptions(threads=1))
    result = session.run_episode(0, [watcher])
    session.close()
    np.testing.assert_allclose(result.column("cost"), watcher.costs, rtol=1e-4)
    assert result.achieved_goals.shape == (51, 2) and (result.column("effective_samples") == 1).all()


@pytest.mark.parametrize(("period", "keeps"), [(1e-6, False), (1e6, True)])
def test_whether_planning_keeps_pace_is_said_once(period, keeps, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Session, "control_period", period)
    assert run("mppi", [*SMALL, "--episodes", "2", "--out", str(tmp_path)]) == 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("pace: plans take")]
    slow = ("control period is 0.001 ms", "simulation waited", "a shorter --horizon")  # no number of samples would do
    assert all(words in said for words in (("within the control period",) if keeps else slow))
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["keeps_control_rate"] is keeps and summary["control_period_ms"] == pytest.approx(1e3 * period)


@pytest.mark.parametrize(("env", "period"), [("point_maze", 0.1), ("fetch_wall", 0.04), ("claw", 0.1)])
def test_control_periods(env, period):
    session = Session.open(PlanConfig.of("mppi", {"env": env, "cost": "euclidean"}), RunOptions(threads=1))
    assert session.control_period == pytest.approx(period)
    session.close()


def test_the_field_lies_the_right_way_round():
    goal = np.array([0.5, -0.25])
    field = steps_field(EuclideanSteps(0.1), 1.0, goal, bins=40)
    row, column = np.unravel_index(field.argmin(), field.shape)
    assert abs((column + 0.5) / 20 - 1 - goal[0]) < 0.05 and abs((row + 0.5) / 20 - 1 - goal[1]) < 0.05
    assert field[-1, 0] == pytest.approx(np.hypot(0.975 + 0.5, 0.975 + 0.25) / 0.1)  # upper left corner


@pytest.mark.parametrize(
    ("arguments", "drawn"),
    [
        ([*SMALL, "--cost", "euclidean"], True),
        ([*SMALL, "--action-of", "plan", "--horizon", "1"], True),
        ([*SMALL, "--cost", "sparse"], False),
        (["--env", "fetch_reach", "--samples", "4", "--horizon", "2", "--no-video", "--threads", "1"], False),
    ],
)
def test_the_distance_is_drawn_where_there_is_a_map_and_a_distance(arguments, drawn, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 3)
    command = [*arguments, "--episodes", "1", "--out", str(tmp_path)]
    run("mppi", command)
    capsys.readouterr()
    (tmp_path / "distance_field.png").write_bytes(b"of an older run")
    assert run("mppi", command) == 0
    picture = tmp_path / "distance_field.png"
    assert picture.exists() == drawn == ("distance field" in capsys.readouterr().out)
    assert not drawn or picture.read_bytes()[:4] == PNG


@pytest.mark.parametrize(
    ("display", "words"), [("", "needs a display (DISPLAY or WAYLAND_DISPLAY)"), (":98765", ":98765 does not answer")]
)
def test_without_a_display_the_viewer_is_refused_before_any_work(display, words, tmp_path):
    command = [sys.executable, "-m", "planners.mppi", *SMALL, "--render", "human", "--out", str(tmp_path / "out")]
    environment = {**os.environ, "DISPLAY": display, "WAYLAND_DISPLAY": ""}
    result = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert result.returncode == 2 and words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1 and result.stdout == ""
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "name", ["point_maze", "claw", "fetch_reach", "FetchPush-v4", "PointMaze_UMaze-v3", "AntMaze_UMaze-v5"]
)
def test_in_human_mode_reset_and_every_step_are_drawn(name, monkeypatch):
    frames = []
    for kind in (OpenLoopEnv, MujocoRobotEnv, MujocoEnv):
        monkeypatch.setattr(kind, "render", lambda env: frames.append(env.data.time))
    env = envs.make(name, render_mode="human")
    env.reset(seed=0)
    assert len(frames) == 1
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape, np.float32))
    assert len(frames) == 4 and frames == sorted(frames)
    env.close()


def test_watching_does_not_change_how_plans_are_made():
    assert parse("mppi", ["--render", "human", "--no-video"])[0] == parse("mppi", [])[0] == PlanConfig.of("mppi")


def test_videos_of_stock_mazes_show_the_agent_and_hide_the_stock_goal(tmp_path):
    env = envs.make("PointMaze_UMaze-v3")
    video = Video(tmp_path / "video.mp4", env.unwrapped)
    alpha = {video._model.site(i).name: video._model.site_rgba[i, 3] for i in range(video._model.nsite)}
    video.close()
    env.close()
    assert alpha["target"] == 0 and alpha["particle_site"] > 0


def test_stock_robots_have_room_for_a_video(tmp_path):
    env = envs.make("FetchReach-v4")  # its model's own buffer is 480 wide
    video = Video(tmp_path / "video.mp4", env.unwrapped)
    assert video._model.vis.global_.offwidth >= 640 and env.unwrapped.model.vis.global_.offwidth == 480
    assert "framebuffer" not in video.close()
    env.close()


@pytest.mark.parametrize("name", ["fetch_wall", "AntMaze_UMaze-v5"])
def test_lines_of_plans_grow_with_the_distance_they_are_seen_from(name, tmp_path, monkeypatch):
    env = envs.make(name)
    world, widths = env.unwrapped, []
    monkeypatch.setattr(Video, "_segment", lambda video, start, end, width, color: widths.append(width))
    video = Video(tmp_path / "video.mp4", world)
    goals = np.zeros((2, 3, *world.observation_space["achieved_goal"].shape))
    trajectories = Trajectories(goals, goals, np.zeros(2, bool))
    actions = np.zeros((3, *world.action_space.shape), np.float32)
    video._draw_plans(Plan(actions[0], actions, trajectories, np.array([1.0, 2.0]), 2.0, 0.0, 0.0))
    distance = video._camera.distance
    video.close()
    env.close()
    pixels = np.array(widths) / (2 * distance * np.tan(np.deg2rad(world.model.vis.global_.fovy / 2))) * 480
    assert len(widths) == 4 and 1.0 < pixels.min() < pixels.max() < 5.0


@pytest.mark.parametrize(
    ("name", "words"), [("fetch_wall", "gap 25 cm"), ("claw", "gap 90 deg"), ("point_maze", "gap 25 cm")]
)
def test_frames_say_how_far_it_is_in_units_of_the_task_and_what_the_cheapest_plan_costs(name, words, worlds):
    far = {"fetch_wall": [0.0, 0.0, 0.25], "claw": [0.0, 1.0], "point_maze": [0.0, 0.25]}[name]
    desired = np.array([1.0, 0.0] if name == "claw" else np.zeros(len(far)))
    seen = {"achieved_goal": np.array(far), "desired_goal": desired}
    plan = Plan(np.zeros(2), np.zeros((7, 2)), None, np.array([np.inf, 3.456, np.nan, 9.0]), 1.0, 4.0)
    assert caption(worlds[name], seen, plan) == f"{words}   cheapest plan 3.46"
    lost = Plan(np.zeros(2), np.zeros((7, 2)), None, np.array([np.inf, np.nan]), 1.0, 4.0)
    assert caption(worlds[name], seen, lost) == words


def test_a_caption_is_written_on_top_of_the_picture_and_nowhere_else():
    before = np.full((480, 640, 3), 200, np.uint8)
    after = captioned(before, "gap 3.4 cm")
    changed = (after != before).any(-1)
    assert after.shape == before.shape and after.dtype == before.dtype and (before == 200).all()
    assert {0, 255} <= set(np.unique(after[changed])) and changed[:30, :120].sum() == changed.sum() > 100
