"""Pick and place equals stock Fetch, has the paper's goals, and can be solved only over the wall."""

import gymnasium
import mujoco
import numpy as np
import pytest
from scripted import play

from napsp import envs
from napsp.envs.fetch_pick_place import FetchPickPlaceEnv


@pytest.fixture(scope="module")
def stock():
    import gymnasium_robotics

    gymnasium.register_envs(gymnasium_robotics)
    world = gymnasium.make("FetchPickAndPlace-v4").unwrapped
    yield world
    world.close()


def actions_for(world, seed):
    """Random actions, or a scripted grasp with actions outside the bounds now and then."""
    rng = np.random.default_rng(seed)
    actions = play(world, seed)[0] if seed % 2 else rng.uniform(-1.5, 1.5, (50, 4)).astype(np.float32)
    return actions + rng.normal(0, 0.1, actions.shape).astype(np.float32)


def test_equals_stock_fetch_pick_and_place_bit_for_bit(stock, monkeypatch):
    """With stock collisions and fresh poses in stock, states are equal and observations nearly."""
    monkeypatch.setattr(stock, "_step_callback", lambda: mujoco.mj_forward(stock.model, stock.data))
    ours = FetchPickPlaceEnv(arm_self_collision=True)
    for seed in range(6):
        actions = actions_for(ours, seed)
        first, second = stock.reset(seed=seed)[0], ours.reset(seed=seed)[0]
        np.testing.assert_array_equal(np.tile(first["desired_goal"], 2), second["desired_goal"])
        for action in actions:
            np.testing.assert_array_equal(stock.data.qpos, ours.data.qpos)
            np.testing.assert_array_equal(stock.data.qvel, ours.data.qvel)
            np.testing.assert_allclose(first["observation"], second["observation"], rtol=0, atol=1e-14)
            np.testing.assert_array_equal(first["achieved_goal"], second["achieved_goal"][:3])
            np.testing.assert_array_equal(first["observation"][:3], second["achieved_goal"][3:])
            (first, *_), (second, *_) = stock.step(action), ours.step(action)


def test_plain_goals_are_those_of_stock(stock):
    ours = envs.make("fetch_pick_place_plain").unwrapped
    first, second = stock.reset(seed=3)[0], ours.reset(seed=3)[0]
    for key in ("achieved_goal", "desired_goal"):
        assert second[key].shape == (3,)
        np.testing.assert_allclose(first[key], second[key], atol=1e-3)  # another arm sags another way
    _, boxes, reached = play(ours, 3)
    near = np.linalg.norm(boxes - ours.goal, axis=-1) < 0.05
    np.testing.assert_array_equal(near, reached)
    assert near.any()
    ours.close()


def test_a_batch_of_observations_equals_single_ones(worlds):
    world = worlds["fetch_pick_place_wall"]
    world.reset(seed=0)
    rows = []
    for action in np.random.default_rng(0).uniform(-1, 1, (37, 4)):
        world.step(action)
        rows.append(world._features[0].copy())
    batch = np.array(rows)
    for features in (batch, np.stack([batch, batch[::-1]]), batch[::3]):
        together = world.dynamics.observe(features)
        for index in np.ndindex(features.shape[:-1]):
            alone = world.dynamics.observe(features[index].copy())
            np.testing.assert_array_equal(together[0][index], alone[0])
            np.testing.assert_array_equal(together[1][index], alone[1])


def test_the_augmented_goal_asks_for_box_and_gripper(worlds):
    world = worlds["fetch_pick_place"]
    goal = np.full(6, 0.5)
    near, far = np.array([0.029, 0.029, 0.0]), np.array([0.0, 0.051, 0.0])
    zero = np.zeros(3)
    offsets = np.array([[*zero, *zero], [*near, *near], [*near, *far], [*far, *near], [*far, *far]])
    expected = [True, True, False, False, False]
    achieved, goals = goal + offsets, np.tile(goal, (5, 1))
    assert world.reached(achieved, goals).tolist() == expected
    assert world.compute_reward(achieved, goals, [{}] * 5).tolist() == [0.0, 0.0, -1.0, -1.0, -1.0]
    assert world.reached(achieved[..., :3], goals[..., :3]).tolist() == [True, True, True, False, False]
    np.testing.assert_array_equal(world.goal_positions(goals[None]), goals[None, :, :3])
    np.testing.assert_array_equal(world.goal_positions(goals[:, :3]), goals[:, :3])


