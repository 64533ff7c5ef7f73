"""The learner that trains the networks, on a table with exact counts, against Floyd-Warshall."""

import numpy as np
import pytest
import torch
from scipy.stats import spearmanr
from tabular import ExactCounts, GridWorld, TabularDistance

from napsp.config import preset
from napsp.data.buffer import EpisodeBuffer
from napsp.learner import Learner

N_ITERATIONS, WALKS = 250, 10


def learned(method="ours", n_iterations=N_ITERATIONS, **changes):
    """Algorithm 1 on random walks: the methods of the very Learner that trains networks."""
    world, rng = GridWorld(), np.random.default_rng(0)
    options = {"uncertainty.scale": 30.0, "uncertainty.power": 2.0, **changes}
    config = preset("point_maze", method, changes=options, batch_size=2048, n_temporal_updates=20,
                    n_triangular_updates=1)  # fmt: skip
    assert config.episode_length == world.length
    buffer, counts = EpisodeBuffer(), ExactCounts(world)
    buffer.extend(world.random_episodes(WALKS, rng))
    counts.update(buffer.episodes())
    distance = TabularDistance(world, start=float(world.length))
    learner = Learner(config, distance, counts, None, buffer, None, rng, torch.Generator())
    for _ in range(n_iterations):
        recent = world.random_episodes(WALKS, rng)
        learner.counts.update(recent)
        learner.train_temporal(recent)
        learner.update_target()
        if method == "ours":
            learner.train_triangular(recent)
        learner.extend_buffer(recent)
    return world.shortest_paths(), distance.values.numpy()


def test_equations_4a_and_4b_recover_floyd_warshall():
    truth, found = learned()
    assert spearmanr(truth.ravel(), found.ravel()).statistic >= 0.98
    assert 0.97 <= (found / truth).mean() <= 1.25
    assert (found >= truth - 1e-3).all(), "labels are lengths of ways that exist: nothing falls below the shortest"
    adjacent = truth == 1.0
    np.testing.assert_allclose(found[adjacent], 1.0, atol=0.05)


def test_without_bootstrapping_d_is_the_mean_of_what_walks_took():
    truth, found = learned(method="ddl", n_iterations=60)
    assert (found / truth).mean() > 2.0, "random walks take far longer than shortest paths"


@pytest.mark.parametrize("walls", ["...", ".#."])
def test_floyd_warshall_knows_walls(walls):
    world = GridWorld("\n".join(" ".join(row) for row in ("...", walls, "...")))
    truth = world.shortest_paths()
    np.testing.assert_array_equal(truth.min(1)[0, -1], 4.0)
    assert (truth[1, 2].max() < 5) or walls == ".#."
