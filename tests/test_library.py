"""The package as a library: distances of any shape and kind, training with a callback, lazy imports."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny import TINY, learned, tiny

import napsp
from mpc.controller import Plan
from napsp import evaluate as evaluate_command
from napsp.data.outcomes import Outcomes
from napsp.errors import UserError
from napsp.policy.greedy import GreedyPolicy
from napsp.train import train as train_command

N_OBSERVATION, N_ACTION, N_GOAL = 10, 4, 3
MAZE = [1, 0, 0, 0, 1]


@pytest.fixture(scope="module")
def distance():
    return napsp.load("fetch_wall")


def points(n, seed=0):
    rng = np.random.default_rng(seed)
    env = napsp.make("fetch_wall")
    observation, _ = env.reset(seed=0)
    env.close()
    near = observation["observation"] + 0.02 * rng.normal(size=(n, N_OBSERVATION))
    return near, rng.uniform(-1, 1, (n, N_ACTION)), observation["desired_goal"] + 0.1 * rng.normal(size=(n, N_GOAL))


def test_nothing_heavy_is_imported_before_it_is_asked_for():
    code = """import sys, napsp, mpc, planners
print([m for m in ('torch', 'mujoco', 'casadi', 'scipy') if m in sys.modules])
from planners.app.command import listing
listing()
print([m for m in ('torch', 'casadi', 'scipy') if m in sys.modules])"""
    unset = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}  # a wrong one has to be tried
    command = [sys.executable, "-W", "error", "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, check=True, env=unset)
    assert (result.stdout.split(), result.stderr) == (["[]", "[]"], "")
    declared = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]["version"]
    assert napsp.__version__ == declared and set(napsp.__all__) <= set(dir(napsp))
    with pytest.raises(AttributeError, match="no attribute 'lode'"):
        napsp.lode  # noqa: B018


def test_what_a_notebook_shows_is_a_line(distance):
    assert repr(distance) == "<d(s, a, g) of fetch_wall: ours, 500 episodes, at most 50 steps>"
    reached = np.array([[False, True], [True, False], [False, False], [True, True]])
    found = Outcomes(reached, np.zeros((4, 2)))
    assert repr(found) == "<4 episodes: success 0.50 [0.15, 0.85], at the goal in some step 0.75>"
    plan = Plan(np.array([0.5, -1.0]), np.zeros((7, 2)), None, np.array([np.inf, 3.0, np.nan]), 1.0, 4.0)
    assert repr(plan) == "<plan: action [ 0.5 -1. ], 3 samples of 7 steps, the best costs 3.00, 4.0 ms>"


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.float16, torch.float32, torch.float64])
def test_a_distance_takes_and_gives_what_it_is_handed(distance, kind):
    rows = points(6)
    rows = [torch.tensor(r, dtype=kind) if isinstance(kind, torch.dtype) else r.astype(kind) for r in rows]
    batch = distance(*rows)
    wanted = distance.model.distance.steps(*(torch.as_tensor(r).float() for r in rows))
    assert batch.shape == (6,) and batch.dtype == kind and type(batch) is type(rows[0])
    np.testing.assert_allclose(np.asarray(batch, np.float64), wanted.numpy(), rtol=2e-3)
    one = distance(*(r[2] for r in rows))
    assert one.shape == () and float(one) == pytest.approx(float(batch[2]), rel=2e-3)
    grid = distance(rows[0][:, None], rows[1][:, None], rows[2][None, :3])
    assert grid.shape == (6, 3)
    np.testing.assert_allclose(float(grid[1, 2]), float(distance(rows[0][1], rows[1][1], rows[2][2])), rtol=2e-3)


def test_without_an_action_it_is_the_policys(distance):
    observations, _, goals = points(5)
    actions = distance.action(observations, goals)
    assert actions.shape == (5, N_ACTION) and distance.action(observations[0], goals[0]).shape == (N_ACTION,)
    np.testing.assert_allclose(actions, GreedyPolicy(distance.model.policy)(observations, goals), atol=1e-5)
    np.testing.assert_allclose(distance(observations, None, goals), distance(observations, actions, goals), rtol=1e-5)


def test_gradients_are_those_of_finite_differences_and_flow_through_torch(distance):
    rows = points(4)
    found = distance.gradient(*rows)
    assert [part.shape for part in found] == [(4, N_OBSERVATION), (4, N_ACTION), (4, N_GOAL)]
    network = distance.model.distance.double()
    try:
        exact = [torch.from_numpy(r) for r in rows]
        for which, part in enumerate(found):
            for k in range(part.shape[1]):
                moved = [[r.clone() for r in exact] for _ in range(2)]
                for sign, shifted in zip((1, -1), moved, strict=True):
                    shifted[which][:, k] += sign * 1e-4
                difference = (network(*moved[0]) - network(*moved[1])) / 2e-4
                np.testing.assert_allclose(part[:, k], difference, rtol=2e-2, atol=2e-2)
    finally:
        network.float()
    goals = torch.tensor(rows[2], dtype=torch.float32, requires_grad=True)
    steps = distance(torch.tensor(rows[0]), torch.tensor(rows[1]), goals)
    steps.sum().backward()
    inside = (steps < distance.episode_length).numpy()  # d itself is cut off there, and flat
    assert inside.any() and not inside.all()
    np.testing.assert_allclose(goals.grad, found.goal * inside[:, None], rtol=1e-3, atol=1e-3)


def test_wrong_shapes_are_named(distance):
    observations, actions, goals = points(4)
    with pytest.raises(ValueError, match=r"goal has shape \(4, 2\); fetch_wall wants 3"):
        distance(observations, actions, goals[:, :2])
    with pytest.raises(ValueError, match="do not fit each other"):
        distance(observations, actions, goals[:3])


def test_it_says_what_it_is_and_whose(distance):
    assert (distance.task, distance.episode_length, distance.sizes) == (
        "fetch_wall",
        50,
        (N_OBSERVATION, N_ACTION, N_GOAL),
    )
    said = distance.explain()
    assert "T = 50" in said and "--method ours" in said and "10 numbers of s" in said
    with pytest.raises(UserError, match="trained on fetch_wall, not on claw"):
        napsp.load("fetch_wall", "claw")


def test_whatever_is_a_tensor_carries_gradients_and_numpy_may_lie_in_any_order(distance):
    s, a, g = points(3)
    goal = torch.tensor(g, dtype=torch.float32, requires_grad=True)
    distance(s, a, goal).sum().backward()
    np.testing.assert_allclose(goal.grad, distance.gradient(s, a, g).goal, rtol=1e-3, atol=1e-3)
    with torch.no_grad():
        assert not distance(torch.tensor(s), torch.tensor(a), goal).requires_grad
    backwards = distance(s[::-1], a[::-1], g[::-1])
    np.testing.assert_array_equal(backwards, distance(s[::-1].copy(), a[::-1].copy(), g[::-1].copy()))
    assert distance(s, a, np.broadcast_to(g[0], g.shape)).shape == (3,)  # read-only; warnings are errors


def test_training_leaves_the_callers_random_numbers_alone(tmp_path):
    torch.manual_seed(3)
    wanted = torch.rand(2)
    torch.manual_seed(3)
    train_command(tiny(n_episodes=6), tmp_path)
    assert torch.equal(torch.rand(2), wanted)


def test_stock_tasks_take_the_options_of_their_classes():
    maze = [[1] * 5, MAZE, [1] * 5]
    usual, other = (napsp.make("PointMaze_UMaze-v3", **options) for options in ({}, {"maze_map": maze}))
    assert usual.unwrapped.model.ngeom != other.unwrapped.model.ngeom
    for option in ({"reward_type": "dense"}, {"max_episode_steps": 10}):
        with pytest.raises(UserError, match=f"leave out {next(iter(option))}"):
            napsp.make("FetchPush-v4", **option)


def test_of_a_model_whose_task_is_not_at_hand_it_is_said(tmp_path, monkeypatch):
    (tmp_path / "elsewhere_only.py").write_text(
        (Path(__file__).parent / "line.py").read_text().replace("goal=3.0", "goal=2.0")
    )
    with monkeypatch.context() as there:
        there.syspath_prepend(tmp_path)
        train_command(tiny("elsewhere_only:Line", n_episodes=6), tmp_path / "run")
        del sys.modules["elsewhere_only"]
    with pytest.raises(UserError, match=r"cannot load elsewhere_only:Line .*start the command in the folder") as error:
        napsp.load(tmp_path / "run")
    assert "retrain" not in str(error.value)


def test_the_task_of_a_checkpoint_is_the_default_of_the_command(monkeypatch, capsys, tmp_path):
    words = ["--checkpoint", "point_maze_plus", "--episodes", "1", "--out", str(tmp_path / "a.json")]
    monkeypatch.setattr("sys.argv", ["evaluate", *words])
    assert evaluate_command.main() == 0
    assert "policy on point_maze: success" in capsys.readouterr().out
    assert "mean_final_gap_m" in json.loads((tmp_path / "a.json").read_text())
    monkeypatch.setattr("sys.argv", ["evaluate", "--env", "claw", "--episodes", "1", "--out", str(tmp_path / "b.json")])
    assert evaluate_command.main() == 0 and "mean_final_gap_deg" in json.loads((tmp_path / "b.json").read_text())


def test_the_policys_success_is_that_of_the_command(monkeypatch, capsys):
    found = napsp.evaluate(napsp.load("fetch_reach"), episodes=3, seed=5)
    monkeypatch.setattr("sys.argv", ["evaluate", "--env", "fetch_reach", "--episodes", "3", "--seed", "5"])
    assert evaluate_command.main() == 0
    assert f"steps to goal {found.first_hits.mean():.1f}" in capsys.readouterr().out
    with pytest.raises(ValueError, match="at least 1"):
        napsp.evaluate(napsp.load("fetch_reach"), episodes=0)


def test_training_calls_back_stops_and_goes_on_to_what_the_command_gives(tmp_path):
    rows = []
    options = {name: value for name, value in TINY.items() if name != "n_episodes"}

    def train(**kwargs):
        return napsp.train("point_maze", episodes=TINY["n_episodes"], options=options, out=tmp_path / "run", **kwargs)

    half = train(on_evaluation=lambda row: rows.append(row) or len(rows) < 2)
    assert len(rows) == 2 and half.model.header["episodes"] == rows[-1]["episodes"] < TINY["n_episodes"]
    whole = train(on_evaluation=rows.append)
    assert learned(train_command(tiny(), tmp_path / "command")) == learned(rows)
    for name, value in napsp.load(tmp_path / "command").model.distance.state_dict().items():
        assert torch.equal(value, whole.model.distance.state_dict()[name])
    with pytest.raises(UserError, match="no option 'evry'"):
        napsp.train("point_maze", options={"graph.evry": 1}, out=tmp_path)


def test_a_sparse_model_acts_but_has_no_distance(tmp_path):
    unread = ("n_episodes", "n_temporal_updates", "n_triangular_updates")
    options = {name: value for name, value in TINY.items() if name not in unread}
    sparse = napsp.train("point_maze", "sparse", episodes=TINY["n_episodes"], options=options, out=tmp_path)
    observation, goal = np.zeros(sparse.sizes[0]), np.zeros(sparse.sizes[2])
    assert sparse.action(observation, goal).shape == (2,)
    with pytest.raises(ValueError, match="learns no distance"):
        sparse(observation, None, goal)
