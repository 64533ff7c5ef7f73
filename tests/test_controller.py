"""The receding-horizon loop, seen by a search, an engine and a smoother that record what they are handed."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from explosive import Explosive

from mpc.controller import Controller, Plan, Smoothed
from mpc.cost import Cost
from mpc.knots import SplineConfig
from mpc.rollout import Followed, RolloutEngine, Trajectories
from napsp.envs.dynamics import get_state
from napsp.errors import UserError
from planners.smooth import Held, HeldConfig

STATE = np.array([0.0, 5.0])
GOAL = np.array([0.0])
OBSERVATION = {"observation": np.array([5.0]), "achieved_goal": np.array([5.0]), "desired_goal": GOAL}
RNG = np.random.default_rng(0)


def search(kind, n_knots, n_controls, **settings):
    """The one place that knows how a search is built."""
    return kind(n_knots, n_controls, HeldConfig(**settings))


def controller_of(engine, planner, cost, horizon, n_knots=None, interpolation="linear", **settings):
    """The one place that knows how a controller is built."""
    return Controller(engine, planner, cost, horizon, RNG, SplineConfig(n_knots, interpolation), **settings)


class Line:
    """An engine whose world is a line: an action is added to the position. State: the clock and the position."""

    def __init__(self, log):
        self.log = log
        self.dynamics = SimpleNamespace(model=None)
        self.diverged = False

    def reset(self):
        self.log.append(("engine.reset",))

    def rollout(self, state, actions, known=()):
        self.log.append(("rollout", state, actions, known))
        positions = state[1] + np.cumsum(actions, 1, np.float64)
        return Trajectories(positions, positions, np.broadcast_to(self.diverged, len(actions)))

    def follow(self, state, observation, actor, horizon):
        self.log.append(("follow", state, observation, actor, horizon))
        actions = np.array(actor(horizon), np.float32).reshape(horizon, -1)
        return Followed(actions, actions, np.arange(horizon))


class Recorder:
    """A search that tries what the test says, round after round, and executes what it says."""

    effective_samples = 2.5

    def __init__(self, log, tried, plan):
        self.log, self.tried, self.plan = log, [np.array(one, float) for one in tried], np.array(plan, float)
        self.rounds = 0

    def reset(self):
        self.log.append(("reset",))

    def sample(self, rng, proposals=None):
        self.log.append(("sample", rng, proposals))
        self.rounds += 1
        return self.tried[(self.rounds - 1) % len(self.tried)]

    def update(self, knots, costs):
        self.log.append(("update", knots, costs))
        self.effective_samples = float(self.rounds)

    def adopt(self, knots):
        self.log.append(("adopt", knots))

    def shift(self, shift):
        self.log.append(("shift", shift))


class Smoother:
    """Hands back what the test says."""

    def __init__(self, log, *answers):
        self.log, self.answers = log, list(answers)

    def reset(self):
        self.log.append(("smoother.reset",))

    def __call__(self, state, observation, actions, executed):
        self.log.append(("smooth", state, observation, actions, executed))
        return self.answers.pop(0)


def reached(achieved, goals):
    assert achieved.shape == goals.shape
    return np.abs(achieved - goals)[..., 0] < 0.5


def far(observations, achieved, actions, goal):
    """Metres to the goal; an action of one's own counts a hundred times."""
    steps = np.abs(achieved - goal)[:, 0]
    return steps if actions is None else steps + 100.0 * actions[:, 0]


# Two plans of three steps, and the plan to execute.
TRIED = [[[[-1.0], [-0.5], [-0.5]], [[0.0], [0.25], [0.0]]]]
PLAN = [[0.1], [0.2], [0.3]]


def recorded(tried=TRIED, plan=PLAN, horizon=3, action_of="policy", answers=None, **settings):
    """A controller and the log of all it does."""
    log = []
    if answers is not None:
        settings["smoother"] = Smoother(log, *answers)
    cost = Cost(far, reached, "terminal", action_of)
    return controller_of(Line(log), Recorder(log, tried, plan), cost, horizon, **settings), log


