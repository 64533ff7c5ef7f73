"""The sweep: cells are skipped, shared and published; figures come from published rows only."""

import json
import multiprocessing
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tiny import tiny

from benchmarks import cells, curves, distance_as_cost, policy_vs_mpc, smoothing, sweep, tables_training
from benchmarks.curves import Line
from napsp.config import from_dict, identity_of, preset, to_dict
from napsp.envs.cards import CARDS
from napsp.execution import Execution
from napsp.settings import changed, digest, flat
from napsp.statistics import describe, interquartile_mean, paired_difference, paired_proportions
from napsp.storage.lock import BusyError

ROOT = Path(__file__).parents[1]


def tiny_preset(env, method="ours", recipe="paper", changes=None, **more):
    return tiny(env, method, recipe, **(changes or {}), **more)


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for module in (sweep, curves):
        monkeypatch.setattr(module, "preset", tiny_preset)
    monkeypatch.setattr(curves, "_usual", curves._usual.__wrapped__)  # it remembers what presets are
    return tmp_path


OPTIONS = sweep.SweepOptions(envs=("point_maze",), methods=("sparse", "ours"), seeds=2)


def test_sweep_trains_every_cell_once_and_publishes_it(workplace, monkeypatch):
    sweep.work(OPTIONS)
    files = sorted(path.name for path in cells.ROWS.glob("*.json"))
    assert [name.rsplit("-", 1)[0] for name in files] == [
        f"point_maze-{method}-s{seed}" for method in ("ours", "sparse") for seed in (0, 1)
    ]
    run = json.loads((cells.ROWS / files[0]).read_text())
    assert run["config"]["method"] == "ours" and [row["episodes"] for row in run["curve"]] == [8, 12, 16]
    assert {"success_rate", "max_reward", "merging_rate"} <= run["curve"][0].keys() and run["curve"][0][
        "max_reward"
    ] < 0

    monkeypatch.setattr(cells, "train", lambda *_: pytest.fail("a finished cell was trained again"))
    sweep.work(OPTIONS)
    shutil.rmtree(cells.RUNS)  # results that came along with the code count as well
    sweep.work(OPTIONS)
    runs = curves.current_runs("point_maze")
    assert {line.name: len(found) for line, found in runs.items()} == {"sparse": 2, "ours": 2}
    episodes, means, _ = curves.over_seeds(runs[Line("ours")], "max_reward")
    expected = np.mean([run["curve"][0]["max_reward"] for run in runs[Line("ours")]])
    assert list(episodes) == [8, 12, 16] and means[0] == pytest.approx(expected)
    monkeypatch.setattr(sys, "argv", ["curves"])
    assert curves.main() == 0
    assert (cells.RESULTS / "figure3.png").read_bytes()[:4] == b"\x89PNG"


def test_a_cell_in_work_elsewhere_is_left_out(workplace, capsys):
    first, second = (config for config in sweep.cells(OPTIONS) if config.seed == 0)
    script = (
        "import sys, time, pathlib; from benchmarks.cells import exclusive\n"
        f"with exclusive(pathlib.Path({str(cells.RUNS / cells.cell_name(first))!r}), False):\n"
        "    print('held', flush=True); time.sleep(60)"
    )
    holder = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(BusyError):
            cells.trained(first, wait=False)
        sweep.work(sweep.SweepOptions(envs=("point_maze",), methods=("sparse", "ours"), seeds=1))
        assert "in work elsewhere" in capsys.readouterr().out
        assert not (cells.ROWS / f"{cells.cell_name(first)}.json").exists()
        assert (cells.ROWS / f"{cells.cell_name(second)}.json").exists()
    finally:
        holder.kill()
        holder.communicate()
    assert cells.trained(first, wait=False).is_dir(), "a killed process lets go of its cell"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_ray_trains_the_same_cells(workplace):
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        sweep.work_on_ray(sweep.SweepOptions(envs=("point_maze",), methods=("sparse", "ours"), seeds=1))
    finally:
        ray.shutdown()
    assert len(list(cells.ROWS.glob("*.json"))) == 2


