"""Shortest paths over the replay are shortest paths: against Floyd-Warshall, walls, one-way doors, luck."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import floyd_warshall

from napsp.data.episodes import Episodes
from napsp.distance.graph import GraphConfig, ReplayGraph, explained, fastest

EXACT = GraphConfig(cell=0.01, growth=1.0, occupancy=1, luck=0.0, n_lattices=2)  # a cell for each place


def exactly(achieved, goals):
    """The reward of a task whose goals have no width."""
    return -(np.abs(achieved - goals).max(1) > 1e-3).astype(np.float32)


def graph_of(config=None, reward=exactly):
    return ReplayGraph(config or GraphConfig(), reward)


MOVES = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])


def walks(allowed, n_episodes=400, length=50, size=6, seed=0, lucky=None, low=0):
    """Random walks on a grid of whole numbers, 1.5 m apart; ``allowed(here, there)`` says which moves there are."""
    rng = np.random.default_rng(seed)
    places, actions = np.empty((n_episodes, length + 1, 2)), np.empty((n_episodes, length, 2), np.float32)
    here = rng.integers(low, size, (n_episodes, 2))
    for t in range(length + 1):
        places[:, t] = here
        if t == length:
            break
        actions[:, t] = MOVES[rng.integers(4, size=n_episodes)]
        there = here + actions[:, t].astype(int)
        inside = ((there >= 0) & (there < size)).all(1)
        there = np.where((inside & [allowed(a, b) for a, b in zip(here, there, strict=True)])[:, None], there, here)
        if lucky is not None:
            from_, to, chance = lucky
            there[(here == from_).all(1) & (rng.random(n_episodes) < chance)] = to
        here = there
    rows = (1.5 * places).astype(np.float32)
    return Episodes(rows, rows, actions, rows[:, 0])


def truth(allowed, size=6):
    """Floyd-Warshall over the same moves: steps (n, n) between places in order."""
    places = [np.array((x, y)) for x in range(size) for y in range(size)]
    table = np.zeros((len(places), len(places)))
    for i, here in enumerate(places):
        for move in MOVES:
            there = here + move
            if (there >= 0).all() and (there < size).all() and allowed(here, there):
                table[i, there[0] * size + there[1]] = 1
    return np.array(places), floyd_warshall(csr_matrix(table), unweighted=True)


def everywhere(here, there):
    return True


def door(here, there):
    """A wall of no thickness between columns 2 and 3, with a door in row 0."""
    return {here[0], there[0]} != {2, 3} or here[1] == 0


def one_way(here, there):
    """The same door lets nobody back."""
    return door(here, there) and not (here[0] == 3 and there[0] == 2)


@pytest.mark.parametrize("allowed", [everywhere, door, one_way])
def test_labels_are_the_exact_distances_of_a_known_graph(allowed):
    graph, (places, steps) = graph_of(EXACT), truth(allowed)
    graph.build(walks(allowed), 0)
    n = len(places)
    assert graph.n_cells == n
    found = graph.steps(np.repeat(places, n, axis=0) * 1.5, np.tile(places, (n, 1)) * 1.5).reshape(n, n)
    np.testing.assert_array_equal(np.isnan(found), np.isinf(steps))
    np.testing.assert_allclose(found[np.isfinite(steps)], steps[np.isfinite(steps)], rtol=3e-3)  # cells have a width
    assert graph.connected == np.isfinite(steps).mean()


def test_a_wall_thinner_than_a_step_does_not_leak():
    """Cells are of the size of steps, and nobody crosses: from one side to the other it is around through the door."""
    rng, n_episodes, length = np.random.default_rng(0), 600, 50
    places = np.empty((n_episodes, length + 1, 2))
    places[:, 0] = rng.uniform(-1, 1, (n_episodes, 2))
    for t in range(length):
        there = np.clip(places[:, t] + rng.uniform(-0.15, 0.15, (n_episodes, 2)), -1, 1)
        crossed = (np.sign(there[:, 0] + 0.045) != np.sign(places[:, t, 0] + 0.045)) | (np.abs(there[:, 0]) < 0.045)
        there = np.where((crossed & (there[:, 1] < 0.7))[:, None], places[:, t], there)  # 9 cm; open above y = 0.7
        places[:, t + 1] = there
    inside = (np.abs(places[:, 0, 0]) < 0.05) & (places[:, 0, 1] < 0.7)
    rows = places[~inside].astype(np.float32)
    graph = graph_of()
    graph.build(Episodes(rows, rows, np.zeros((len(rows), length, 2), np.float32), rows[:, 0]), 0)
    left, right = np.array([[-0.15, -0.5]]), np.array([[0.15, -0.5]])
    near = np.array([[-0.15, -0.2]])
    assert graph.steps(left, near)[0] <= 4
    assert graph.steps(left, right)[0] >= 14  # 1.2 m up, 0.3 across, 1.2 m down at most 0.15 m a step is 18


def test_a_lucky_step_is_no_edge_once_much_is_known():
    """One in 400 moves from a corner lands in the far one, 10 steps away; believed, it costs what the fastest need."""
    lucky = (np.array((0, 0)), np.array((5, 5)), 1 / 400)
    episodes = walks(everywhere, 800, lucky=lucky)
    corner, far = np.zeros((1, 2)), np.full((1, 2), 7.5)
    believing, sober = graph_of(EXACT), graph_of(GraphConfig(cell=0.01, growth=1.0, occupancy=1, luck=0.01))
    believing.build(episodes, 0)
    sober.build(episodes, 0)
    assert believing.steps(corner, far) == pytest.approx(5, rel=3e-3)  # as far as five steps along both axes at once
    assert sober.steps(corner, far) == pytest.approx(10, rel=3e-3)


def test_what_nobody_saw_is_unknown():
    graph = graph_of(EXACT)
    assert np.isnan(graph.steps(np.zeros((2, 2)), np.ones((2, 2)))).all()  # nothing built
    graph.build(walks(everywhere, low=3, size=6), 0)
    inside, outside = np.array([[6.0, 6.0]]), np.array([[60.0, 6.0]])
    between = np.array([[6.7, 6.0]])  # inside the bounding box, in a cell of nobody
    assert graph.steps(inside, inside) == 0
    for strange in (outside, -outside, between):
        assert np.isnan(graph.steps(inside, strange)).all() and np.isnan(graph.steps(strange, inside)).all()


def test_without_data_enough_there_is_no_graph_and_cells_shrink_as_data_grows():
    episodes = walks(everywhere, 400)
    jitter = np.random.default_rng(0).uniform(-0.7, 0.7, episodes.achieved_goals.shape).astype(np.float32)
    places = episodes.achieved_goals + jitter
    episodes = Episodes(places, places, episodes.actions, places[:, 0])
    cells = []
    for n in (2, 20, 100, 400):
        graph = graph_of(GraphConfig(cell=0.3, growth=4.5))
        graph.build(episodes[:n], 0)
        cells.append(graph.n_cells)
        assert graph.n_cells * 20 <= n * 51
    assert cells[0] == 0 and cells[1] < cells[2] < cells[3]


def test_few_goals_are_searched_when_cells_are_many_and_the_draw_is_repeatable():
    episodes = walks(everywhere)
    first, second = (
        graph_of(GraphConfig(cell=0.01, growth=1.0, occupancy=1, n_goals=7, n_lattices=1)) for _ in range(2)
    )
    first.build(episodes, 5)
    second.build(episodes, 5)
    places = truth(everywhere)[0] * 1.5
    known = ~np.isnan(first.steps(np.repeat(places[:1], 36, axis=0), places))
    assert 3 <= known.sum() <= 7
    np.testing.assert_array_equal(known, ~np.isnan(second.steps(np.repeat(places[:1], 36, axis=0), places)))


def test_paths_are_no_faster_than_the_fastest_step_although_cells_let_them_begin_anywhere():
    """A line walked at 1 m a step at most: cells of any size would let paths gain up to an edge at each."""
    rng = np.random.default_rng(0)
    speeds = rng.choice([-1.0, -0.5, 0.5, 1.0], (400, 50))
    places = (rng.uniform(0, 30, (400, 1)) + np.cumsum(np.concatenate([np.zeros((400, 1)), speeds], 1), 1))[..., None]
    rows = places.astype(np.float32)
    graph = graph_of(GraphConfig(occupancy=5))
    graph.build(Episodes(rows, rows, np.zeros((400, 50, 1), np.float32), rows[:, 0]), 0)
    starts = rng.uniform(0, 30, (500, 1))
    goals = starts + rng.uniform(5, 20, (500, 1))
    ratio = graph.steps(starts, goals) / (goals - starts)[:, 0]
    assert graph.n_cells > 20 and 0.97 < np.nanmean(ratio) < 1.1


def test_a_goal_is_reached_wherever_the_tasks_own_test_says_so():
    """Within 1.6 m: at any of the four neighbours, one step before the place itself."""
    wide = graph_of(EXACT, lambda achieved, goals: -(np.linalg.norm(achieved - goals, axis=1) > 1.6).astype(np.float32))
    wide.build(walks(everywhere), 0)
    places, steps = truth(everywhere)
    n = len(places)
    found = wide.steps(np.repeat(places, n, axis=0) * 1.5, np.tile(places, (n, 1)) * 1.5).reshape(n, n)
    np.testing.assert_allclose(found, np.maximum(steps - 1, 0), rtol=3e-3)


def test_what_one_lattice_knows_is_known():
    config = GraphConfig(occupancy=5, n_goals=40, cell=0.3, growth=4.5)
    jitter = np.random.default_rng(0).uniform(-0.7, 0.7, (400, 51, 2)).astype(np.float32)
    rows = walks(everywhere).achieved_goals + jitter
    graph = graph_of(config)
    graph.build(Episodes(rows, rows, np.zeros((400, 50, 2), np.float32), rows[:, 0]), 0)
    goals = rows[:, 7]
    each = [~np.isnan(lattice.steps(rows[:, 0], goals)) for lattice in graph._lattices]
    known = ~np.isnan(graph.steps(rows[:, 0], goals))
    np.testing.assert_array_equal(known, np.any(each, axis=0))
    assert graph.n_cells > 40 and not np.all(each, axis=0).all()


def test_a_part_that_seldom_moves_is_as_fast_as_when_it_does():
    rows = np.zeros((1, 1001, 3), np.float32)
    rows[..., 0] = np.arange(1001)
    rows[..., 1] = np.arange(1001) > 500
    np.testing.assert_allclose(fastest(Episodes(rows, rows, np.zeros((1, 1000, 1)), rows[:, 0])), [1, 1, np.inf])


def test_goals_are_drawn_alike_from_all_cells():
    episodes = walks(everywhere)
    still = Episodes(*(np.concatenate([rows[:1]] * 2000 + [rows]) for rows in vars(episodes).values()))  # one corner
    graph = graph_of(EXACT)
    graph.build(still, 0)
    rng = np.random.default_rng(0)
    drawn = graph._lattices[0].cell(np.stack([graph.draw(rng) for _ in range(7200)]))
    counts = np.bincount(drawn, minlength=36)
    assert len(counts) == 36 and counts.min() > 140 and counts.max() < 270  # 200 each


def test_what_actions_explain_tells_positions_from_what_is_pushed():
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (40, 50, 2)).astype(np.float32)

    def achieved(change):
        return np.concatenate([np.zeros((40, 1, change.shape[-1])), change.cumsum(1)], axis=1).astype(np.float32)

    def of(change):
        rows = achieved(change)
        return explained(Episodes(rows, rows, actions, rows[:, 0]))

    noise = rng.normal(size=(40, 50, 2))
    assert of(0.1 * actions) == pytest.approx(1.0)
    assert of(actions + noise / np.sqrt(3)) == pytest.approx(0.5, abs=0.05)  # as much noise as action
    assert of(np.concatenate([actions, noise], axis=-1)) < 0.01  # one part obeys, another does not
    assert of(np.concatenate([actions, np.zeros((40, 50, 1))], axis=-1)) == pytest.approx(1.0)  # what never moves
    assert of(np.zeros((40, 50, 2))) == 0.0
