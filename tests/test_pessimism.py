"""Pessimistic distances: U of eq. 2 from the counts in a model file, and the maximum of an ensemble."""

import json

import numpy as np
import pytest
import torch
from tiny import tiny

from mpc.cost import LearnedSteps
from napsp.distance.counts import uncertainty
from napsp.errors import UserError
from napsp.storage.checkpoint import load_model
from napsp.storage.files import read_tensors, write_tensors
from napsp.storage.resume import stored_episodes, stored_tables
from napsp.storage.shipped import MODEL_FILE, shipped_model
from napsp.train import train
from planners.app.cli import run
from planners.app.config import PlanConfig

GOAL = np.array([0.5, 0.5])


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folders of two tiny runs on the maze and one of the sparse baseline."""
    folders = {}
    for name, changes in (("a", {}), ("b", {"seed": 1}), ("sparse", {"method": "sparse"})):
        folders[name] = tmp_path_factory.mktemp(name)
        train(tiny(**changes), folders[name])
    return folders


def visited(folder, n=200):
    """Some states, achieved goals and actions of the run's own episodes, which were counted."""
    episodes = stored_episodes(folder)
    states = episodes.observations[:, :-1].reshape(-1, 4)[:n].copy()
    return states, states[:, :2], episodes.actions.reshape(-1, 2)[:n]


def test_a_model_file_keeps_the_visit_counts(trained):
    states, _, actions = visited(trained["a"])
    counted = stored_tables(trained["a"])["visits"]
    model = load_model(trained["a"], "point_maze")
    assert model.visits.table.counts.sum() == 16 * 50, "every step of every episode"
    np.testing.assert_array_equal(model.visits.table.keys, counted.keys)
    np.testing.assert_array_equal(model.visits.table.counts, counted.counts)
    assert (model.visits(states, actions) >= 1).all(), "a key moved"
    assert read_tensors(trained["a"] / MODEL_FILE, "model")[0]["visits.keys"].dtype == torch.int32
    assert load_model(trained["sparse"], "point_maze").visits is None


def test_pessimism_adds_uncertainty_in_steps(trained):
    model = load_model(trained["a"], "point_maze")
    states, achieved, actions = visited(trained["a"])
    states[0] = 30.0  # never visited
    plain, charged = (LearnedSteps(model, weight)(states, achieved, actions, GOAL) for weight in (0.0, 0.5))
    bonus = uncertainty(model.visits(states, actions), 10.0, 0.5)
    np.testing.assert_allclose(charged - plain, 0.5 * bonus, atol=1e-9)
    assert bonus[0] == 10.0 > bonus[1:].max(), "N = 0 costs C"
    chosen = model.policy.mode(torch.from_numpy(states), torch.tensor(GOAL).float().expand(len(states), 2))
    asked = [LearnedSteps(model, 0.5)(states, achieved, a, GOAL) for a in (None, chosen.numpy())]
    np.testing.assert_allclose(*asked, atol=1e-4)


def test_an_ensemble_takes_the_largest_distance_at_the_main_policys_action(trained):
    models = [load_model(trained[name], "point_maze") for name in "ab"]
    states, achieved, _ = visited(trained["a"])
    chosen = models[0].policy.mode(torch.from_numpy(states), torch.tensor(GOAL).float().expand(len(states), 2)).numpy()
    alone = [LearnedSteps(model)(states, achieved, chosen, GOAL) for model in models]
    joint = LearnedSteps(models[0], ensemble=models[1:])(states, achieved, None, GOAL)
    np.testing.assert_allclose(joint, np.maximum(*alone), atol=1e-4)
    assert (alone[0] != alone[1]).any()
    np.testing.assert_array_equal(
        LearnedSteps(models[0], ensemble=models[:1])(states, achieved, chosen, GOAL), alone[0], "a copy changes nothing"
    )