def test_smoothing_runs_each_cell_once_and_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(smoothing, "RESULTS", tmp_path)
    monkeypatch.setattr(cells, "RUNS", tmp_path / "runs")
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 4)
    arguments = ["--env", "point_maze", "--episodes", "2", "--variants", "plain", "smoothed", "low-pass 0.6"]
    monkeypatch.setattr(sys, "argv", ["smoothing", *arguments])
    assert smoothing.main() == 0
    rows = cells.read_results(tmp_path / "smoothing.csv")
    assert [row["variant"] for row in rows] == ["plain", "smoothed", "low-pass 0.6"]
    assert [row["first_hits"] for row in rows] == ["- -"] * 3 and rows[1]["calls"] == "8" and not rows[0]["calls"]
    assert "accepted" in capsys.readouterr().out
    assert (tmp_path / "runs" / "smoothing_point_maze_mppi.png").read_bytes()[:4] == b"\x89PNG"
    monkeypatch.setattr(smoothing, "run_cell", lambda *_: pytest.fail("a finished cell was run again"))
    assert smoothing.main() == 0


@pytest.mark.parametrize(("module", "file", "changes"), [
    (smoothing, "smoothing.csv",
     ["planner_config", "training", "training_seed", "threads", "episodes", "seed", "variant"]),
    (policy_vs_mpc, "policy_vs_mpc.csv", ["planner_config", "training", "training_seed", "episodes", "seed"]),
    (distance_as_cost, "distance_as_cost.csv",
     ["planner", "planner_config", "training", "samples", "episodes", "seed", "variant"]),
])  # fmt: skip
def test_tables_leave_out_rows_of_other_settings(module, file, changes):
    rows = cells.read_results(ROOT / "results" / file)
    rows = [row for row in rows if row["env"] == "fetch_wall" and row.get("budget") != "0"]
    row = next(row for row in rows if row["training"] and module.comparable([row]))
    other = {"training": cells.as_text(preset("fetch_wall", changes={"batch_size": 7}).identity())}
    assert not any(module.comparable([{**row, name: other.get(name, "7")}]) for name in changes)
    assert not module.comparable([{**row, "training": '{"unknown":"f6c8ff2ca8"}'}])


def test_first_episode_of_a_success_rate_is_a_median_in_which_never_counts():
    runs = [{"curve": [{"episodes": e, "success_rate": r} for e, r in zip((100, 200, 300), rates, strict=True)]}
            for rates in ((0.0, 0.6, 0.4), (0.5, 1.0, 1.0), (0.0, 0.0, 0.9))]  # fmt: skip
    assert tables_training.first_at(runs, 0.5) == "200 (3 of 3)"
    assert tables_training.first_at(runs, 0.9) == "300 (2 of 3)"
    assert tables_training.first_at(runs, 1.0) == "never (1 of 3)"
    assert tables_training.first_at(runs[::2], 1.0) == "never (0 of 2)"
    assert tables_training.summary([{"max_reward": -0.5}, {}], "max_reward") == "-0.50 (1 seed)"


def test_paired_proportions_equal_a_published_example_and_never_shrink_to_a_point():
    # Newcombe (1998): 36, 12, 2 and 0 pairs have 0.0569 to 0.3404 by method 10.
    first = [1] * 36 + [1] * 12 + [0] * 2
    second = [1] * 36 + [0] * 12 + [1] * 2
    mean, (low, high) = paired_proportions(first, second)
    assert (mean, low, high) == pytest.approx((0.2, 0.0569, 0.3404), abs=5e-5)
    assert paired_proportions(second, first)[1] == pytest.approx((-high, -low))
    mean, (low, high) = paired_proportions([1] * 50, [1] * 50)
    assert mean == 0 and low == -high and 0.05 < high < 0.1, "Wilson's interval of 50 of 50 begins at 0.929"


