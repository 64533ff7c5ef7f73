"""The studio without its page: it lives the episodes that the planners' commands plan, and takes orders."""

import sys
import time

import numpy as np
import pytest

from napsp.envs.cards import CARDS
from napsp.errors import UserError
from napsp.storage.shipped import SHIPPED
from planners.app.options import parse
from planners.app.searches import SEARCHES
from planners.app.session import Session
from planners.app.studio import serve
from planners.app.studio.camera import viewpoint
from planners.app.studio.choices import Choices, checkpoints
from planners.app.studio.curves import columns
from planners.app.studio.field import surface
from planners.app.studio.goal import free_axes, goal_at
from planners.app.studio.live import Live
from planners.app.studio.newest import NewestPlan
from planners.app.studio.trial import Trial
from planners.app.studio.words import lateness, progress

SMALL = ["--env", "point_maze", "--samples", "8", "--threads", "1", "--seed", "3"]
PATIENCE = 60  # seconds


def chosen(*arguments, planner="mppi"):
    return Choices(*parse(planner, [*SMALL, *arguments]))


@pytest.mark.parametrize("planner", SEARCHES)
def test_every_task_has_a_value_for_every_option(planner):
    asked = ["--search.finest", "0.5"] if hasattr(SEARCHES[planner].config(), "finest") else []
    choices = Choices(*parse(planner, asked))
    for task in CARDS:
        values = choices.changed("env", task).values
        assert [name for name, value in values.items() if value is None] == ["checkpoint"]
        assert values.get("search.finest", CARDS[task].planning.finest) == CARDS[task].planning.finest


@pytest.fixture
def live():
    made = Live(chosen())
    yield made
    made.close()


def done(order):
    return order.result(PATIENCE)


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_smoothing_that_is_switched_off_and_on_again_is_what_it_was():
    choices = chosen("--smooth", "--smooth.rate", "3")
    off = choices.changed("smooth", False)
    assert off.plan == chosen().plan and not off.values["smooth"]
    on = off.changed("smooth", False).changed("env", "fetch_wall").changed("env", "point_maze").changed("smooth", True)
    assert on.plan.smooth.rate == 3 and on.plan == choices.plan
    assert chosen().changed("smooth", True).plan == chosen("--smooth").plan
    for way in (["smooth", False], ["icem", True, False], [True, "smooth", False]):  # what one search has stays with it
        choices = chosen()
        for step in (*way, "cem", True):
            choices = choices.changed("smooth" if isinstance(step, bool) else "planner", step)
        assert choices.plan.smooth == chosen("--smooth").plan.smooth


def test_it_lives_the_episode_that_the_command_plans(live):
    session = Session.open(*parse("mppi", SMALL))
    planned = session.run_episode(3)
    session.close()
    for _ in planned.steps:
        done(live.step())
    scenery = live.scenery
    assert np.array_equal(scenery.way, planned.achieved_goals) and np.array_equal(scenery.goal, planned.desired_goal)
    assert [one.step.cost for one in scenery.lived] == planned.column("cost").tolist()
    assert "step 50 of 50" in progress(scenery, 3, False)


def test_another_option_makes_what_the_command_line_makes_of_it(live):
    done(live.step())
    done(live.change("search.samples", 16))
    assert live.choices == Choices(*parse("mppi", [*SMALL, "--samples", "16"])) and live.scenery.number == 0
    done(live.step())
    assert len(live.scenery.plan.costs) == 16
    done(live.change("planner", "icem"))
    done(live.change("cost", "shortest_path"))
    own = parse("icem", ["--env", "point_maze", "--threads", "1", "--seed", "3", "--cost", "shortest_path"])
    assert live.choices == Choices(*own)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("search.samples", 2, "--samples is 2; .* at least 4"),
        ("search.temperature", -1.0, "temperature is -1"),
        ("cost", "nonsense", "unknown cost 'nonsense'"),
        ("env", "fetch_wal", "unknown environment 'fetch_wal'"),
        ("planner", "mpi", "choose from: mppi"),
        ("checkpoint", "fetch_reach", "fetch_reach"),
        ("seed", -1, "seed is -1"),
    ],
)
def test_an_impossible_option_is_refused_in_a_sentence_and_changes_nothing(live, name, value, sentence):
    before = live.choices
    with pytest.raises(UserError, match=sentence):
        done(live.change(name, value))
    assert live.problem and live.choices is before
    done(live.step())  # as if nothing had been
    assert live.scenery.number == 1 and not live.problem


