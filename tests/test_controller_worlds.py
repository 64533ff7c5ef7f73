"""The receding-horizon loop and the actors it follows, in environments that are simulated."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from explosive import Explosive
from recording import OBSERVATION, calls, controller_of, far, reached, recorded, search

from mpc.controller import Controller
from mpc.cost import Cost, EuclideanSteps
from mpc.rollout import RolloutEngine
from napsp.envs.dynamics import get_state
from napsp.policy.actors import GaussianPolicy
from napsp.policy.greedy import GreedyPolicy
from planners.mppi import MPPI, MPPIConfig
from planners.smooth import Held


def slide():
    """An environment with a body that one motor pushes along a line, and an exact engine for it."""
    dynamics = Explosive(open_loop=True)
    dynamics.model.actuator_gear[:] = 1e-2
    env = SimpleNamespace(model=dynamics.model, data=mujoco.MjData(dynamics.model))
    env.data.qpos[:], env.data.qvel[:] = 0.3, -0.2
    return dynamics, env


def states_of(dynamics, env, actions):
    """Positions by stepping a copy of the environment."""
    data, found = mujoco.MjData(env.model), []
    data.qpos[:], data.qvel[:] = env.data.qpos, env.data.qvel
    for action in actions:
        data.ctrl[:] = action
        mujoco.mj_step(env.model, data, dynamics.substeps)
        found.append(float(data.qpos[0]))
    return found


def test_planning_starts_at_the_state_of_the_environment():
    _, env = slide()
    controller, log = recorded()
    controller.engine.dynamics.model = env.model
    controller.plan(env, OBSERVATION)
    np.testing.assert_array_equal(calls(log, "rollout")[0][0], get_state(env.model, env.data))
    other = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><joint axis='1 0 0'/><geom size='1'/></body></worldbody></mujoco>"
    )
    controller.engine.dynamics.model = other
    with pytest.raises(ValueError, match="does not fit the model that is planned in"):
        controller.plan(env, OBSERVATION)


@pytest.mark.parametrize(("action_of", "simulated"), [("policy", 4), ("plan", 3)])
def test_the_cost_of_a_plan_is_that_of_stepping_the_environment(action_of, simulated):
    dynamics, env = slide()
    actions = np.array([[0.5], [-0.3], [0.2], [0.1]], np.float32)
    observation = {**OBSERVATION, "observation": np.array([0.3, -0.2]), "achieved_goal": np.array([0.3, -0.2])}
    observation["desired_goal"] = np.array([50.0, 0.0])
    with RolloutEngine(dynamics, n_threads=1) as engine:
        controller = controller_of(engine, search(Held, 4, 1), Cost(far, reached, "terminal", action_of), 4)
        found = controller.cost_of(env, observation, actions)
    end = states_of(dynamics, env, actions[:simulated])[-1]
    to_go = 50.0 - end + (100.0 * float(actions[-1, 0]) if action_of == "plan" else 0.0)
    assert type(found) is float and found == pytest.approx(simulated + to_go, abs=1e-6)
    assert np.diff(states_of(dynamics, env, actions)).min() > 1e-3, "every step moves it"


def controller(world, seed=0, n_threads=2, where="terminal", horizon=6, action_of="policy", n_samples=24):
    cost = Cost(EuclideanSteps(world.step_length), world.reached, where, action_of)
    planner = MPPI(horizon, world.action_space.shape[0], MPPIConfig(samples=n_samples))
    return Controller(RolloutEngine(world.dynamics, n_threads), planner, cost, horizon, np.random.default_rng(seed))


def test_planning_reaches_a_near_goal_and_leaves_the_world_alone(worlds):
    world = worlds["fetch_reach"]
    observation, _ = world.reset(seed=2)
    control = controller(world)
    success = False
    for _ in range(15):
        before = get_state(world.model, world.data)
        plan = control.plan(world, observation)
        np.testing.assert_array_equal(before, get_state(world.model, world.data))
        observation, _, _, _, info = world.step(plan.action)
        success |= info["is_success"]
    assert success
    control.engine.close()


def test_plans_are_identical_for_any_number_of_threads(worlds):
    world = worlds["fetch_wall"]
    plans = []
    for n_threads in (1, 2):
        observation, _ = world.reset(seed=0)
        control = controller(world, n_threads=n_threads)
        plans.append([control.plan(world, observation).actions for _ in range(3)])
        control.engine.close()
    np.testing.assert_array_equal(*plans)


def test_a_goal_that_is_not_finite_is_refused(worlds):
    world = worlds["point_maze"]
    observation, _ = world.reset(seed=0)
    observation["desired_goal"] = np.array([np.nan, 0.0])
    with pytest.raises(ValueError, match="not finite"):
        controller(world).plan(world, observation)


def test_all_diverged_keeps_the_plan_and_warns_once(worlds):
    world = worlds["point_maze"]
    observation, _ = world.reset(seed=0)
    control = controller(world)
    control.cost = Cost(lambda *rows: np.full(len(rows[0]), np.nan), world.reached, "terminal")
    with pytest.warns(RuntimeWarning, match="the cost of every sampled plan is not finite; keeping the prev") as caught:
        for _ in range(3):
            plan = control.plan(world, observation)
    assert len(caught) == 1
    np.testing.assert_array_equal(plan.actions, 0.0)
    control, rollout = controller(world), control.engine.rollout
    control.engine.rollout = lambda *given: replace(rollout(*given), diverged=np.ones(len(given[1]), bool))
    with pytest.warns(RuntimeWarning, match="every sampled plan diverged; keeping the previous plan"):
        plan = control.plan(world, observation)
    np.testing.assert_array_equal(plan.actions, 0.0)


def test_policy_proposals_join_the_samples(worlds):
    world = worlds["point_maze"]
    observation, _ = world.reset(seed=0)
    control = controller(world)
    control._proposals_from = [lambda observations, goals: np.full((1, 2), 0.25, np.float32)]
    seen = []
    sample = control.planner.sample
    control.planner.sample = lambda rng, proposals: seen.append(proposals) or sample(rng, proposals)
    control.plan(world, observation)
    np.testing.assert_allclose(seen[0], np.full((1, 6, 2), 0.25), atol=1e-6)


def test_following_an_actor_equals_stepping_it(worlds):
    for name in ("fetch_wall", "point_maze"):
        world = worlds[name]
        observation, _ = world.reset(seed=1)
        goal = observation["desired_goal"]

        def actor(observations, goals):
            size = world.action_space.shape[0]  # noqa: B023
            return np.tanh(observations[:, :size] * 3 - goals[:, :1]).astype(np.float32)

        with RolloutEngine(world.dynamics, 1) as engine:
            planned = engine.follow(get_state(world.model, world.data), observation, actor, 8)
        for action in planned.actions:
            rows = observation["observation"].astype(np.float32)[None], goal.astype(np.float32)[None]
            np.testing.assert_array_equal(action, actor(*rows)[0])
            observation = world.step(action)[0]


def test_a_followed_rollout_is_reused_only_for_its_own_actions(worlds):
    for name in ("fetch_wall", "point_maze"):
        world = worlds[name]
        observation, _ = world.reset(seed=2)
        size, state = world.action_space.shape[0], get_state(world.model, world.data)
        with RolloutEngine(world.dynamics, 2) as engine:
            constant = np.full((1, size), 0.4, np.float32)
            followed = engine.follow(state, observation, lambda o, g: constant, 5)  # noqa: B023
            actions = np.random.default_rng(0).uniform(-1, 1, (4, 5, size)).astype(np.float32)
            actions[2] = followed.actions
            simulated = engine.rollout(state, actions)
            reused = engine.rollout(state, actions, [followed])
            np.testing.assert_array_equal(simulated.observations, reused.observations)
            np.testing.assert_array_equal(simulated.achieved_goals, reused.achieved_goals)
            assert not reused.diverged.any()
            marked = replace(followed, features=followed.features + 1.0, diverged=np.ones(5, bool))
            reused = engine.rollout(state, actions, [marked])
        changed = (simulated.achieved_goals != reused.achieved_goals).any((1, 2))
        np.testing.assert_array_equal(changed, [False, False, True, False])
        np.testing.assert_array_equal(reused.diverged, [False, False, True, False])


def test_greedy_policy_equals_torch_and_follows_training():
    torch.manual_seed(0)
    policy = GaussianPolicy((10, 4, 3), (64, 64))
    greedy = GreedyPolicy(policy)
    with torch.no_grad():
        policy.net[0].weight.mul_(2.0)
    states, goals = torch.randn(20, 10), torch.randn(20, 3)
    np.testing.assert_allclose(
        greedy(states.numpy(), goals.numpy()), policy.mode(states, goals).detach().numpy(), atol=1e-6
    )
