"""Explorers go on where they were, are as many as they should be, and are resumed exactly."""

from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit
from line import Line
from tiny import learned, tiny

from napsp import envs as tasks
from napsp.data.collect import roll
from napsp.data.episodes import concatenate
from napsp.data.explorers import Explorers, Ongoing, RoleActor
from napsp.execution import Execution
from napsp.run import Run, new_learner
from napsp.train import train


def ongoing(env="point_maze"):
    return Ongoing(tasks.make(env), 25)


def test_an_explorers_episode_begins_where_the_last_one_ended():
    worlds, rng = [ongoing(), ongoing()], np.random.default_rng(0)
    worlds[1].goal = np.array([0.3, -0.4])

    def act(observations, goals):
        return rng.uniform(-1, 1, (2, 2)).astype(np.float32)

    first, second = (roll(worlds, act, [1, 2], 70) for _ in range(2))  # longer than the task's time limit
    np.testing.assert_array_equal(first.observations[:, -1], second.observations[:, 0])
    np.testing.assert_array_equal(second.desired_goals[1], np.float32([0.3, -0.4]))
    assert (np.abs(np.diff(second.achieved_goals, axis=1)).max(2) < 0.11).all()


@pytest.mark.parametrize("env", ["point_maze", "fetch_wall"])
def test_an_explorer_restored_goes_on_to_the_bit(env):
    actions = np.random.default_rng(0).uniform(-1, 1, (60, tasks.make(env).action_space.shape[0])).astype(np.float32)
    world, other = ongoing(env), ongoing(env)
    world.reset(seed=3)
    for action in actions[:30]:
        world.step(action)
    other.restore(world.state())
    np.testing.assert_equal(other.reset()[0], world.reset()[0])
    for action in actions[30:]:
        found, expected = other.step(action)[0], world.step(action)[0]
        for name in ("observation", "achieved_goal"):
            np.testing.assert_array_equal(found[name], expected[name])


class Named(Line):
    """An environment of the user's own with a member that our tasks have as well."""

    dynamics = "single integrator"


def test_a_name_in_common_does_not_make_a_world_one_of_mujocos():
    world = Ongoing(TimeLimit(Named(), 8), 100)
    world.reset(seed=0)
    world.step(np.ones(1, np.float32))
    assert world.last is not None and set(world.state()) == {"n_episodes"}


def more(subject, n):
    """Any n episodes."""
    return concatenate([subject.buffer.episodes()[:1]] * n)


def test_now_and_then_an_explorer_begins_anew():
    world, places = Ongoing(tasks.make("point_maze"), 3), []
    for seed in range(7):
        places.append(world.reset(seed=seed)[0]["achieved_goal"])
        for _ in range(5):
            world.step(np.ones(2, np.float32))
    fresh = [tasks.make("point_maze").reset(seed=seed)[0]["achieved_goal"] for seed in range(7)]
    assert [np.array_equal(a, b) for a, b in zip(places, fresh, strict=True)] == [True, False, False] * 2 + [True]


def test_walkers_walk_and_seekers_follow_the_policy_for_half_an_episode():
    actor = RoleActor(lambda s, g: np.zeros((3, 1)), lambda s, g: np.ones((3, 1)), ["policy", "walk", "seek"], 6)
    found = np.array([actor(None, None)[:, 0] for _ in range(6)])
    np.testing.assert_array_equal(found.T, [[0] * 6, [1] * 6, [0, 0, 0, 1, 1, 1]])


@pytest.mark.parametrize(
    ("n", "share", "expected"),
    [
        (4, 0.5, [2, 2, 2]),
        (4, 0.25, [1, 1, 1]),
        (4, 0.125, [0, 1, 0]),
        (8, 0.5, [4, 4, 4]),
        (4, 1.0, [4, 4, 4]),
        (10, 0.7, [7] * 10),
        (20, 0.35, [7] * 5),
    ],  # 90 * 0.7 is 62.99 in floating point
)
def test_explorers_are_as_many_as_their_share(n, share, expected):
    config = tiny(method="plus", episodes_per_iteration=n, n_episodes=100, **{"explore.explorers": share})
    envs = [tasks.make(config.env) for _ in range(n)]
    subject = new_learner(config, envs)
    explorers, counts, roles = Explorers.of(config), [], set()
    for _ in expected:
        joined, actor = explorers.join(envs, lambda s, g: None, subject)
        assert len(joined) == len({id(env) for env in joined}) == n
        counts.append(sum(isinstance(env, Ongoing) for env in joined))
        roles |= set(actor._roles.tolist()) if isinstance(actor, RoleActor) else set()
        subject.buffer.extend(more(subject, n))
    assert counts == expected
    assert roles >= {"walk", "seek"} if share > 0.125 else {"policy", "walk"}


@pytest.mark.parametrize(("walk_hold", "expected"), [(None, 2.0), (1, 1.0), (9, 5.0)])
def test_walks_of_explorers_hold_their_actions_as_long_as_they_are_told(walk_hold, expected):
    changes = {"explore.explorers": 1.0, "explore.hold": 3, "explore.walk_hold": walk_hold}
    config = tiny(method="plus", episodes_per_iteration=4, **changes)
    envs = [tasks.make(config.env) for _ in range(4)]
    joined, actor = Explorers.of(config).join(envs, lambda s, g: np.zeros((4, 2)), new_learner(config, envs))
    assert len(joined) == 4 and actor._roles[0] == "walk"
    actions = np.array([actor(np.zeros((4, 4)), None)[0] for _ in range(4000)])
    held = 1.0 / (np.diff(actions, axis=0) != 0).any(1).mean()
    assert held == pytest.approx(expected, rel=0.1)


def test_explorers_give_up_where_no_graph_comes_of_it():
    config = tiny(method="plus", episodes_per_iteration=4, **{"explore.explorers": 0.5, "explore.patience": 8})
    envs = [tasks.make(config.env) for _ in range(4)]
    subject, counts = new_learner(config, envs), []
    for n_cells in (0, 0, 0, 5):
        subject.graph = SimpleNamespace(n_cells=n_cells, draw=lambda rng: np.zeros(2))
        joined, _ = Explorers.of(config).join(envs, lambda s, g: None, subject)
        counts.append(sum(isinstance(env, Ongoing) for env in joined))
        subject.buffer.extend(subject.buffer.episodes()[:4])
    assert counts == [2, 2, 0, 2]  # after 4, 8, 12, 16 episodes


def test_a_task_whose_goal_does_not_obey_actions_has_neither_graph_nor_explorers(tmp_path, capsys):
    for env, has in (("fetch_wall", True), ("claw", False)):
        config = tiny(env, "plus")
        run = Run.open(config, tmp_path / env, False, (), Execution())
        run.close()
        assert (run.learner.graph is not None) is has and (run.explorers is not None) is has
        assert ("neither graph nor explorers" in capsys.readouterr().out) is not has


def test_a_run_of_plus_resumes_to_the_same_result(tmp_path):
    changes = {"evaluate.every": 8, "graph.every": 2, "graph.occupancy": 5, "episodes_per_iteration": 4}
    whole = train(tiny(method="plus", **{**changes, "n_episodes": 40}), tmp_path / "whole")
    train(tiny(method="plus", **{**changes, "n_episodes": 24}), tmp_path / "parts")
    parts = train(tiny(method="plus", **{**changes, "n_episodes": 40}), tmp_path / "parts")
    assert whole[-1]["n_cells"] > 0
    assert learned(parts) == learned(whole)