def test_files_without_counts_plan_as_before(trained, tmp_path):
    tensors, header = read_tensors(trained["a"] / MODEL_FILE, "model")
    older = tmp_path / MODEL_FILE
    write_tensors(older, {k: v for k, v in tensors.items() if not k.startswith("visits.")}, header)
    model = load_model(older, "point_maze")
    assert model.visits is None and LearnedSteps(model)(*visited(trained["a"])[:2], None, GOAL).shape == (200,)
    with pytest.raises(ValueError, match="no visit counts"):
        LearnedSteps(model, 1.0)


def test_damaged_counts_are_refused(trained, tmp_path):
    tensors, header = read_tensors(trained["a"] / MODEL_FILE, "model")
    path = tmp_path / MODEL_FILE
    for change in (
        {"visits.keys": tensors["visits.keys"].flip(0)},
        {"visits.counts": tensors["visits.counts"][1:]},
        {"visits.projection": tensors["visits.projection"][1:]},
        {"visits.projection": torch.full_like(tensors["visits.projection"], float("nan"))},
        {"visits.projection": tensors["visits.projection"][:, :8]},
        {"visits.projection": tensors["visits.projection"].bfloat16()},
        {"visits.counts": torch.full(tensors["visits.counts"].shape, float("nan"))},
        {"visits.keys": tensors["visits.keys"] + 0.4},
        {"visits.keys": tensors["visits.keys"] - 2**20},
        {"visits.keys": None, "visits.counts": None},
    ):
        damaged = {name: tensor for name, tensor in {**tensors, **change}.items() if tensor is not None}
        write_tensors(path, damaged, header)
        with pytest.raises(UserError, match="does not hold visit counts that fit"):
            load_model(path, "point_maze")


def test_both_plan_on_the_command_line(trained, tmp_path, monkeypatch):
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 3)
    arguments = ["--env", "point_maze", "--episodes", "1", "--samples", "8", "--no-video", "--threads", "1"]
    arguments += [
        "--checkpoint",
        str(trained["a"]),
        "--distance.pessimism",
        "0.5",
        "--distance.ensemble",
        str(trained["b"]),
    ]
    assert run("mppi", [*arguments, "--out", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    distance = summary["config"]["distance"]
    assert distance["pessimism"] == 0.5 and distance["ensemble"] == [str(trained["b"])]
    assert {"distance.pessimism": 0.5, "distance.ensemble": 1}.items() <= summary["differences"].items()
    assert [member["config"]["seed"] for member in summary["ensemble"]] == [1]


def test_impossible_wishes_are_one_clear_line(trained, tmp_path):
    for arguments, words in (
        (
            ["--distance.pessimism", "1"],
            "--distance.pessimism needs visit counts.*train one with.*or use --dist",
        ),
        (["--distance.ensemble", str(shipped_model("claw"))], "was trained on claw, not on point_maze"),
        (["--distance.ensemble", str(trained["sparse"])], "of --distance.ensemble holds no distance"),
        (["--distance.ensemble", str(tmp_path / "nowhere")], "no checkpoint at"),
        (["--cost", "euclidean", "--distance.pessimism", "1"], "--distance.pessimism needs --cost distance"),
        (["--cost", "euclidean", "--distance.ensemble", "x"], "--distance.ensemble needs --cost distance"),
        (["--distance.pessimism", "-1"], "--distance.pessimism is -1.0; it must lie between"),
    ):
        with pytest.raises(UserError, match=words) as error:
            run("mppi", ["--env", "point_maze", "--no-video", "--out", str(tmp_path), *arguments])
        assert "\n" not in str(error.value)


def test_the_identity_counts_members_but_not_their_paths(tmp_path):
    first, second = (PlanConfig.of("mppi", {"distance.ensemble": (tmp_path / name,)}).identity() for name in "ab")
    assert first == second == {"horizon": 5, "distance.ensemble": 1}
    assert PlanConfig.of("mppi", {"distance.pessimism": 0.5}).identity() == {"horizon": 5, "distance.pessimism": 0.5}
