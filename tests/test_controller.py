"""What the receding-horizon loop asks for, by a search and an engine that record what they are handed."""

import numpy as np
import pytest
from recording import OBSERVATION, RNG, STATE, TRIED, calls, names, plan, recorded

from mpc.controller import Smoothed
from napsp.errors import UserError

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
