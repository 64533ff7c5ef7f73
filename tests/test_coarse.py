"""A coarser model to plan in: the same state, time and walls; the environment never runs it."""

import json

import mujoco
import numpy as np
import pytest
from conftest import TASKS
from test_rollout import start_episode

from benchmarks import cells, coarse_model
from mpc.controller import Controller
from mpc.cost import Cost, EuclideanSteps
from mpc.rollout import RolloutEngine
from napsp import envs
from napsp.envs.cards import CARDS
from napsp.envs.coarse import coarse
from napsp.envs.dynamics import get_state
from napsp.envs.fetch_arm import GRIPPER_BODIES, LOWER_ARM_BODIES
from napsp.errors import UserError
from napsp.policy.greedy import GreedyPolicy
from napsp.storage.checkpoint import load_model
from napsp.storage.shipped import shipped_model
from planners.app.cli import run
from planners.app.config import PlanConfig
from planners.mppi import MPPI, MPPIConfig


@pytest.mark.parametrize("name", TASKS)
def test_as_many_substeps_and_all_collisions_are_the_exact_model(name, worlds):
    world = worlds[name]
    actions = np.stack([start_episode(world, seed=2, contact=True)[:8]] * 2)
    actions[0] = actions[0, ::-1]
    state = get_state(world.model, world.data)
    same = coarse(world.dynamics, world.dynamics.substeps, fewer_collisions=False)
    assert same.model is not world.model and type(same) is type(world.dynamics)
    with RolloutEngine(world.dynamics, 1) as exact, RolloutEngine(same, 1) as planned:
        expected, found = exact.rollout(state, actions), planned.rollout(state, actions)
    np.testing.assert_array_equal(found.observations, expected.observations)
    np.testing.assert_array_equal(found.achieved_goals, expected.achieved_goals)


@pytest.mark.parametrize("name", [*TASKS, "FetchReach-v4"])
def test_a_control_step_lasts_as_long_and_velocities_keep_their_units(name, worlds):
    world = worlds[name] if name in TASKS else envs.make(name).unwrapped
    world.reset(seed=0)
    own, state, before = world.dynamics.substeps, get_state(world.model, world.data), world.model.opt.timestep
    planned = coarse(world.dynamics, own // 2)
    assert planned.substeps * planned.model.opt.timestep == pytest.approx(own * before)
    assert world.dynamics.substeps == own and world.model.opt.timestep == before
    actions = np.full((1, 3, *world.action_space.shape), 0.3, np.float32)  # free motion
    with RolloutEngine(world.dynamics, 1) as exact, RolloutEngine(planned, 1) as engine:
        expected, found = exact.rollout(state, actions), engine.rollout(state, actions)
    assert not found.diverged.any()
    moved = np.abs(expected.observations[0, -1] - expected.observations[0, 0]).max()
    assert np.abs(found.observations - expected.observations).max() < 0.15 * moved
    if name == "point_maze":  # times in seconds: 0.3 m/s at most
        assert found.observations[0, -1, 2:] == pytest.approx(expected.observations[0, -1, 2:], rel=0.05)


@pytest.mark.parametrize("name", ["fetch_wall", "fetch_pick_place_wall"])
def test_the_wall_stops_the_gripper_in_the_coarse_model(name, worlds):
    world = worlds[name]
    planned = coarse(world.dynamics, CARDS[name].planning.coarse_substeps)
    rng = np.random.default_rng(0)
    world.reset(seed=0)
    pushes = np.zeros((5, 60, 4), np.float32)
    pushes[..., 0], pushes[..., 1] = rng.uniform(-1, 1, (5, 1)), 1.0
    pushes[..., 2] = np.linspace(0, -1, 5)[:, None]
    with RolloutEngine(planned, 1) as engine:
        found = engine.rollout(get_state(world.model, world.data), pushes)
    assert not found.diverged.any()
    assert (found.achieved_goals[..., -2] < world.WALL_Y).all(), "the gripper went through the wall or around it"
    assert (found.observations[:, -1, 1] > world.WALL_Y - world.WALL_HALF_THICKNESS - 0.1).any(), "none came near it"


@pytest.mark.parametrize("obstacle", ["wall", "table0", "object0"])
def test_only_table_and_box_let_the_lower_arm_pass(obstacle, worlds):
    world = worlds["fetch_pick_place_wall"]
    world.reset(seed=0)
    for dynamics, passes in ((world.dynamics, False), (coarse(world.dynamics, 5), obstacle != "wall")):
        touched = _touching(dynamics.model, world, obstacle)
        assert bool(touched & set(LOWER_ARM_BODIES)) == (not passes)
        assert _touching(dynamics.model, world, obstacle, at="robot0:gripper_link") & set(GRIPPER_BODIES)


def _touching(model, world, obstacle, at="robot0:forearm_roll_link"):
    """Bodies that touch an obstacle once the whole robot has been moved there with one of its links."""
    data = mujoco.MjData(model)
    data.qpos[:] = world.data.qpos
    mujoco.mj_forward(model, data)
    geom = model.geom("wall").id if obstacle == "wall" else int(model.body(obstacle).geomadr[0])
    way = data.geom_xpos[geom] - data.body(at).xpos
    for axis in range(3):
        data.qpos[model.joint(f"robot0:slide{axis}").qposadr[0]] += way[axis]
    mujoco.mj_forward(model, data)
    pairs = [contact.geom for contact in data.contact[: data.ncon] if geom in contact.geom]
    return {model.body(model.geom_bodyid[other]).name for pair in pairs for other in pair if other != geom}


def test_the_policys_rollout_is_followed_in_the_planning_model(worlds):
    world = worlds["fetch_wall"]
    observation, _ = world.reset(seed=0)
    state, actor = (
        get_state(world.model, world.data),
        GreedyPolicy(load_model(shipped_model("fetch_wall"), "fetch_wall").policy),
    )
    with RolloutEngine(coarse(world.dynamics, 5), 1) as engine:
        known = engine.follow(state, observation, actor, 5)
        copied, simulated = (engine.rollout(state, known.actions[None], k) for k in ([known], []))
    np.testing.assert_array_equal(copied.observations, simulated.observations)
    assert not copied.diverged.any()


def test_states_of_another_model_are_refused(worlds):
    world, other = worlds["fetch_wall"], worlds["point_maze"]
    observation, _ = world.reset(seed=0)
    cost = Cost(EuclideanSteps(0.1), world.reached)
    with RolloutEngine(other.dynamics, 1) as engine:
        controller = Controller(engine, MPPI(3, 4, MPPIConfig(samples=8)), cost, 3, np.random.default_rng(0))
        with pytest.raises(ValueError, match="does not fit the model that is planned in"):
            controller.plan(world, observation)


@pytest.mark.parametrize("name", ["fetch_wall", "point_maze"])
def test_planning_coarsely_says_so_and_runs_the_environment_exactly(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 3)
    arguments = ["--env", name, "--episodes", "1", "--samples", "8", "--no-video", "--threads", "1"]
    assert run("mppi", [*arguments, "--model.kind", "coarse", "--out", str(tmp_path)]) == 0
    own = 20 if name == "fetch_wall" else 10
    assert f"coarse, 5 physics steps per control step; the environment runs {own}" in capsys.readouterr().out
    config = json.loads((tmp_path / "summary.json").read_text())["config"]
    assert config["model"] == {"kind": "coarse", "substeps": 5}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--model.substeps", "5"], "--model.substeps needs --model.kind coarse"),
        (["--model.kind", "coarse", "--model.substeps", "11"], "exceeds the 10 of point_maze"),
        (["--model.kind", "coarse", "--model.substeps", "0"], "must lie between"),
    ],
)
def test_impossible_substeps_are_one_clear_line(arguments, words, tmp_path):
    with pytest.raises(UserError, match=words) as error:
        run("mppi", ["--env", "point_maze", "--no-video", "--out", str(tmp_path), *arguments])
    assert "\n" not in str(error.value)


