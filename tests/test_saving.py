"""States on disk: a save costs what is new, the last good one stands, those of before are read."""

import json

import numpy as np
import pytest
import torch
from tiny import content, fingerprint, learned, tiny

from benchmarks.saving import SavingOptions, measure
from napsp.data.episodes import FIELDS
from napsp.distance.counts import KeyCounts
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.run import Run
from napsp.storage import files
from napsp.storage.files import FORMAT, read_tensors, write_tensors
from napsp.storage.resume import stored_episodes, stored_tables
from napsp.storage.segments import FOLDER, file_name
from napsp.storage.state import STATE_FILE, TrainingState
from napsp.train import train

FEW = {"n_temporal_updates": 1, "n_triangular_updates": 1, "n_policy_updates": 1, "evaluate.n_episodes": 1}


def few(**changes):
    return tiny(**{**FEW, **changes})


def same(first, second):
    return fingerprint(first) == fingerprint(second)


def segments(folder, kind="*"):
    return {path.name: path for path in (folder / FOLDER).glob(f"{kind}-*")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run, and its rows."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, train(few(), folder)


def test_a_save_writes_what_is_new_and_touches_nothing_older(tmp_path, monkeypatch):
    seen, saves, save = {}, [], TrainingState.save

    def watched(self, *arguments):
        save(self, *arguments)
        for name, path in segments(tmp_path).items():
            stamp = path.stat().st_ino, path.stat().st_mtime_ns
            assert seen.setdefault(name, stamp) == stamp, "a segment never changes"
        saves.append(sum(path.stat().st_size for path in segments(tmp_path, "episodes").values()))

    monkeypatch.setattr(TrainingState, "save", watched)
    train(few(n_episodes=32), tmp_path)
    added = np.diff(saves)
    assert len(added) == 6 and added.max() == added.min(), "four episodes each, however many there are"
    state = (tmp_path / STATE_FILE).stat().st_size
    assert state < 1.05 * _state_size_of(tmp_path.parent / "short", few(n_episodes=8)), "the rest does not grow"


def _state_size_of(folder, config):
    train(config, folder)
    return (folder / STATE_FILE).stat().st_size


def test_counts_are_written_anew_before_their_files_outgrow_them(tmp_path):
    train(few(n_episodes=60, **{"counts.visit_bits": 4, "counts.pair_bits": 1, "counts.goal_cell": 3.0}), tmp_path)
    held = sum(16 * len(table) for table in stored_tables(tmp_path).values())
    listed = read_tensors(tmp_path / STATE_FILE, "training state")[1]["counts"]
    assert sum(part["size"] for part in listed) <= 2 * held and len(listed) < 10
    names = {file_name("counts", part["start"], part["end"]) for part in listed}
    assert segments(tmp_path, "counts").keys() == names
    assert stored_tables(tmp_path)["visits"].counts.sum() == 60 * 50


def test_news_are_what_was_counted_since():
    table, rng = KeyCounts(), np.random.default_rng(0)
    table.add(rng.integers(50, size=100))
    before = KeyCounts(table.keys.copy(), table.counts.copy())
    assert table.news is None
    table.watch()
    for _ in range(3):
        table.add(rng.integers(90, size=40))
    before.merge(table.news.keys, table.news.counts)
    np.testing.assert_array_equal(before.keys, table.keys)
    np.testing.assert_array_equal(before.counts, table.counts)
    table.clear()
    assert table.news is None and not len(table)


@pytest.mark.parametrize("failing", ["episodes", "counts", STATE_FILE, "model"])
def test_a_save_that_fails_leaves_the_last_state(tmp_path, monkeypatch, whole, failing):
    train(few(n_episodes=8), tmp_path)
    before, write = fingerprint(tmp_path), files.write_atomically

    def full(path, data):
        if path.name.startswith(failing):
            raise OSError(28, "No space left on device")
        write(path, data)

    monkeypatch.setattr(files, "write_atomically", full)
    with pytest.raises(OSError, match="No space left"):
        train(few(), tmp_path)
    monkeypatch.undo()
    if failing != "model":  # which is written after the state
        assert before == fingerprint(tmp_path)
    assert learned(train(few(), tmp_path)) == learned(whole[1]) and same(tmp_path, whole[0])
    assert segments(tmp_path).keys() == segments(whole[0]).keys(), "what a failed save left is gone"


def as_before(folder, **header):
    """Replace a state by one file with all of D and all counts, as they were written at first."""
    tensors, found = read_tensors(folder / STATE_FILE, "training state")
    tensors |= {f"buffer.{name}": torch.from_numpy(getattr(stored_episodes(folder), name)) for name in FIELDS}
    for name, table in stored_tables(folder).items():
        tensors |= {f"{name}.keys": torch.from_numpy(table.keys), f"{name}.counts": torch.from_numpy(table.counts)}
    for path in segments(folder).values():
        path.unlink()
    new = ("sizes", "replay", "episodes", "counts", "inherited")
    found = {name: value for name, value in found.items() if name not in new} | {"format": FORMAT} | header
    write_tensors(folder / STATE_FILE, tensors, found)


def test_a_state_of_before_goes_on(tmp_path, whole):
    train(few(n_episodes=8), tmp_path)
    before = content(tmp_path)
    as_before(tmp_path)
    after = content(tmp_path)
    assert all(np.array_equal(before[name], after[name], equal_nan=True) for name in before.keys() - {"rng"})
    assert learned(train(few(), tmp_path)) == learned(whole[1]) and same(tmp_path, whole[0])


def test_a_run_of_plus_of_before_arrivals_had_to_last_goes_on_without(tmp_path, capsys):
    plus = {"method": "plus", "episodes_per_iteration": 4, "graph.control": 1.0, "evaluate.every": 4}
    expected = train(few(**plus, **{"bootstrap.stay": 0.0}), tmp_path / "whole")
    run = Run.open(few(**plus), tmp_path / "today", False, (), Execution())
    run.close()
    assert run.learner.lasting and run.learner.agent.bootstrap.stay == 0.5, "today they have to"
    train(few(**plus, n_episodes=8, **{"bootstrap.stay": 0.0}), tmp_path / "parts")
    config = read_tensors(tmp_path / "parts" / STATE_FILE, "training state")[1]["config"]
    del config["bootstrap"]["stay"]
    as_before(tmp_path / "parts", config=config)
    train(few(**plus, n_episodes=12), tmp_path / "parts")
    assert "goes on as it was: --bootstrap.stay 0.0" in capsys.readouterr().out
    rows = train(few(**plus), tmp_path / "parts")  # and the state that it has written since says so
    assert str(learned(rows)) == str(learned(expected))
    assert json.loads((tmp_path / "parts" / "training.json").read_text())["config"]["bootstrap"]["stay"] == 0.0


def test_a_state_without_all_its_files_is_one_sentence(tmp_path):
    train(few(n_episodes=8), tmp_path)
    for name, path in segments(tmp_path).items():
        kept = path.read_bytes()
        path.unlink()
        with pytest.raises(UserError, match=f"{name} is missing, .* begin anew with --restart"):
            train(few(), tmp_path)
        path.write_bytes(kept[:-1] + bytes([kept[-1] ^ 1]))
        with pytest.raises(UserError, match=f"{name} is damaged"):
            train(few(), tmp_path)
        tensors, header = read_tensors_of(kept, tmp_path / "kept", name.partition("-")[0])
        write_tensors(path, {key: value + 1 for key, value in tensors.items()}, header)
        with pytest.raises(UserError, match=f"{name} belongs to another state"):
            train(few(), tmp_path)
        path.write_bytes(kept)
    assert train(few(), tmp_path)[-1]["episodes"] == 16


def read_tensors_of(data, path, kind):
    path.write_bytes(data)
    return read_tensors(path, kind)


def test_a_restart_begins_with_no_files_of_the_last_run(tmp_path, whole):
    train(few(n_episodes=8, seed=1), tmp_path)
    (tmp_path / FOLDER / "notes.txt").write_text("the user's own")
    train(few(), tmp_path, restart=True)
    assert segments(tmp_path).keys() == segments(whole[0]).keys() and (tmp_path / FOLDER / "notes.txt").is_file()


def test_a_finished_run_has_the_model_of_its_end_wherever_it_was_killed(tmp_path, monkeypatch, whole):
    """After the last state and before its model, the run looks finished."""
    train(few(n_episodes=8), tmp_path)
    monkeypatch.setattr(Run, "_save_model", lambda self: (_ for _ in ()).throw(SystemExit))
    with pytest.raises(SystemExit):
        train(few(n_episodes=12), tmp_path)
    monkeypatch.undo()
    train(few(n_episodes=12), tmp_path)
    assert read_tensors(tmp_path / "model.safetensors", "model")[1]["episodes"] == 12


def test_the_cost_of_a_save_is_measured(tmp_path):
    for name, capacity in (("all", None), ("few", 100)):
        (tmp_path / name).mkdir()
        rows = measure(SavingOptions(episodes=600, steps=20, every=50, capacity=capacity), tmp_path / name)
        assert [row["episodes"] for row in rows][-1] >= 600
        episodes = 50 * (21 * (25 + 3) + 20 * 4 + 3) * 4
        assert all(row["bytes"] > episodes for row in rows[1:]), "the new episodes, and the rest"
        assert rows[-1]["bytes"] < rows[1]["bytes"] + 50 * 20 * 16 * 3, "no more than the new counts are apart"
    assert rows[-1]["replay_mb"] * 2**20 < 2.1 * episodes + 2**17, "100 episodes"
