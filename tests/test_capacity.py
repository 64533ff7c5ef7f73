"""A replay of bounded size: the oldest episodes go first, and all else stays exact."""

import numpy as np
import pytest
from test_data import numbered
from test_saving import few, same, segments
from tiny import learned

from napsp.data.buffer import EpisodeBuffer
from napsp.errors import UserError
from napsp.storage.resume import stored_episodes, stored_tables
from napsp.train import train


def test_the_oldest_go_first_in_arrays_of_bounded_size():
    buffer, sizes = EpisodeBuffer(), set()
    for first in range(0, 3000, 3):
        buffer.extend(numbered(first, 3))
        buffer.forget(100)
        held = buffer.episodes()
        sizes.add(len(held.observations.base))
        np.testing.assert_array_equal(held.observations[:, 0, 0], 100.0 * np.arange(max(0, first - 97), first + 3))
        np.testing.assert_array_equal(buffer.episodes(5).actions, held.actions[-5:])
    assert max(sizes) <= 210 and (len(buffer), buffer.n_seen, buffer.n_steps) == (100, 3000, 18000)
    buffer.forget(None)
    assert len(buffer) == 100


@pytest.mark.parametrize(
    "changes",
    [
        {"replay_capacity": 6},
        {"replay_capacity": 5, "rescale": True, "method": "sparse"},
        {"replay_capacity": 8, "method": "plus", "episodes_per_iteration": 4, "n_episodes": 40, "graph.every": 3,
         "graph.occupancy": 5},
    ],
)  # fmt: skip
def test_a_run_that_forgets_resumes_to_the_same_result(tmp_path, changes):
    config = few(**changes)
    whole = train(config, tmp_path / "whole")
    for n in (config.n_episodes // 2, config.n_episodes):
        parts = train(few(**{**changes, "n_episodes": n}), tmp_path / "parts")
    assert learned(parts) == learned(whole) and same(tmp_path / "parts", tmp_path / "whole")
    capacity = config.replay_capacity + config.graph.every * config.episodes_per_iteration * (config.method == "plus")
    assert config.replay_capacity <= len(stored_episodes(tmp_path / "whole")) <= capacity < config.n_episodes
    if config.method == "plus":
        assert whole[-1]["n_cells"] > 0
    if not config.rescale:
        n_counted = stored_tables(tmp_path / "whole")["visits"].counts.sum()
        assert n_counted == config.n_episodes * config.episode_length, "counts stay"


def test_files_of_what_is_forgotten_go_but_for_the_warm_up(tmp_path):
    train(few(replay_capacity=6, n_episodes=40), tmp_path)
    names = sorted(segments(tmp_path, "episodes"))
    assert names[0] == "episodes-00000000-00000004.safetensors" and len(names) == 3
    assert len(stored_episodes(tmp_path)) == 6


def test_a_replay_holds_the_warm_up_at_least():
    with pytest.raises(UserError, match="replay_capacity is 3; it must hold the 4 warm-up episodes"):
        few(replay_capacity=3)
