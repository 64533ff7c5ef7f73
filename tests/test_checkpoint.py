"""Files on disk: models come back as they were, damage and foreign files are named, a failed write loses nothing."""

import os

import pytest
import torch

from napsp.config import preset
from napsp.distance.network import DistanceNetwork
from napsp.errors import UserError
from napsp.policy.actors import GaussianPolicy
from napsp.storage.checkpoint import load_model, save_model
from napsp.storage.files import OLDER, read_tensors, write_atomically, write_json, write_tensors
from napsp.storage.progress import read_rows
from napsp.storage.shipped import MODEL_FILE, SHIPPED


@pytest.fixture
def saved(tmp_path):
    config, sizes = preset("point_maze", hidden=(16, 16)), (4, 2, 2)
    policy, distance = GaussianPolicy(sizes, config.hidden), DistanceNetwork(sizes, config.hidden, 50)
    path = tmp_path / MODEL_FILE
    save_model(path, policy, distance, config, sizes, 16)
    return path, distance


def test_checkpoint_round_trip(saved):
    path, distance = saved
    model = load_model(path, "point_maze")
    rows = torch.randn(5, 4), torch.randn(5, 2), torch.randn(5, 2)
    torch.testing.assert_close(model.distance(*rows), distance(*rows).detach())


def test_truncated_and_foreign_checkpoints_give_one_clear_line(saved, tmp_path):
    path, _ = saved
    content = path.read_bytes()
    for length in (0, 5, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(UserError, match="damaged or not a safetensors file"):
            load_model(path, "point_maze")
    path.write_bytes(content)
    with pytest.raises(UserError, match="was trained on point_maze, not on fetch_wall"):
        load_model(path, "fetch_wall")
    write_tensors(path, {"x": torch.zeros(1)}, {"format": "something else"})
    with pytest.raises(UserError, match="is not a napsp model file"):
        load_model(path, "point_maze")
    with pytest.raises(UserError, match="no checkpoint at"):
        load_model(tmp_path / "missing", "point_maze")


def test_a_checkpoint_of_a_task_that_is_not_at_hand_is_named_as_such(saved):
    path, _ = saved
    tensors, header = read_tensors(path, "model")
    for written in (header["format"], OLDER):
        gone = {**header, "format": written, "config": {**header["config"], "env": "gone:Task"}}
        write_tensors(path, tensors, gone)
        with pytest.raises(UserError, match="was trained on gone:Task, not on point_maze"):
            load_model(path, "point_maze")


@pytest.mark.parametrize("content", ["", "episodes,success_rate\n10,much\n", "success_rate\n0.5\n", "episodes\n1,2\n"])
def test_damaged_rows_are_one_sentence(tmp_path, content):
    path = tmp_path / "metrics.csv"
    path.write_text(content)
    if not content:
        assert read_rows(path, 10) == []
        return
    with pytest.raises(UserError, match=r"metrics.csv is damaged .*; put back a copy, or begin anew with --restart"):
        read_rows(path, 10)


def test_a_folder_is_no_file_to_write_to(tmp_path):
    with pytest.raises(UserError, match="is a folder; give the name of a file"):
        write_json(tmp_path, {})


def test_weights_that_are_not_finite_are_refused(saved):
    path, _ = saved
    tensors, header = read_tensors(path, "model")
    tensors["distance.heads.0.net.0.bias"][0] = float("nan")
    write_tensors(path, tensors, header)
    with pytest.raises(UserError, match="not finite"):
        load_model(path, "point_maze")


def test_wrong_shapes_are_refused(saved):
    path, _ = saved
    tensors, header = read_tensors(path, "model")
    tensors["policy.net.0.weight"] = torch.zeros(3, 3)
    write_tensors(path, tensors, header)
    with pytest.raises(UserError, match="does not hold the network"):
        load_model(path, "point_maze")


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_atomically(path, b"old")
    monkeypatch.setattr(os, "fsync", lambda fd: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old" and [p.name for p in tmp_path.iterdir()] == ["file"]


def test_the_episode_length_is_part_of_the_file(saved, monkeypatch):
    path, distance = saved
    monkeypatch.setattr("napsp.config.episode_length", lambda env: 400)
    rows = torch.randn(5, 4), torch.randn(5, 2), torch.randn(5, 2)
    torch.testing.assert_close(load_model(path, "point_maze").distance(*rows), distance(*rows).detach())


def test_a_file_must_say_what_it_was_trained_with(saved):
    path, _ = saved
    tensors, header = read_tensors(path, "model")
    for lost in ("episode_length", "sizes"):
        write_tensors(path, tensors, {name: value for name, value in header.items() if name != lost})
        with pytest.raises(UserError, match="does not say what sizes and which episode length"):
            load_model(path, "point_maze")
    write_tensors(path, tensors, {**header, "format": "napsp-99"})
    with pytest.raises(UserError, match=r"has format napsp-99, .* use a newer version"):
        load_model(path, "point_maze")


@pytest.mark.parametrize(
    ("name", "env", "options"),
    [
        ("point_maze", "point_maze", {"n_episodes": 1000, "episodes_per_iteration": 4, "evaluate.every": 100}),
        ("fetch_wall", "fetch_wall", {}),
    ],
)
def test_files_of_the_first_format_are_read_under_todays_names(name, env, options):
    tensors, header = read_tensors(SHIPPED / name / MODEL_FILE, "model")
    assert header["format"] == OLDER and "epsilon" in header["config"], "a file as it was written then"
    model = load_model(name, env)
    assert model.config.identity() == {**options, "env": env, "method": "ours"}
    assert model.config.explore.epsilon == pytest.approx(0.28)
    torch.testing.assert_close(model.distance.plain()[0].net[0].weight, tensors["distance.net.0.weight"])
