"""Throughput: every planner has a row, peers simulate what napsp would, sizes become a fitted line. No timing."""

import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import cells, peers, scaling, throughput
from benchmarks.batch_simulator import Problem, UnavailableError, make_simulator
from mpc.rollout import RolloutEngine
from napsp.envs.dynamics import get_state


@pytest.fixture
def command(tmp_path, monkeypatch):
    for module in (throughput, scaling):
        monkeypatch.setattr(module, "RESULTS", tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["throughput", "--env", "point_maze", "--rounds", "2", *arguments])
        return throughput.main()

    return run


def test_a_planner_that_is_not_installed_has_a_row(command, tmp_path, monkeypatch, capsys):
    def missing(name):
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(peers, "importlib", SimpleNamespace(import_module=missing))
    for samples in ("4", "4", "5"):  # measured again, the rows of a size are replaced
        assert command("--samples", samples, "--horizon", "2") == 0
    rows = cells.read_results(tmp_path / "throughput.csv")
    planners = ["raw", "napsp", "judo", "pytorch-mppi", "mbrl-lib"]
    assert [(row["samples"], row["planner"]) for row in rows] == [(n, name) for n in "45" for name in planners]
    raw, ours, *others = rows[:5]
    assert raw["over_raw_cpu"] == raw["over_raw_wall"] == "1.0" and not raw["over_replay_cpu"]
    assert all(float(ours[name]) > 0 for name in ours if name.startswith("over_") or name.endswith("_ms"))
    assert all("not installed" in row["note"] and "pip install" in row["note"] and not row["cpu_ms"] for row in others)
    assert capsys.readouterr().out.count("not installed") == 9


@pytest.mark.parametrize("name", peers.PEERS)
@pytest.mark.parametrize("task", ["point_maze", "fetch_wall"])
def test_an_installed_peer_simulates_as_much(worlds, name, task):
    world = worlds[task]
    observation, _ = world.reset(seed=0)
    problem = Problem(world, 3, 2, 0.8, 1)
    try:
        peer = peers.PEERS[name](problem)
    except UnavailableError as error:
        pytest.skip(str(error))
    peer.plan(get_state(world.model, world.data), observation)
    throughput.check_physics({name: peer}, problem)
    assert peer.actions.shape == (3, 2, world.action_space.shape[0])
    peer.close()


def test_other_amounts_of_physics_are_refused(worlds):
    problem, peer = Problem(worlds["point_maze"], 3, 2, 0.8, 1), SimpleNamespace(physics_steps=59)
    with pytest.raises(RuntimeError, match="59 physics steps instead of 60"):
        throughput.check_physics({"peer": peer}, problem)


@pytest.mark.parametrize(
    ("task", "n_steps", "tolerance"), [("claw", 3, 1e-8), ("claw", 1, 1e-8), ("fetch_wall", 1, 5e-3)]
)
def test_batch_simulator_leads_to_the_same_goals(worlds, task, n_steps, tolerance):
    world = worlds[task]
    world.reset(seed=1)
    state = get_state(world.model, world.data)
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 3, world.action_space.shape[0]))
    simulator = make_simulator(Problem(world, 4, 3, 0.8, 1), n_steps)
    goals = simulator.rollout(state, actions)
    assert simulator.physics_steps == 4 * 3 * world.dynamics.substeps
    simulator.close()
    with RolloutEngine(world.dynamics, 1) as engine:
        expected = engine.rollout(state, actions).achieved_goals
    # Fetch: the sensors behind the mocap target lag by one physics step.
    assert np.abs(goals - expected).max() < tolerance < np.abs(expected[:, -1] - expected[:, 0]).max()


def test_tasks_without_a_dynamics_function_say_so(worlds):
    with pytest.raises(UnavailableError, match="no dynamics"):
        make_simulator(Problem(worlds["fetch_pick_place"], 4, 3, 0.8, 1), 1)
    with pytest.raises(UnavailableError, match="cannot express"):
        peers.Judo(Problem(worlds["fetch_wall"], 4, 3, 0.8, 1))


def test_scaling_measures_every_size_and_fits_lines(command, tmp_path, capsys):
    sizes = ("--samples", "4", "6", "8", "--horizon", "1", "2")
    for _ in range(2):
        assert command("--scaling", "--cost", "euclidean", "--threads", "1", *sizes) == 0
    rows = cells.read_results(tmp_path / "throughput_scaling.csv")
    work = [int(row["samples"]) * int(row["horizon"]) for row in rows]
    assert work == sorted(work) and len(rows) == 6
    assert all(float(row["peak_mb_before"]) > 0 for row in rows)
    assert (tmp_path / "throughput_scaling_point_maze.png").read_bytes()[:4] == b"\x89PNG"
    assert "R² =" in capsys.readouterr().out


def test_fitted_line():
    x = np.array([1.0, 2.0, 4.0])
    assert scaling.fit_line(x, 3.0 + 0.5 * x) == pytest.approx((3.0, 0.5, 1.0))
    y = np.array([1.0, 3.0, 2.0])
    assert scaling.fit_line(x, y)[2] == pytest.approx(np.corrcoef(x, y)[0, 1] ** 2)


@pytest.mark.slow
def test_the_speed_command_runs_where_nothing_else_prepared_stock_robots():
    command = [sys.executable, "-m", "benchmarks.rollout_speed", "--samples", "8", "--horizon", "2", "--rounds", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    speeds = re.findall(r"^(?:plan_over|collection_speedup)\S* +([\d.]+)$", done.stdout, re.MULTILINE)
    assert len(speeds) == 10 and all(float(speed) > 0 for speed in speeds)
