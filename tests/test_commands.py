"""The commands as a user types them: results on disk, one clear line for bad input, layering."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import in_this_process
from gymnasium import spaces
from scipy.stats import binomtest
from tiny import tiny

from napsp import envs
from napsp.errors import UserError
from napsp.statistics import wilson_interval
from napsp.storage.checkpoint import load_model
from napsp.storage.shipped import MODEL_FILE, shipped_model
from napsp.train import train
from planners.app.cli import run

SHIPPED = ("point_maze", "fetch_reach", "fetch_wall", "claw", "fetch_pick_place", "fetch_pick_place_wall")


def command(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=240,
    )


def test_main_job(tmp_path):
    result = command("planners.mppi", "--env", "fetch_wall", "--episodes", "1", "--out", str(tmp_path / "out"))
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert "mppi on fetch_wall" in result.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    expected = (
        "env planner cost episodes success_rate any_success_rate mean_steps_to_goal plan_ms_median "
        "seed config differences run revision"
    )
    assert set(expected.split()) <= set(summary)
    assert summary["env"] == "fetch_wall" and summary["episodes"] == 1 and summary["success_rate"] == 1.0
    with open(tmp_path / "out" / "episodes.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 1 and rows[0]["seed"] == "90000"
    assert (tmp_path / "out" / "distance_to_go.png").read_bytes()[:4] == b"\x89PNG"
    video = tmp_path / "out" / "video.mp4"
    assert video.is_file() or "no video" in result.stdout
    assert not video.is_file() or video.stat().st_size > 10_000


def test_without_gl_there_is_one_line_instead_of_a_video(tmp_path):
    arguments = ("--env", "point_maze", "--episodes", "1", "--samples", "8", "--out", str(tmp_path))
    result = command("planners.mppi", *arguments, MUJOCO_GL="disable")
    assert result.returncode == 0, result.stderr
    assert sum("no video" in line for line in result.stdout.splitlines()) == 1
    assert not (tmp_path / "video.mp4").exists() and (tmp_path / "summary.json").is_file()


@pytest.mark.parametrize("cost", ["euclidean", "sparse"])
def test_a_cost_without_distance_needs_no_checkpoint(cost, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("napsp.storage.shipped.SHIPPED", tmp_path / "nothing")
    arguments = ["--env", "point_maze_long", "--cost", cost, "--episodes", "1", "--samples", "8", "--no-video"]
    assert run("mppi", [*arguments, "--out", str(tmp_path / "out")]) == 0
    assert "no checkpoint" in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["checkpoint"] is None


def test_same_seed_same_result(tmp_path):
    for name in ("a", "b"):
        arguments = ["--env", "point_maze", "--episodes", "2", "--samples", "16", "--no-video", "--seed", "5"]
        run("mppi", [*arguments, "--out", str(tmp_path / name), "--threads", "1" if name == "a" else "2"])
    first, second = (
        [row[:5] for row in csv.reader((tmp_path / name / "episodes.csv").read_text().splitlines())]
        for name in ("a", "b")
    )
    assert first == second


@pytest.mark.parametrize(
    "options",
    [
        ["--spline.knots", "3", "--spline.interpolation", "cubic"],
        ["--action-of", "plan"],
        ["--action-of", "plan", "--horizon", "1"],
        ["--no-proposals"],
        ["--proposals", "--spline.knots", "4"],
        ["--low-pass", "0.6"],
        ["--smooth", "--action-of", "plan", "--horizon", "1"],
        ["--smooth", "--spline.knots", "4", "--smooth.solver", "ipopt", "--where", "terminal"],
    ],
)
def test_options_run(options, tmp_path):
    arguments = ["--env", "point_maze", "--episodes", "1", "--samples", "8", "--no-video", "--out", str(tmp_path)]
    assert run("mppi", [*arguments, *options]) == 0


@pytest.mark.parametrize("planner", ["mppi", "cem", "icem", "predictive_sampling", "smooth"])
def test_every_planner_can_smooth_and_reports_it(planner, tmp_path, capsys):
    arguments = [
        "--env",
        "point_maze",
        "--episodes",
        "1",
        "--horizon",
        "6",
        "--hold",
        "0",
        "--no-video",
        "--out",
        str(tmp_path),
    ]
    assert run(planner, [*arguments, *([] if planner == "smooth" else ["--smooth"])]) == 0
    assert "plans accepted" in " ".join(capsys.readouterr().out.split())
    summary = json.loads((tmp_path / "summary.json").read_text())
    smoothing = summary["smoothing"]
    assert (
        smoothing["calls"] == 50
        and smoothing["accepted_share"] > 0.2
        and smoothing["risen"] == smoothing["solver_failures"] == 0
    )
    assert smoothing["linearise_ms"] > 0 and smoothing["solve_ms"] > 0 and smoothing["verify_ms"] > 0
    with open(tmp_path / "episodes.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert float(row["action_rate"]) == pytest.approx(summary["mean_action_rate"], abs=1e-5)
    assert float(row["jerk"]) > 0 and float(row["smoothing_ms_median"]) > 0


@pytest.mark.parametrize(("body", "words"), [
    ("raise KeyError('wall')", "failed with KeyError: 'wall' (my_cost.py, line 5); correct the function"),
    ("return achieved", "returned shape (512, 2) for 512 goals; return a number per goal"),
    ("return 'far'", "returned str; return one number per goal"),
])  # fmt: skip
def test_a_cost_of_ones_own_that_fails_is_named_and_leaves_no_video(body, words, tmp_path, monkeypatch, capsys):
    late = "    calls.append(goal)\n    if len(calls) > 8 and len(achieved) == 512:"  # after some frames of the video
    text = f"calls = []\ndef steps(achieved, goal):\n{late}\n        {body}\n    return 0.0 * achieved[:, 0]\n"
    (tmp_path / "my_cost.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_cost", raising=False)
    arguments = ("--env", "point_maze", "--cost", "my_cost:steps", "--out", str(tmp_path / "out"))
    status, said = in_this_process("planners.mppi", *arguments, capsys=capsys, monkeypatch=monkeypatch)
    assert status == 2 and words in said and len(said.strip().splitlines()) == 1
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("arguments", [["my_task:Env"], ["point_maze", "--cost", "my_task:steps"]])
def test_a_module_of_ones_own_that_fails_is_named(arguments, tmp_path, monkeypatch, capsys):
    (tmp_path / "my_task.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_task", raising=False)  # one of other tests
    status, said = in_this_process("planners.mppi", "--env", *arguments, capsys=capsys, monkeypatch=monkeypatch)
    assert status == 2 and "cannot load my_task" in said
    assert "ZeroDivisionError" in said and "Traceback" not in said


def test_a_checkpoint_of_another_version_of_a_task_is_refused():
    class Wider:
        observation_space = envs.make("point_maze").observation_space
        action_space = spaces.Box(-1.0, 1.0, (3,))

    model = load_model(shipped_model("point_maze"), "point_maze")
    model.check_sizes(envs.make("point_maze"))
    with pytest.raises(UserError, match=r"trained with \(4, 2, 2\).* has \(4, 3, 2\) now; train it again"):
        model.check_sizes(Wider())


def test_nan_goal_is_one_clear_line(tmp_path, capsys):
    from napsp.errors import UserError

    for goal in (["nan", "0.5"], ["0.1"]):
        with pytest.raises(UserError, match="--goal"):
            run("mppi", ["--env", "point_maze", "--no-video", "--out", str(tmp_path), "--goal", *goal])


def test_a_given_goal_is_used(tmp_path):
    arguments = ["--env", "point_maze", "--episodes", "1", "--cost", "euclidean", "--no-video", "--out", str(tmp_path)]
    run("mppi", [*arguments, "--goal", "-0.5", "-0.5"])  # in the start room: no wall between
    assert json.loads((tmp_path / "summary.json").read_text())["success_rate"] == 1.0


@pytest.mark.parametrize("env", SHIPPED)
def test_shipped_checkpoints_tell_where_they_come_from(env):
    folder = shipped_model(env).parent
    model = load_model(folder / MODEL_FILE, env)
    record = json.loads((folder / "training.json").read_text())
    assert record["command"].startswith(f"python -m napsp.train --env {env}")
    assert model.header["revision"] in record["revision"].split(", ")  # a resumed run names all its revisions
    assert record["seed"] == model.config.seed
    with open(folder / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["episodes"]) == model.header["episodes"]
    assert (folder / "training_curve.png").read_bytes()[:4] == b"\x89PNG"


def test_a_distance_that_smoothing_cannot_write_out_plans_without_it(tmp_path):
    train(tiny(**{"distance.head": "quasimetric"}), tmp_path / "run")
    arguments = ["--env", "point_maze", "--checkpoint", str(tmp_path / "run"), "--episodes", "1", "--samples", "8"]
    arguments += ["--no-video", "--out", str(tmp_path / "plans")]
    with pytest.raises(UserError, match="--smooth needs a distance of plain networks"):
        run("mppi", [*arguments, "--smooth"])
    assert run("mppi", arguments) == 0


def test_a_shipped_checkpoint_has_a_name(tmp_path, monkeypatch):
    named = load_model("fetch_pick_place_first_arrival", "fetch_pick_place")
    assert named.config.temporal.first_arrival
    assert not load_model("fetch_pick_place", "fetch_pick_place").config.temporal.first_arrival
    monkeypatch.chdir(tmp_path)  # a file or folder of the user's own comes first
    Path("fetch_pick_place_first_arrival").mkdir()
    with pytest.raises(UserError, match="no checkpoint at"):
        load_model("fetch_pick_place_first_arrival", "fetch_pick_place")


def test_evaluate_runs_the_shipped_policy(tmp_path, capsys, monkeypatch):
    out = tmp_path / "e.json"
    arguments = ("--env", "fetch_wall", "--episodes", "4", "--out", str(out))
    status, said = in_this_process("napsp.evaluate", *arguments, capsys=capsys, monkeypatch=monkeypatch)
    assert not status and not said and json.loads(out.read_text())["success_rate"] == 1.0


def test_wilson_interval_against_the_textbook_and_scipy():
    np.testing.assert_allclose(wilson_interval(8, 10), (0.4901625, 0.9433178), atol=1e-6)
    for successes, n in [(successes, total) for total in (1, 3, 50) for successes in range(total + 1)]:
        wanted = binomtest(successes, n).proportion_ci(method="wilson")
        np.testing.assert_allclose(wilson_interval(successes, n), (wanted.low, wanted.high), rtol=0, atol=1e-14)
