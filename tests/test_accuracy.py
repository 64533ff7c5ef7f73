"""The measure of distances measures: exact small cases, and the exact distance of a maze scores full marks."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import best_known, cells, distance_accuracy, maze_probe, maze_truth, tables_accuracy
from benchmarks.distance_accuracy import agreement, best_actions, figures_of, pair_figures, slope, triangles
from benchmarks.maze_probe import Probe
from napsp import envs as tasks
from napsp.config import preset
from napsp.errors import UserError


def line(n=9):
    """Places on a line, a step apart; actions -1 and 1 move; from each to each."""
    start, action, goal = (part.ravel() for part in np.meshgrid(np.arange(n), [-1.0, 1.0], np.arange(n), indexing="ij"))
    steps = 1.0 + np.abs(start + action - goal)
    column = np.arange(n, dtype=float)[:, None]
    kinds = {"right": start < goal}
    return Probe(start[:, None], action[:, None], goal[:, None], steps, kinds, start * n + goal, column, column)


def exact(observations, actions, goals):
    if actions is None:  # the best
        return np.maximum(1.0, np.abs(observations - goals)[:, 0])
    return 1.0 + np.abs(observations + np.sign(actions) - goals)[:, 0]


def test_the_truth_scores_full_marks_and_twice_the_truth_all_but_the_ratio():
    found = figures_of(line(), exact, np.random.default_rng(0))
    assert (found["spearman"], found["pearson"], found["mean_ratio"]) == pytest.approx((1, 1, 1))
    assert found["ratio_cv"] == pytest.approx(0, abs=1e-9) and found["best_action_rate"] == 1.0
    assert found["triangle_rate"] == 0 and found["distance_at_goal"] == 1 and found["slope_at_goal"] == pytest.approx(1)
    assert all(value == pytest.approx(0) for name, value in found.items() if name.startswith("mean error"))
    twice = figures_of(line(), lambda *rows: 2 * exact(*rows), np.random.default_rng(0))
    assert twice["mean_ratio"] == pytest.approx(2) and twice["mean_ratio, right"] == pytest.approx(2)
    assert twice["mean error, 0 to 5 steps"] > 2 and twice["spearman"] == pytest.approx(1)
    assert twice["slope_at_goal"] == pytest.approx(2)


def test_the_distance_of_a_pair_has_the_models_own_action():
    apart = replace(line(), steps=np.maximum(1.0, np.abs(line().observations - line().goals)[:, 0]))
    found = pair_figures(apart, exact)
    assert found["mean_ratio, own action"] == pytest.approx(1) and found["spearman, own action"] == pytest.approx(1)
    assert found["ratio_cv, right, own action"] == pytest.approx(0, abs=1e-9)
    assert figures_of(apart, exact, np.random.default_rng(0))["mean_ratio"] > 1.1, "half of the actions lead away"
    worse_to_the_left = pair_figures(apart, lambda s, a, g: exact(s, a, g) * np.where(s < g, 1.0, 2.0)[:, 0])
    assert worse_to_the_left["mean_ratio, right, own action"] == pytest.approx(1)
    assert worse_to_the_left["mean_ratio, own action"] > 1.4


def test_the_slope_is_that_of_what_is_near_the_goal():
    truth = np.array([1.0, 2, 3, 4, 5, 6, 20])
    assert slope(truth, np.array([3.0, 3.5, 4, 4.5, 5, 90, 0])) == pytest.approx(0.5)
    assert np.isnan(slope(truth[5:], truth[5:])) and np.isnan(slope(truth[:1], truth[:1]))


def test_ratio_and_correlation_by_hand():
    found = agreement(np.array([1.0, 2.0, 4.0]), np.array([2.0, 2.0, 4.0]))
    assert found["mean_ratio"] == pytest.approx(4 / 3) and found["ratio_cv"] == pytest.approx(np.sqrt(2) / 4)


def test_a_squared_distance_violates_triangles():
    probe = replace(line(), actions=np.zeros((1, 1)))

    def squared(observations, actions, goals):
        return (observations - goals)[:, 0] ** 2

    found = triangles(probe, squared, np.random.default_rng(0))
    x, y, z = np.meshgrid(*[np.arange(9.0)] * 3)
    excess = (x - z) ** 2 - (x - y) ** 2 - (y - z) ** 2
    assert found["triangle_rate"] == pytest.approx((excess > 0).mean(), abs=0.01)
    assert found["triangle_rate_step"] == pytest.approx((excess > 1).mean(), abs=0.01)


def test_the_best_action_is_sought_where_actions_differ():
    same = np.array([0, 1, 0, 1, 0, 1])
    truth = np.array([3.0, 5.0, 4.0, 5.0, 3.0, 5.0])  # of the second, all are alike
    assert best_actions(same, truth, np.array([1.0, 0, 0, 0, 2, 0]))["best_action_rate"] == 0
    found = best_actions(same, truth, np.array([1.0, 0, 2, 0, 0, 0]))
    assert found == {"best_action_rate": 1.0, "best_action_rate_by_chance": pytest.approx(2 / 3)}


def test_a_mazes_probe_is_balanced_and_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(maze_probe, "TRUTHS", tmp_path)
    asked = []

    class Search:
        def __init__(self, world, n_speeds, tolerance):
            assert n_speeds == 5 and tolerance == pytest.approx(0.1), "the task's own radius"

        def step(self, states, actions):
            asked.append(states[0])
            return states

        def steps_to(self, state, goals):
            return np.where(goals[:, 0] > 0.8, np.inf, np.round(20 * np.abs(goals[:, 0] - state[0])))

        def close(self):
            pass

    monkeypatch.setattr(maze_probe, "MazeSearch", Search)
    first = maze_probe.maze_probe("point_maze", 4, 2)
    assert len(asked) == 4 * (3 + 1 + 1 + 1), "several actions at every fourth start"
    second = maze_probe.maze_probe("point_maze", 4, 2)
    assert len(asked) == 24, "kept"
    np.testing.assert_equal(vars(first), vars(second))
    use = np.isfinite(first.steps)
    assert first.kinds["same room"].mean() == 0.25 and first.kinds["of the task"].mean() == 1 / 16
    assert use.mean() < 0.5, "most actions are not asked, and some goals never reached"
    np.testing.assert_array_equal(
        first.steps[use], 1 + np.round(20 * np.abs(first.goals[use, 0] - first.observations[use, 0]))
    )
    with pytest.raises(UserError, match="answers other questions"):
        path = next(tmp_path.iterdir())
        path.write_text(json.dumps({**json.loads(path.read_text()), "asked": "where is the milk"}))
        maze_probe.maze_probe("point_maze", 4, 2)


def test_searched_ways_are_as_fast_as_the_point_in_a_maze_of_any_size():
    for name in ("point_maze", "point_maze_long"):
        world = tasks.make(name).unwrapped
        search = maze_truth.MazeSearch(world, n_speeds=3, tolerance=world.distance_threshold / world.scale)
        start = np.array([-0.8, -0.8]) * world.scale
        ahead = np.array([min(0.65 * world.scale, 1.4), 0.0])  # a clear way in the room
        found = search.steps_to(np.concatenate([start, np.zeros(2)]), (start + ahead)[None])
        search.close()
        least = (ahead[0] - world.distance_threshold) / world.step_length
        assert least <= found[0] <= least + 2.5, "a step or two to get going, and one to end inside"


def test_ways_that_are_known_are_followed_in_the_environment(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    env = tasks.make("fetch_reach")
    seen, actions = [env.reset(seed=70_000)[0]], []
    while not env.unwrapped.reached(seen[-1]["achieved_goal"], seen[-1]["desired_goal"]):
        gap = (seen[-1]["desired_goal"] - seen[-1]["achieved_goal"]) * 10
        actions.append([*np.clip(gap, -1, 1).tolist(), 0.0])
        seen.append(env.step(np.float32(actions[-1]))[0])
    way = {"steps": len(actions), "actions": np.float32(actions).tolist()}
    best_known.FOLDER.mkdir(parents=True)
    path = best_known.FOLDER / "fetch_reach.json"
    path.write_text(json.dumps({"70000": way}))
    probe = best_known.known_probe("fetch_reach")
    np.testing.assert_array_equal(probe.steps, np.arange(len(actions), 0, -1))
    np.testing.assert_array_equal(probe.observations, [values["observation"] for values in seen[:-1]])
    np.testing.assert_array_equal(probe.kinds["from the start"], [True] + [False] * (len(actions) - 1))
    assert len(probe.places) == len(seen)
    path.write_text(json.dumps({"70000": {**way, "actions": way["actions"][:-1]}}))
    with pytest.raises(UserError, match="does not lead to its goal any more"):
        best_known.known_probe("fetch_reach")
    with pytest.raises(UserError, match="no ways are known for claw"):
        best_known.known_probe("claw")


@pytest.mark.parametrize(("hold", "steps"), [(1, 1), (2, 4), (3, 4), (4, None), (9, None)])
def test_an_arrival_is_the_first_that_is_held(hold, steps):
    passes_and_comes_back = [False, True, False, False, True, True, True, False]
    assert best_known.arrival(passes_and_comes_back, hold) == steps
    assert best_known.arrival([True] + [False] * 5, hold) is None, "a start at the goal is no arrival"


def known(monkeypatch, *arguments):
    """best_known with 16 samples and two episodes of fetch_reach."""
    monkeypatch.setattr(
        "sys.argv", ["command", "--env", "fetch_reach", "--samples", "16", "--episodes", "2", *arguments]
    )
    assert best_known.main() == 0


def test_ways_to_arrivals_that_are_held_end_where_these_begin(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known(monkeypatch, "--hold", "4")
    first, held = best_known.ways("fetch_reach"), best_known.ways("fetch_reach", 4)
    assert all(len(way["actions"]) == way["steps"] + 3 for way in held.values()) and len(held) == 2
    assert all(first[seed]["steps"] <= way["steps"] == len(way["actions"]) - 3 for seed, way in held.items())
    assert all(len(way["actions"]) == way["steps"] for way in first.values())
    probe = best_known.known_probe("fetch_reach", 4)
    assert len(probe.steps) == sum(way["steps"] for way in held.values()) and probe.steps.min() == 1
    path = best_known.path_of("fetch_reach", 4)
    path.write_text(json.dumps({seed: {**way, "actions": way["actions"][:-1]} for seed, way in held.items()}))
    with pytest.raises(UserError, match="does not lead to its goal any more"):
        best_known.known_probe("fetch_reach", 4)
    with pytest.raises(UserError, match="best_known --env claw --hold 4 looks for some"):
        best_known.known_probe("claw", 4)
    with pytest.raises(UserError, match="--hold is 51; episodes of fetch_reach have 50 steps"):
        known(monkeypatch, "--hold", "51")
    with pytest.raises(UserError, match="no episode of fetch_reach held its goal 50 steps; give a smaller --hold"):
        known(monkeypatch, "--hold", "50")
    assert not best_known.path_of("fetch_reach", 50).exists()


def test_rows_against_first_and_held_arrivals_stand_beside_each_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known(monkeypatch, "--hold", "4")
    for hold in ("1", "4", "4"):
        monkeypatch.setattr("sys.argv", ["command", "--env", "fetch_reach", "--hold", hold])
        assert distance_accuracy.main() == 0
    rows = cells.read_results(distance_accuracy.RESULTS / "distance_accuracy.csv")
    assert [(row["hold"], row["n_ways"]) for row in rows] == [("1", "2"), ("1", "2"), ("4", "2"), ("4", "2")]
    groups = tables_accuracy.accuracy_groups()
    held = ", to arrivals held 4 steps (2 ways)"
    assert [name.removesuffix(held) for _, name in groups] == ["straight line", "ours, one key"] * 2
    assert sum(name.endswith(held) for _, name in groups) == 2
    assert float(rows[0]["spearman"]) > 0.5, "on an open table, the straight line is nearly the way"
    monkeypatch.setattr("sys.argv", ["command", "--env", "point_maze", "--hold", "4"])
    with pytest.raises(UserError, match="leave out --hold"):
        distance_accuracy.main()


def test_a_model_that_ships_is_measured_against_what_is_known(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for main, *arguments in (
        (best_known.main, "--samples", "16", "--episodes", "2"),
        (distance_accuracy.main, "--json", "found.json"),
    ):
        monkeypatch.setattr("sys.argv", ["command", "--env", "fetch_wall", *arguments])
        assert main() == 0
    found = json.loads(Path("found.json").read_text())
    assert 0.5 < found["spearman"] <= 1 and found["models"] == 1
    assert {"pearson", "ratio_cv", "mean_ratio", "triangle_rate", "distance_at_goal"} <= found.keys()
    assert 0.5 < found["mean_ratio, own action"] < 3
    monkeypatch.setattr(tables_accuracy, "RESULTS", Path("results"))
    assert f" {found['mean_ratio, own action']:.2f} |" in tables_accuracy.pairs_table()[-1]
    assert "2 episodes known, 2 shorter than before" in capsys.readouterr().out


def test_models_of_other_than_the_tasks_episodes_have_a_line_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tables_accuracy, "RESULTS", tmp_path)
    whole, short = preset("point_maze", "plus"), preset("point_maze", "plus", n_episodes=300)
    trainings = ["", *(cells.as_text(config.identity()) for config in (whole, short))]
    asked = {"env": "point_maze", "n_starts": 26, "n_goals": 8, "spearman": 0.5}
    rows = [
        {**asked, "method": "plus" if training else "straight line", "training": training, "seed": seed}
        for training in trainings
        for seed in (0, 1)
    ]
    cells.replace_results(tmp_path / "distance_accuracy.csv", (), rows)
    groups = tables_accuracy.accuracy_groups()
    assert {name: len(group) for (_, name), group in groups.items()} == {
        "straight line": 2, "plus": 2, "plus, 300 episodes": 2}  # fmt: skip


def test_errors_stand_beside_how_far_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr(tables_accuracy, "RESULTS", tmp_path)
    asked = {"env": "claw", "method": "straight line", "training": "", "seed": "", "n_starts": "", "n_goals": ""}
    cells.replace_results(tmp_path / "distance_accuracy.csv", (), [
        {**asked, "mean error, 0 to 5 steps": -1.25, "mean error, 40 to inf steps": 7.0}
    ])  # fmt: skip
    lines = tables_accuracy.error_table()
    assert tables_accuracy.pairs_table()[-1].startswith("|---"), "a straight line has no action of its own"
    assert lines[-1] == "| claw | straight line | -1.2 | - | - | - | 7.0 |" and "over 40 steps" in lines[4]
