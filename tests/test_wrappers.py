"""Wrappers that change a task are refused, since plans would not pass through them; those that look on are kept."""

import gymnasium
import numpy as np
import pytest

from napsp import envs
from napsp.envs.point_maze import PointMazeEnv
from napsp.errors import UserError


class Flipped(gymnasium.ActionWrapper):
    """The motors are wired the other way round."""

    def action(self, action):
        return -np.asarray(action)


def flipped(render_mode=None):
    return Flipped(gymnasium.wrappers.RecordEpisodeStatistics(PointMazeEnv(render_mode=render_mode)))


def counted(render_mode=None):
    return gymnasium.wrappers.RecordEpisodeStatistics(PointMazeEnv(render_mode=render_mode))


def flipped_stock(render_mode=None):
    return Flipped(gymnasium.make("FetchReach-v4", render_mode=render_mode))


@pytest.fixture
def registered():
    gymnasium.register("test/Flipped-v0", entry_point="test_wrappers:flipped", max_episode_steps=10)
    yield "test/Flipped-v0"
    gymnasium.registry.pop("test/Flipped-v0")


@pytest.mark.parametrize("name", ["test/Flipped-v0", "test_wrappers:flipped", "test_wrappers:flipped_stock"])
def test_a_wrapper_that_changes_the_task_is_refused(name, registered):
    with pytest.raises(UserError, match=f"{name} is wrapped in Flipped, which plans would not pass through; let the"):
        envs.make(name)


def test_a_wrapper_that_looks_on_is_kept():
    env = envs.make("test_wrappers:counted")
    assert isinstance(env, gymnasium.wrappers.TimeLimit)
    env.reset(seed=0)
    for _ in range(envs.DEFAULT_EPISODE_LENGTH):
        *_, truncated, _ = env.step(np.zeros(2, np.float32))
    assert truncated and isinstance(env.unwrapped, PointMazeEnv)
    assert env.env.env is env.unwrapped and isinstance(env.env, gymnasium.wrappers.RecordEpisodeStatistics)
    env.close()