def names(log):
    return [entry[0] for entry in log]


def calls(log, name):
    return [entry[1:] for entry in log if entry[0] == name]


def plan(controller, state=STATE, **changes):
    return controller.plan_from(state, {**OBSERVATION, **changes})


# -- the loop --


def test_the_first_plan_is_not_shifted_and_every_other_once_before_anything_is_drawn():
    controller, log = recorded(n_refinements=2)
    for _ in range(3):
        plan(controller)
    round_ = ["sample", "rollout", "update"]
    assert names(log) == 2 * round_ + 2 * (["shift"] + 2 * round_)
    for (shift,) in calls(log, "shift"):
        np.testing.assert_array_equal(shift, [[0, 1, 0], [0, 0, 1], [0, 0, 1]])


@pytest.mark.parametrize(
    ("interpolation", "shift"),
    [
        # Knots at steps 0 and 2 of three controls. One step later the first is read half way to the second.
        ("linear", [[0.5, 0.5], [0.0, 1.0]]),
        # Held knots govern controls 0, 1 and control 2: one later the first governs one of its two, the next the rest.
        ("zero", [[0.5, 0.5], [0.0, 1.0]]),
        ("cubic", [[0.5, 0.5], [0.0, 1.0]]),  # two knots have no curve
    ],
)
def test_plans_of_few_knots_are_shifted_by_one_control_step(interpolation, shift):
    controller, log = recorded([[[[0.0], [1.0]]]], [[0.0], [1.0]], n_knots=2, interpolation=interpolation)
    for _ in range(2):
        plan(controller)
    np.testing.assert_allclose(calls(log, "shift")[0][0], shift, atol=1e-12)


def test_a_new_episode_begins_unshifted_with_everything_forgotten():
    controller, log = recorded(answers=[Smoothed(np.full((3, 1), 0.5, np.float32), 1.0, True)] * 3)
    plan(controller)
    log.clear()
    controller.reset()
    assert sorted(names(log)) == ["engine.reset", "reset", "smoother.reset"]
    plan(controller)
    assert "shift" not in names(log)
    assert calls(log, "smooth")[0][3].shape == (0, 1), "nothing was executed in this episode"
    plan(controller)
    assert names(log).count("shift") == 1
    controller, log = recorded()
    controller.reset()  # without a smoother
    assert sorted(names(log)) == ["engine.reset", "reset"]


def test_randomness_is_the_one_that_was_given_last():
    controller, log = recorded()
    plan(controller)
    controller.reset()
    plan(controller)
    other = np.random.default_rng(1)
    controller.reset(other)
    plan(controller)
    controller.reset()
    plan(controller)
    assert [rng for rng, _ in calls(log, "sample")] == [RNG, RNG, other, other]


def test_a_refused_goal_leaves_the_plan_where_it_is():
    controller, log = recorded()
    for first in (True, False):
        for bad in (np.nan, np.inf):
            with pytest.raises(ValueError, match="is not finite"):
                plan(controller, desired_goal=np.array([0.0, bad]))
        assert not log
        plan(controller)
        assert ("shift" in names(log)) != first
        log.clear()


# -- what is tried and what it costs --


def test_each_round_updates_with_its_own_knots_and_their_costs_in_order():
    tried = [TRIED[0], [[[-1.0], [-1.0], [-1.0]], [[-1.0], [-1.0], [-0.5]]]]
    controller, log = recorded(tried, n_refinements=2)
    assert controller.n_tried == 0
    plan(controller, np.array([0.0, 2.5]))  # to the goal from 2.5 metres
    updates = calls(log, "update")
    assert [knots is own for (knots, _), own in zip(updates, controller.planner.tried, strict=True)] == [True, True]
    # First round: to 0.5 (three steps, half a step to go), and to 2.75. Second: to -0.5, to 0 in the third step.
    np.testing.assert_allclose(updates[0][1], [3.5, 5.75])
    np.testing.assert_allclose(updates[1][1], [3.5, 2.0])
    assert controller.n_tried == 4
    plan(controller)
    assert controller.n_tried == 4, "of the last plan call alone"