def test_paired_difference_and_its_interval():
    mean, (low, high) = paired_difference([3.0, 5.0, 4.0, 6.0], [2.0, 3.0, 3.0, 4.0])
    assert mean == 1.5 and 1.0 <= low < mean < high <= 2.0
    assert paired_difference([1.0, 2.0], [1.0, 2.0]) == (0.0, (0.0, 0.0))


def test_interquartile_mean_and_its_interval():
    mean, interval = interquartile_mean([0.0, 0.5, 0.6, 0.7, 1.0, 0.6, 0.6, 0.6])
    assert mean == pytest.approx(0.6) and interval[0] <= 0.6 <= interval[1]
    assert interquartile_mean([1.0, 1.0, 1.0]) == (1.0, (1.0, 1.0))
    assert interquartile_mean([0.2, 0.4])[1] is None and describe(0.3, None) == "0.30"
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(60):
        low, high = interquartile_mean(rng.normal(0.5, 0.1, 10))[1]
        covered += low <= 0.5 <= high
    assert covered >= 50, "about 95 % of intervals hold the truth (bootstraps of ten run a little short)"


def test_a_shipped_model_of_the_same_settings_is_not_trained_again(workplace, monkeypatch):
    def no_training(*arguments, **options):
        raise AssertionError("trained")

    monkeypatch.setattr(cells, "train", no_training)
    for seed in (0, 1):  # the models that ship counted N(s, a, g) otherwise
        with pytest.raises(AssertionError, match="trained"):
            cells.checkpoint_of(preset("fetch_wall", seed=seed))
    record = {"config": to_dict(preset("fetch_wall", seed=0)), "seed": 0}
    cells.write_json(workplace / "shipped" / "fetch_wall" / "training.json", record)
    monkeypatch.setattr(cells, "SHIPPED", workplace / "shipped")
    assert cells.checkpoint_of(preset("fetch_wall", seed=0)).name == "fetch_wall"
    assert cells.shipped_training("fetch_wall") == (preset("fetch_wall").identity(), 0)
    with pytest.raises(AssertionError, match="trained"):
        cells.checkpoint_of(preset("fetch_wall", seed=1))


def test_what_a_row_stores_is_what_its_configuration_asks():
    changes = {"uncertainty.scale": 20, "hidden": (64, 64), "policy.entropy_weight": 0.1}  # 20 is 20.0
    for env in CARDS:
        config = preset(env, changes=changes, seed=3)
        stored = json.loads(json.dumps(to_dict(config)))
        assert identity_of(stored) == config.identity() == preset(env, changes=changes).identity()
        assert cells.training_of({"training": cells.as_text(config.identity())}) == config.identity()
    assert cells.as_text(config.identity()) == cells.as_text(
        preset(env, changes={**changes, "uncertainty.scale": 20.0}).identity()
    )
    del stored["counts"], stored["policy"]["agent"]  # added later: they were as they are by default
    assert identity_of(stored) == {k: v for k, v in config.identity().items() if k != "policy.agent"}
    by_hand = changed(preset("fetch_pick_place"), flat(preset("fetch_pick_place", recipe="manipulation").identity()))
    assert by_hand.identity() == preset("fetch_pick_place", recipe="manipulation").identity(), "a recipe is its values"


def test_a_row_with_an_option_that_is_unknown_today_is_not_todays():
    stored = to_dict(preset("fetch_wall"))
    assert curves.line_of(identity_of(stored)) == Line("ours")
    stored["counts"]["reached_bits"] = 16
    assert identity_of(stored) == {**preset("fetch_wall").identity(), "counts.reached_bits": 16}
    line = curves.line_of(identity_of(stored))
    assert line.name == "ours, one key" and line != line.of_today() == Line("ours")
    stored["counts"]["colour"] = "red"
    assert curves.line_of(identity_of(stored)) is None, "an option without a name makes no line"