def test_fewer_substeps_than_one_and_more_than_the_tasks_are_refused(worlds):
    for n in (0, 11):
        with pytest.raises(ValueError, match="not coarser than the task's own"):
            coarse(worlds["point_maze"].dynamics, n)


def test_the_identity_tells_planning_models_apart():
    chosen = [PlanConfig.of("mppi", {"model.kind": "coarse", "model.substeps": n}).identity() for n in (None, 5, 4)]
    assert chosen[0] == chosen[1] == {"horizon": 5, "model.kind": "coarse", "model.substeps": 5}, "a default said aloud"
    assert chosen[2]["model.substeps"] == 4
    assert PlanConfig.of("mppi").identity() == {"horizon": 5}, "plans are made as before: results on disk stay valid"


def test_benchmark_writes_a_row_per_model_and_kind_of_actions(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(coarse_model, "RESULTS", tmp_path)
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 4)
    arguments = ["--env", "point_maze", "--env", "fetch_wall", "--episodes", "1", "--samples", "2", "--horizon", "2"]
    monkeypatch.setattr("sys.argv", ["coarse_model", *arguments])
    for _ in range(2):  # measured again, rows are replaced
        assert coarse_model.main() == 0
    rows = cells.read_results(tmp_path / "coarse_model.csv")
    assert [row["substeps"] for row in rows if row["actions"] == "policy"] == [*"521", "20", "10", *"5421"]
    assert {row["actions"] for row in rows} == {"random", "held", "policy"} and len(rows) == 3 * (3 + 6)
    assert all(float(row["speedup_cpu"]) > 0 and float(row["error_median"]) < 0.2 for row in rows)
    same = next(row for row in rows if row["substeps"] == "20" and row["actions"] == "random")
    assert float(same["error_max"]) == 0.0 and same["diverged"] == "0" and same["rollouts"] == "4"
    assert "median" in capsys.readouterr().out