@pytest.mark.parametrize(("action_of", "simulated"), [("policy", 3), ("plan", 2)])
def test_only_actions_that_the_cost_asks_for_are_simulated(action_of, simulated):
    controller, log = recorded(action_of=action_of)
    planned = plan(controller)
    (state, actions, known), costs = calls(log, "rollout")[0], calls(log, "update")[0][1]
    np.testing.assert_array_equal(state, STATE)
    np.testing.assert_array_equal(actions, np.array(TRIED[0])[:, :simulated])
    assert actions.dtype == np.float32 and len(known) == 0
    ends = {"policy": [3 + 3.0, 3 + 5.25], "plan": [2 + 3.5 + 100 * -0.5, 2 + 5.25]}
    np.testing.assert_allclose(costs, ends[action_of])
    assert planned.trajectories.observations.shape == (2, simulated, 1) and planned.actions.shape == (3, 1)


def test_knots_become_actions_within_the_bounds():
    controller, log = recorded([[[[-3.0], [1.0]], [[0.0], [5.0]]]], [[-2.0], [4.0]], n_knots=2)
    planned = plan(controller)
    np.testing.assert_array_equal(calls(log, "rollout")[0][1][..., 0], [[-1, -1, 1], [0, 1, 1]])
    np.testing.assert_array_equal(planned.actions[:, 0], [-1, 1, 1])
    controller, log = recorded([[[[-1.0], [1.0]]]], [[0.5], [-0.5]], n_knots=2, interpolation="zero")
    np.testing.assert_array_equal(plan(controller).actions[:, 0], [0.5, 0.5, -0.5])
    np.testing.assert_array_equal(calls(log, "rollout")[0][1][0, :, 0], [-1, -1, 1])


def test_three_cubic_knots_are_a_parabola_and_one_knot_is_held():
    parabola = np.array([[[0.0], [0.25], [1.0]]])  # (t / 4)^2 at t = 0, 2, 4
    controller, log = recorded([parabola], parabola[0], horizon=5, n_knots=3, interpolation="cubic")
    np.testing.assert_allclose(plan(controller).actions[:, 0], (np.arange(5) / 4) ** 2, atol=1e-7)
    plan(controller)
    # One step later: the curve at t = 1 and 3, and its end, which is held.
    np.testing.assert_allclose(calls(log, "shift")[0][0] @ parabola[0, :, 0], [1 / 16, 9 / 16, 1.0], atol=1e-12)
    for interpolation in ("zero", "linear", "cubic"):
        controller, log = recorded([[[[0.5]]]], [[-0.5]], n_knots=1, interpolation=interpolation)
        for _ in range(2):
            np.testing.assert_allclose(plan(controller).actions[:, 0], [-0.5, -0.5, -0.5])
        np.testing.assert_allclose(calls(log, "rollout")[0][1][0, :, 0], [0.5, 0.5, 0.5])
        np.testing.assert_allclose(calls(log, "shift")[0][0], [[1.0]])


@pytest.mark.parametrize("n_knots", [-1, 4])
def test_as_many_knots_as_steps_at_most(n_knots):
    with pytest.raises((ValueError, UserError), match="knots is"):
        recorded(n_knots=n_knots)


# -- proposals --


def test_proposals_are_the_nearest_knots_to_what_actors_did_and_known_to_the_engine():
    did = {"ramp": [0.0, 0.5, 1.0], "bump": [0.0, 0.9, 0.0]}
    actors = [lambda horizon: did["ramp"], lambda horizon: did["bump"]]
    controller, log = recorded([[[[0.0], [1.0]]]], [[0.0], [1.0]], n_knots=2, n_refinements=2, proposals_from=actors)
    plan(controller)
    assert names(log)[:3] == ["follow", "follow", "sample"] and names(log).count("follow") == 2
    for (state, observation, actor, horizon), expected in zip(calls(log, "follow"), actors, strict=True):
        assert state is STATE and actor is expected and horizon == 3
        assert observation.keys() == OBSERVATION.keys() and observation["observation"] is OBSERVATION["observation"]
    for _, proposals in calls(log, "sample"):
        # A ramp is what two knots say; of the bump, the level line with the least squares: 0.9 / 3.
        np.testing.assert_allclose(proposals[..., 0], [[0.0, 1.0], [0.3, 0.3]], atol=1e-7)
    for _, _, known in calls(log, "rollout"):
        np.testing.assert_array_equal([own.actions[:, 0] for own in known], np.float32(list(did.values())))


