"""Bad input on the command line: one clear line, a failing exit status, no traceback."""

import subprocess
import sys

import pytest
from commands import in_this_process

from napsp.storage.files import read_tensors, write_tensors
from napsp.storage.shipped import shipped_model


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["planners.mppi", "--env", "nope"], "unknown environment 'nope'; choose one of: point_maze"),
        (["planners.icem", "--cost", "nope"], "unknown cost 'nope'; choose one of: distance"),
        (["planners.cem", "--cost", "nowhere:f"], "cannot load nowhere:f"),
        (["planners.mppi", "--cost", "shortest_path"], "the true shortest path of fetch_wall is not known"),
        (["napsp.train", "--env", "nope"], "unknown environment 'nope'"),
        (["napsp.evaluate", "--env", "nope"], "unknown environment 'nope'"),
        (["planners.mppi", "--samples", "0"], "--samples is 0; it must lie between 1"),
        (["planners.mppi", "--spline.knots", "9"], "--spline.knots 9 exceeds the horizon of 5"),
        (["planners.mppi", "--checkpoint", "nowhere"], "no checkpoint at nowhere"),
        (["planners.mppi", "--env", "point_maze_long"], "no checkpoint ships for point_maze_long"),
        (
            ["planners.mppi", "--search.noise-correlation", "1.5"],
            "--search.noise-correlation is 1.5; it must lie between 0 and 0.999",
        ),
        (["planners.mppi", "--seed", "-1"], "--seed is -1"),
        (["planners.cem", "--search.elites", "22"], "--search.elites is 22, which exceeds the 21 samples"),
        (["planners.mppi", "--temperature", "0.1"], "--temperature is now called --search.temperature"),
        (["planners.icem", "--smooth_rate=2"], "--smooth-rate is now called --smooth.rate"),
        (["planners.smooth", "--samples", "2"], "--samples means nothing to planners.smooth"),
        (["planners.mppi", "--smooth", "--smooth.multiples", "0"], "--smooth.multiples is (0.0,); give one or more"),
        (["planners.mppi", "--cost", "sparse", "--action-of", "plan"], "--action-of plan needs --cost distance"),
        (["planners.mppi", "--cost", "euclidean", "--smooth"], "--smooth needs --cost distance"),
        (["planners.mppi", "--smooth", "--low-pass", "0.5"], "--smooth and --low-pass exclude each other"),
        (["planners.mppi", "--smooth.rate", "5"], "--smooth.rate needs --smooth, which is off"),
        (["planners.mppi", "--cost", "euclidean", "--checkpoint", "a"], "--checkpoint needs --cost distance"),
        (["planners.mppi", "--spline.interpolation", "cubic"], "--spline.interpolation needs --spline.knots"),
        (["benchmarks.best_known", "--planner", "foo"], "there is no search 'foo'"),
        (["benchmarks.best_known", "--planner", "cem", "--samples", "4"], "elites is 6, which exceeds the 4 samples"),
        (
            ["benchmarks.distance_accuracy", "--methods", "plus", "--seeds", "98", "--hold", "10"],
            "measured against exact first arrivals; leave out --hold",
        ),
        (
            ["benchmarks.policy_vs_mpc", "--checkpoint", "fetch_wall_plus", "--progress", "100"],
            "--progress describes a checkpoint to train",
        ),
        (["planners.mppi", "--smooth.trust", "2"], "--smooth.trust is 2.0; it must lie between 0.05 and 1"),
        (["benchmarks.smoothing", "--planner", "nope"], "unknown planner 'nope'; choose mppi"),
        (["napsp.train", "--policy.discount", "1"], "discount is 1.0; it must lie between"),
        (["benchmarks.rollout_speed", "--samples", "0"], "--samples is 0"),
        (["benchmarks.coverage", "--env", "fetch_reach"], "point_maze and point_maze_long only"),
        (["benchmarks.coverage", "--bins", "0"], "--bins is 0; it must be at least 2"),
        (["benchmarks.distance_accuracy", "--n-starts", "0"], "--n-starts is 0; it must be at least 1"),
        (["benchmarks.policy_vs_mpc", "--seed", "-1"], "--seed is -1; it must be at least 0"),
        (["benchmarks.sweep", "--envs"], "--envs is empty; give at least one value"),
        (["planners.mppi", "--samples", "3"], "give at least 4"),
        (["benchmarks.policy_vs_mpc", "--training-episodes", "0"], "--training-episodes is 0"),
        (["benchmarks.minutes", "--minutes", "nan"], "--minutes is nan; it must be more than 0"),
        (["benchmarks.minutes", "--env", "FetchPush-v4"], "there are no published settings for FetchPush-v4"),
        (["benchmarks.policy_vs_mpc", "--budgets", "8", "2"], "a budget of 2 is too small for mppi: --samples is 2"),
        (["napsp.train", "--env", "point_maze", "--explore.held-starts", "0.5"], "point_maze has no box to hold"),
        (["napsp.train", "--her.other-goals-ratio", "0.5"], "exceed 1 together"),
        (["napsp.train", "--batch-size", "0"], "batch_size is 0; it must lie between 1"),
        (["napsp.train", "--threads", "0"], "threads is 0; it must be at least 1"),
        (
            ["napsp.train", "--env", "point_maze", "--n-episodes", "21", "--episodes-per-iteration", "7"],
            "must exceed the 21 warm-up episodes",
        ),
    ],
)
def test_bad_input_is_one_line_and_a_failing_exit_code(arguments, words, capsys, monkeypatch):
    status, said = in_this_process(*arguments, capsys=capsys, monkeypatch=monkeypatch)
    assert status == 2
    assert words in said and len(said.strip().splitlines()) == 1


@pytest.mark.parametrize("module", ["planners.icem", "napsp.train", "napsp.evaluate", "benchmarks.sweep"])
def test_bad_input_in_a_process_of_its_own(module):
    words = ["--envs"] if module == "benchmarks.sweep" else ["--env", "nope"]
    result = subprocess.run([sys.executable, "-m", module, *words], capture_output=True, text=True)
    assert result.returncode == 2 and len(result.stderr.strip().splitlines()) == 1
    assert "Traceback" not in result.stderr + result.stdout


def test_bad_checkpoints_on_the_command_line(tmp_path, capsys, monkeypatch):
    good = shipped_model("point_maze")
    truncated, foreign = tmp_path / "truncated.safetensors", tmp_path / "foreign.safetensors"
    truncated.write_bytes(good.read_bytes()[:5000])
    tensors, header = read_tensors(good, "model")
    write_tensors(foreign, tensors, {**header, "format": "other"})
    for path, env, words in (
        (truncated, "point_maze", "damaged or not a safetensors file"),
        (foreign, "point_maze", "is not a napsp model file"),
        (good, "fetch_wall", "was trained on point_maze, not on fetch_wall"),
    ):
        bad = ("planners.mppi", "--env", env, "--checkpoint", str(path))
        status, said = in_this_process(*bad, capsys=capsys, monkeypatch=monkeypatch)
        assert status == 2 and words in said and len(said.strip().splitlines()) == 1