def test_a_cost_that_the_task_lacks_leaves_the_old_simulation(live):
    done(live.change("env", "fetch_reach"))
    with pytest.raises(UserError, match="true shortest path of fetch_reach is not known"):
        done(live.change("cost", "shortest_path"))
    done(live.step())
    assert live.choices.plan.cost == "distance" and live.scenery.number == 1


def test_a_goal_that_was_put_elsewhere_stays_until_the_episode_begins_anew(live):
    own, elsewhere = live.scenery.goal, np.array([-0.5, 0.5])
    done(live.move_goal(elsewhere))
    done(live.step())
    assert np.array_equal(live.scenery.goal, elsewhere)
    done(live.change("search.samples", 16))
    assert np.array_equal(live.scenery.goal, elsewhere)
    done(live.reset())
    assert np.array_equal(live.scenery.goal, own)


def test_it_runs_until_it_is_paused_and_goes_on_with_the_next_seed(live):
    live.goes_on = True
    done(live.run())
    until(lambda: live.choices.run.seed > 3)  # fifty steps later
    done(live.pause())
    at = live.scenery
    time.sleep(0.2)
    assert live.scenery is at and not live.running
    assert lateness(at, False).startswith("The simulation waits for its plans")


def test_in_real_time_it_does_not_wait_for_plans(live):
    live.realtime = True
    done(live.run())
    until(lambda: live.scenery.number > 0)
    start, first = time.monotonic(), live.scenery.number
    until(lambda: live.scenery.number >= first + 10)
    took = time.monotonic() - start
    done(live.pause())
    assert took > 8 * live.scenery.session.control_period  # never faster than the world
    assert lateness(live.scenery, True).startswith("In real time with the newest plan: ")
    assert all(one.late_ms >= one.step.plan_ms and one.late_steps >= 0 for one in live.scenery.lived)


def test_a_plan_beside_the_simulation_is_moved_on_to_its_control_step_and_runs_out():
    session = Session.open(*parse("mppi", SMALL))
    observation, world = session.begin(3), session.env.unwrapped
    from napsp.envs.state import get_state

    shifts, planner = [], session.controller.planner
    own = planner.shift
    planner.shift = lambda matrix: (shifts.append(1), own(matrix))
    newest = NewestPlan(session.controller)
    for number in (0, 4):
        newest.offer(number, get_state(world.model, world.data), observation, np.zeros((0, 2), np.float32))
        until(lambda number=number: newest.newest is not None and newest.newest.job.number == number)
    planned = newest.newest
    newest.close()
    session.close()
    assert len(shifts) == 4
    assert np.array_equal(planned.action(4), planned.plan.actions[0])
    assert np.array_equal(planned.action(6), planned.plan.actions[2])
    assert not planned.action(4 + session.horizon).any()


def test_a_step_after_real_time_goes_on_from_what_was_executed():
    trial = Trial(Session.open(*parse("mppi", [*SMALL, "--low-pass", "0.5"])), 3)
    controller, seen = trial.session.controller, []
    own = controller.smoother.__class__.__call__

    class Watched(controller.smoother.__class__):
        def skip(self, steps):
            seen.append(steps)

        def __call__(self, state, observation, actions, executed):
            seen.append(executed.copy())
            return own(self, state, observation, actions, executed)

    controller.smoother.__class__ = Watched
    trial.advance()
    plan, done = trial.plan, []
    for late in (1, 2):  # of the only plan, as in real time
        done.append(plan.actions[late])
        trial.execute(done[-1], plan, 0.0, 1.0, late)
    trial.advance()
    trial.session.close()
    assert len(seen[0]) == 0 and seen[1] == 2
    np.testing.assert_array_equal(seen[2], done)