def test_proposals_that_are_not_finite_are_left_out_and_warned_of_once_per_controller():
    did = {"first": [0.1, np.nan, 0.1], "second": [0.2, 0.2, 0.2], "third": [0.1, 0.1, np.inf]}
    actors = [lambda horizon, name=name: did[name] for name in did]
    controller, log = recorded(proposals_from=actors)
    with pytest.warns(RuntimeWarning, match="a policy proposed actions that are not finite; left out") as caught:
        for _ in range(3):
            plan(controller)
        controller.reset()
        plan(controller)
    assert len(caught) == 1
    for _, proposals in calls(log, "sample"):
        np.testing.assert_allclose(proposals[..., 0], [[0.2, 0.2, 0.2]], atol=1e-7)
    did["second"] = did["first"]
    plan(controller)
    assert calls(log, "sample")[-1][1] is None, "nothing to propose is no proposal"
    controller, log = recorded()
    plan(controller)
    assert calls(log, "sample")[-1][1] is None


# -- what comes out --


def test_a_plan_is_what_the_search_executes_after_its_last_round():
    tried = [TRIED[0], [[[-1.0], [-1.0], [-1.0]], [[-1.0], [-1.0], [-0.5]]]]
    controller, log = recorded(tried, n_refinements=2)
    planned = plan(controller)
    np.testing.assert_array_equal(planned.actions, np.float32(PLAN))
    np.testing.assert_array_equal(planned.action, np.float32([0.1]))
    assert planned.actions.dtype == np.float32
    assert planned.costs is calls(log, "update")[-1][1]
    np.testing.assert_allclose(planned.trajectories.observations[:, -1, 0], [2.0, 2.5])  # the second round's
    assert planned.effective_samples == 2.0, "after both rounds"
    assert planned.smoothing_ms >= 0.0


def test_a_held_plan_is_executed_action_by_action():
    planner = search(Held, 4, 1)
    planner.adopt(np.array([[0.1], [0.2], [0.3], [0.4]]))
    controller = controller_of(Line([]), planner, Cost(far, reached, "terminal"), 4)
    executed = [float(plan(controller).action[0]) for _ in range(6)]
    np.testing.assert_allclose(executed, [0.1, 0.2, 0.3, 0.4, 0.4, 0.4], rtol=1e-6)


def test_times_are_those_of_the_whole_call_and_of_smoothing(monkeypatch):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr("mpc.controller.time.perf_counter", lambda: clock.now)

    def lasting(seconds, function):
        def call(*given):
            clock.now += seconds
            return function(*given)

        return call

    controller, _ = recorded(n_refinements=2, answers=[Smoothed(np.zeros((3, 1), np.float32), 1.0, True)])
    controller.engine.rollout = lasting(2.0, controller.engine.rollout)
    controller.smoother = lasting(3.0, controller.smoother)
    planned = plan(controller)
    assert (planned.milliseconds, planned.smoothing_ms) == (7000.0, 3000.0)


def test_the_cheapest_samples_are_in_order_without_those_that_diverged():
    planned = Plan(np.zeros(1), np.zeros((1, 1)), None, np.array([3.0, np.inf, 1.0, np.nan, 2.0]), 1.0, 0.0)
    assert planned.cheapest(2).tolist() == [2, 4] and planned.cheapest(9).tolist() == [2, 4, 0]
    assert planned.smoothing_ms == 0.0