def test_lines_are_called_by_recipe_and_by_what_they_have_otherwise():
    changes = {"temporal.first_arrival": True, "episodes_per_iteration": 2, "n_episodes": 4000}
    config = preset("fetch_pick_place", "ours", "manipulation", changes)
    line = curves.line_of(config.identity())
    assert line.name == "ours + manipulation, first arrival, 2 episodes per iteration" and not line.in_figures
    assert curves.line_of(preset("fetch_pick_place", "ddl").identity()).name == "ddl"
    assert curves.line_of(preset("fetch_wall", changes={"batch_size": 7}).identity()) is None
    further = curves.line_of(preset("point_maze", "qrl", changes={"qrl.push_until": 40.0}).identity())
    assert further.name == "qrl, pushed apart up to 40 steps" and not further.in_figures
    for env in ("point_maze", "fetch_wall", "fetch_pick_place"):
        assert curves.line_of(preset(env, "plus", cells.usual_recipe(env)).identity()).method == "plus"
    assert [line.name for line in curves.expected_lines("fetch_pick_place")][:2] == [
        "sparse + manipulation", "ddl + manipulation",
    ]  # fmt: skip
    assert curves.expected_lines("fetch_wall")[-2:] == [Line("ours"), Line("plus")]


def test_a_line_of_an_older_version_is_shown_until_todays_is_run(workplace):
    older = to_dict(tiny())
    older["counts"]["reached_bits"] = 16
    row = {"episodes": 16.0, "success_rate": 0.5}
    cells.write_json(cells.ROWS / "point_maze-ours-s0-a.json", {"seed": 0, "config": older, "curve": [row]})
    assert [line.name for line in curves.current_runs("point_maze")] == ["ours, one key"]
    table = [line for line in tables_training.learning_table() if line.startswith("| point_maze |")]
    assert [line.split(" | ")[1:3] for line in table[-3:-1]] == [["ours", "not run"], ["ours, one key", "1"]]
    cells.write_json(cells.ROWS / "point_maze-ours-s0-b.json", {"seed": 0, "config": to_dict(tiny()), "curve": [row]})
    assert [line.name for line in curves.current_runs("point_maze")] == ["ours"]


def test_rows_of_results_hold_configurations_and_no_hash():
    paths = sorted((ROOT / "results" / "runs").glob("*.json"))
    usual = flat(to_dict(preset("point_maze")))
    for path in paths:
        run = json.loads(path.read_text())
        identity, known = identity_of(run["config"]), {k: v for k, v in flat(run["config"]).items() if k in usual}
        assert path.stem.endswith(f"-s{run['seed']}-{digest(identity)}") and "config_hash" not in run
        unknown = {name: value for name, value in flat(run["config"]).items() if name not in usual}
        assert identity == {**from_dict(known).identity(), **unknown}
    assert len({path.name for path in paths}) == len(paths) > 0
    for path in (ROOT / "results").glob("*.csv"):
        rows = cells.read_results(path)
        assert not {name for name in rows[0] if name.endswith("hash")}, path
        for row in rows:
            if training := row.get("training"):
                assert cells.as_text(json.loads(training)) == training


def test_the_sweep_asks_for_recipe_labels_and_execution(monkeypatch):
    options = sweep.SweepOptions(
        envs=("fetch_pick_place",), methods=("ours", "ddl"), seeds=1, recipe="manipulation", first_arrival=True,
        n_episodes=4000, compiled=True,
    )  # fmt: skip
    ours, ddl = sweep.cells(options)
    assert ours == preset("fetch_pick_place", "ours", "manipulation", {"temporal.first_arrival": True}, n_episodes=4000)
    assert ddl == preset("fetch_pick_place", "ddl", "manipulation", n_episodes=4000)
    assert sweep.execution(options) == Execution(compiled=True)


def append_rows(path, name):
    for i in range(30):
        cells.add_result(path, {"name": name, "i": i}, {})


def test_processes_that_append_at_once_lose_no_row(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=append_rows, args=(tmp_path / "rows.csv", name)) for name in "ab"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert len(cells.read_results(tmp_path / "rows.csv")) == 60