def test_starts_and_goals(worlds):
    for name in ("fetch_pick_place", "fetch_pick_place_wall"):
        world, in_air = worlds[name], 0
        for seed in range(60):
            observation, _ = world.reset(seed=seed)
            (box, grip), (target, hand) = (observation[k].reshape(2, 3) for k in ("achieved_goal", "desired_goal"))
            np.testing.assert_array_equal(target, hand)
            apart = np.linalg.norm((box - grip)[:2])
            assert 0.42 < target[2] < 0.88 and abs(box[2] - 0.425) < 1e-3
            in_air += target[2] > 0.43
            if name == "fetch_pick_place":
                assert apart >= 0.1 and np.abs((box - grip)[:2]).max() <= 0.15
            else:
                np.testing.assert_allclose(grip, world.START_GRIP, atol=2e-3)
                assert apart >= 0.05 and 0.52 <= box[1] <= 0.64 < world.WALL_Y < 0.86 <= target[1] <= 0.98
                assert min(box[0], target[0]) >= 1.22 and max(box[0], target[0]) <= 1.44
        assert 20 <= in_air <= 40, "half of the goals are in the air"


@pytest.mark.parametrize(
    ("name", "lift", "least", "most"),
    [
        ("fetch_pick_place", True, 18, 20),
        ("fetch_pick_place_wall", True, 18, 20),
        ("fetch_pick_place_wall", False, 0, 0),
    ],
)
def test_scripted_pick_and_place(name, lift, least, most, worlds):
    successes = 0
    for seed in range(20):
        _, boxes, reached = play(worlds[name], seed, lift)
        successes += reached[-1] if lift else reached.any()
        assert lift or boxes[:, 1].max() < 0.72, "the box got through the wall or around it"
    assert least <= successes <= most


@pytest.mark.parametrize("name", ["fetch_pick_place", "fetch_pick_place_wall"])
def test_an_episode_may_begin_with_the_box_held(name, worlds):
    world = worlds[name]
    lift = np.array([0.0, 0.0, 1.0, -1.0], np.float32)
    for seed in range(10):
        table = world.reset(seed=seed)[0]["observation"][5]
        observation, goal = world.reset(seed=seed, options={"box_held": True})[0], world.goal
        assert observation["observation"][5] == pytest.approx(table, abs=0.02)
        np.testing.assert_array_equal(goal, world.reset(seed=seed)[0]["desired_goal"])
        world.reset(seed=seed, options={"box_held": True})
        for _ in range(6):
            observation = world.step(lift)[0]
        assert observation["observation"][5] > table + 0.08, "a held box comes along"


def test_the_wall_stops_gripper_and_box(worlds):
    world = worlds["fetch_pick_place_wall"]
    for seed in range(8):
        rng = np.random.default_rng(seed)
        grasp = play(world, seed, lift=False)[0][:14]
        observation, _ = world.reset(seed=seed)
        for action in grasp:
            world.step(action)
        drift = rng.uniform(-1, 1, 2)
        for _ in range(60):  # full push into the wall with random sideways drift
            push = np.array([drift[0], 1.0, min(drift[1], 0.0), -1.0], np.float32)
            observation = world.step(push)[0]["observation"]
            assert observation[1] < world.WALL_Y and observation[4] < world.WALL_Y


def test_what_collides(worlds):
    model = worlds["fetch_pick_place_wall"].model

    def collide(first, second):
        a, b = (model.geom(name) for name in (first, second))
        return bool(a.contype & b.conaffinity or b.contype & a.conaffinity)

    table = next(model.geom(g).name or g for g in range(model.ngeom) if model.body("table0").id == model.geom_bodyid[g])
    finger, gripper, forearm, base = (
        f"robot0:{name}_link" for name in ("l_gripper_finger", "gripper", "forearm_roll", "base")
    )
    for obstacle in ("object0", "wall", table):
        assert all(collide(obstacle, part) for part in (finger, gripper, forearm)), obstacle
    assert all(collide("object0", other) for other in ("wall", "floor0", table))
    assert collide(gripper, base) and not collide(gripper, forearm) and not collide(base, "object0")
    assert model.geom(finger).condim == 4, "without torsional friction the box swings in the grasp"
