"""planners.controller in a loop of one's own plans as the commands do."""

import gymnasium
import numpy as np
import pytest

import napsp
import planners
from napsp.errors import UserError
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session


@pytest.fixture(scope="module")
def env():
    env = napsp.make("point_maze")
    yield env
    env.close()


@pytest.mark.parametrize(("search", "cost"), [("mppi", "distance"), ("cem", "euclidean"), ("smooth", "distance")])
def test_a_loop_of_ones_own_does_what_a_session_does(search, cost, env):
    session = Session.open(PlanConfig.of(search, {"env": "point_maze", "cost": cost}), RunOptions(threads=1))
    wanted = session.run_episode(seed=4).actions[:6]
    session.close()
    given = napsp.load("point_maze") if cost == "distance" else cost
    with planners.controller(search, env, cost=given, threads=1) as controller:
        observation, _ = env.reset(seed=4)
        controller.controller.reset(np.random.default_rng([4, 1]))  # the stream of a session's episode
        actions = []
        for _ in range(6):
            actions.append(controller.plan(observation).action)
            observation, *_ = env.step(actions[-1])
    np.testing.assert_array_equal(actions, wanted)


def test_a_reset_with_a_seed_begins_the_same_again(env):
    with planners.controller("mppi", env, cost="sparse", samples=8, horizon=3, threads=1) as controller:
        plans = []
        for _ in range(2):
            observation, _ = env.reset(seed=0)
            controller.reset(seed=7)
            plans.append([controller.plan(observation).actions for _ in range(2)])
    np.testing.assert_array_equal(*plans)
    assert plans[0][0].shape == (3, 2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"samples": 0}, "samples is 0"),
        ({"options": {"search.temperature": -1.0}}, "temperature is -1.0"),
        ({"options": {"where": "middle"}}, "unknown where 'middle'"),
        ({"options": {"model.kind": "exct"}}, "unknown kind 'exct'; did you mean exact"),
        ({"options": {"spline.interpolation": "quintic", "spline.knots": 4}}, "unknown interpolation 'quintic'"),
        ({"cost": "sparse", "options": {"cost": "euclidean"}}, "cost is no option of a controller"),
        ({"options": {"env": "claw"}}, "env is no option of a controller"),
        ({"options": {"smooth": False, "smooth.rtae": 5}}, "no option 'rtae'"),
        ({"options": {"smooth": "no"}}, "smooth is 'no'; it must be of kind bool"),
        ({"options": {"smooth.rate": 5.0}}, "--smooth.rate needs --smooth"),
    ],
)
def test_options_that_do_not_fit_are_named(env, options, words):
    with pytest.raises(UserError, match=words):
        planners.controller("mppi", env, **options)


def test_a_function_is_a_cost(env):
    asked = []

    def steps(achieved, goal):
        asked.append((achieved.shape, goal.shape))
        return np.linalg.norm(achieved - goal, axis=1)

    with planners.controller("mppi", env, cost=steps, samples=8, horizon=4, threads=1) as controller:
        plan = controller.plan(env.reset(seed=0)[0])
    assert asked and asked[0][1] == (2,) and np.isfinite(plan.costs).all() and len(np.unique(plan.costs)) > 1


def test_what_cannot_be_planned_is_said(env):
    with pytest.raises(UserError, match="no search 'mpi'; did you mean mppi"):
        planners.controller("mpi", env)
    with pytest.raises(UserError, match=r"no option 'temprature'.*did you mean temperature"):
        planners.controller("mppi", env, options={"search.temprature": 1})
    with pytest.raises(UserError, match=r"Pendulum.* can not be planned in: it lacks dynamics"):
        planners.controller("mppi", gymnasium.make("Pendulum-v1"))
    with pytest.raises(UserError, match="trained on fetch_wall, not on point_maze"):
        planners.controller("mppi", env, cost=napsp.load("fetch_wall"))
    with pytest.raises(UserError, match="goal of the observation"):
        planners.controller("mppi", env, cost="sparse", options={"goal": (1.0, 1.0)})
    with pytest.raises(UserError, match="wrapped in TransformReward"):
        planners.controller("mppi", gymnasium.wrappers.TransformReward(env, lambda reward: reward), cost="sparse")
    with pytest.raises(AttributeError, match="no attribute 'mpppi'"):
        planners.mpppi  # noqa: B018


def test_a_stock_task_keeps_its_name():
    stock = napsp.make("FetchPush-v4")
    with pytest.raises(UserError, match="no checkpoint ships for FetchPush-v4"):
        planners.controller("mppi", stock)
    stock.close()