@pytest.mark.parametrize("diverged", [True, False])
def test_a_lost_search_is_warned_of_once_with_its_reason(diverged):
    controller, _ = recorded()
    controller.engine.diverged = diverged
    controller.cost = Cost(lambda *rows: np.full(len(rows[0]), np.nan), reached, "terminal")
    reason = "every sampled plan diverged" if diverged else "the cost of every sampled plan is not finite"
    with pytest.warns(RuntimeWarning, match=f"^{reason}; keeping the previous plan$") as caught:
        for _ in range(2):
            planned = plan(controller)
    assert len(caught) == 1 and np.isinf(planned.costs).all()
    np.testing.assert_array_equal(planned.actions, np.float32(PLAN))


def test_a_search_lost_for_several_reasons_has_not_diverged_as_a_whole():
    controller, _ = recorded()
    controller.engine.diverged = [True, False]
    controller.cost = Cost(lambda *rows: np.full(len(rows[0]), np.nan), reached, "terminal")
    with pytest.warns(RuntimeWarning, match="^the cost of every sampled plan is not finite"):
        plan(controller)


def test_some_samples_without_a_cost_are_nothing_to_warn_of():
    controller, _ = recorded()
    controller.cost = Cost(lambda *rows: np.array([np.nan, 4.0]), reached, "terminal")
    np.testing.assert_array_equal(plan(controller).costs, [np.inf, 7.0])


# -- smoothing --

SMOOTH = np.array([[0.0], [0.9], [0.0]], np.float32)


def test_a_smoother_is_handed_the_plan_of_the_search_and_its_answer_is_executed():
    controller, log = recorded(answers=[Smoothed(SMOOTH, 2.0, True)])
    planned = plan(controller)
    assert names(log) == ["sample", "rollout", "update", "smooth", "adopt"]
    state, observation, actions, executed = calls(log, "smooth")[0]
    assert state is STATE and observation["observation"] is OBSERVATION["observation"]
    np.testing.assert_array_equal(actions, np.float32(PLAN))
    assert executed.shape == (0, 1) and executed.dtype == np.float32
    np.testing.assert_array_equal(planned.actions, SMOOTH)
    np.testing.assert_array_equal(planned.action, SMOOTH[0])


@pytest.mark.parametrize(("cost", "accepted"), [(2.0, True), (0.0, True), (None, True), (2.0, False), (None, False)])
def test_only_an_accepted_plan_that_was_rolled_out_is_adopted(cost, accepted):
    controller, log = recorded(
        [[[[0.0], [1.0]]]], [[0.0], [1.0]], n_knots=2, answers=[Smoothed(SMOOTH, cost, accepted)]
    )
    planned = plan(controller)
    adopted = calls(log, "adopt")
    assert len(adopted) == (accepted and cost is not None)
    for (knots,) in adopted:
        np.testing.assert_allclose(knots, [[0.3], [0.3]], atol=1e-7)  # the nearest that two knots can say
    np.testing.assert_array_equal(planned.actions, SMOOTH)


def test_a_smoother_sees_the_last_two_actions_the_latest_last():
    rows = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.5, 0.5, 0.5], [0.6, 0.6, 0.6, 0.6]], np.float32)
    answers = [Smoothed(row[:, None].copy(), 1.0, accepted) for row, accepted in zip(rows.T, (1, 0, 1, 1), strict=True)]
    controller, log = recorded(answers=list(answers))
    for answer in answers:
        plan(controller)
        answer.actions[:] = 9.0  # whoever owns the plan may write into it
    seen = [executed[:, 0] for _, _, _, executed in calls(log, "smooth")]
    for found, expected in zip(seen, ([], [0.1], [0.1, 0.2], [0.2, 0.3]), strict=True):
        np.testing.assert_array_equal(found, np.float32(expected))


# -- an environment --


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


def test_a_call_that_failed_was_no_step():
    controller, log = recorded()
    plan(controller)
    whole = controller.engine.rollout

    def out_of_memory(*arguments):
        raise MemoryError

    controller.engine.rollout = out_of_memory
    with pytest.raises(MemoryError):
        plan(controller)
    controller.engine.rollout = whole
    plan(controller)
    assert names(log).count("shift") == 1