def test_what_fails_beside_the_simulation_stops_it_with_a_sentence(live, monkeypatch):
    def fails(*_):
        raise UserError("--cost my:own failed; correct the function")

    monkeypatch.setattr(live.scenery.session.controller, "plan_from", fails)
    live.realtime = True
    done(live.run())
    until(lambda: not live.running)
    until(lambda: live.problem)
    assert live.problem == "--cost my:own failed; correct the function"


def test_a_place_in_the_world_means_the_goal_that_lies_there(worlds):
    for name, world in worlds.items():
        goals = [world.reset(seed=seed)[0]["desired_goal"].copy() for seed in range(4)]
        assert free_axes(world, goals[0]) is not None, name
        for goal in goals[1:]:
            found = goal_at(world, goals[0], world.goal_positions(goal))
            assert np.allclose(world.goal_positions(found), world.goal_positions(goal), atol=1e-3), name
            assert len(found) == len(goal)


def test_the_camera_looks_at_the_task(worlds):
    for name, world in worlds.items():
        position, at = viewpoint(world, world.model)
        ahead = (at - position) / np.linalg.norm(at - position)
        to_goal = world.goal_positions(world.reset(seed=0)[0]["desired_goal"]) - position
        assert ahead @ to_goal / np.linalg.norm(to_goal) > 0.9, name
        assert abs(ahead[2]) < 0.95, name  # there is an upright


def test_the_field_is_a_bowl_with_the_goal_at_its_bottom():
    steps = np.full((5, 5), 8.0)
    steps[1, 3], steps[4, 4] = 0.0, np.inf
    vertices, faces, colors = surface(steps, 2.0)
    bottom = vertices[:, 2].argmin()
    assert bottom == 8 and vertices[bottom, :2] == pytest.approx((0.8, -0.8))
    assert np.isfinite(vertices).all() and (vertices[:, 2] < 0).all() and colors.shape == (25, 4)
    edges = vertices[faces][:, 1:] - vertices[faces][:, :1]
    assert (np.cross(edges[:, 0], edges[:, 1])[:, 2] > 0).all() and len(faces) == 32  # all seen from above


def test_curves_have_a_point_per_step_and_a_gap_where_a_plan_diverged(live):
    assert all(len(column) == 1 for chart in columns((), 100.0) for column in chart)
    done(live.step())
    done(live.step())
    (_, cost, to_go), (number, _), (*_, period) = columns(live.scenery.lived, 100.0)
    assert number.tolist() == [1, 2] and np.isfinite([cost, to_go]).all() and period.tolist() == [100, 100]


def test_checkpoints_of_a_task_are_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("fetch_wall-ours-s1", "fetch_wall_high-ours-s1", "claw-ours-s0"):
        folder = tmp_path / "runs" / name
        folder.mkdir(parents=True)
        (folder / "model.safetensors").touch()
    assert checkpoints("fetch_wall") == ["fetch_wall", "fetch_wall_plus", "runs/fetch_wall-ours-s1"]
    shipped = sorted(path.parent.name for path in SHIPPED.glob("*/model.safetensors"))
    listed = sorted(name for task in CARDS for name in checkpoints(task) if not name.startswith("runs"))
    assert shipped == listed  # each once


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--episodes", "3"], "--episodes means nothing to the studio"),
        (["--planner", "mpi"], "did you mean mppi"),
        (["--prot", "9000"], "there is no option --prot; did you mean --port"),
        (["--port", "0"], "port is 0"),
        (["--samples", "1"], "--samples is 1"),
    ],
)
def test_its_command_line_refuses_what_means_nothing(arguments, sentence):
    with pytest.raises(UserError, match=sentence):
        serve.read(arguments)


def test_its_command_line_takes_the_planners_options():
    options, choices = serve.read([*SMALL, "--port", "9000", "--planner", "cem", "--search.elites", "3"])
    assert options.port == 9000 and choices.plan.planner == "cem" and choices.plan.search.elites == 3


def test_without_the_extra_it_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mjviser", None)
    with pytest.raises(UserError, match=r"pip install 'napsp\[studio\]'"):
        serve.run(SMALL)
