"""How plans are made is one configuration: from the command line, from Python, in a row and in a folder's name."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import napsp
import planners
from benchmarks.cells import read_results
from benchmarks.planned import COLUMN, column
from mpc.smoothing.config import SmoothingConfig
from napsp.envs.cards import CARDS
from napsp.errors import UserError
from napsp.settings import as_flags
from planners.app import options
from planners.app.cli import run
from planners.app.config import ModelConfig, PlanConfig
from planners.app.options import RunOptions, parse
from planners.app.record import default_folder
from planners.app.searches import SEARCHES, Search
from planners.mppi import MPPIConfig
from planners.predictive_sampling import PredictiveSampling, PredictiveSamplingConfig

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("planner", SEARCHES)
def test_nothing_said_is_the_defaults(planner):
    config, circumstances = parse(planner, [])
    assert config == PlanConfig.of(planner) and circumstances == RunOptions()
    assert config.search == SEARCHES[planner].config()
    assert config.identity() == {"horizon": 5}, "of the task"
    sized = {"finest": 1.0} if hasattr(config.search, "finest") else {}
    resolved = replace(config, search=replace(config.search, **sized), horizon=5, smooth=config.resolved().smooth)
    assert config.resolved() == resolved


@pytest.mark.parametrize(("planner", "changes"), [
    ("mppi", {"env": "point_maze", "search.temperature": 0.5, "search.samples": 32, "spline.knots": 3}),
    ("mppi", {"smooth": True, "smooth.rate": 4.0, "smooth.along": False, "smooth.multiples": [1.0, 2.0]}),
    ("cem", {"search.elites": 3, "where": "terminal", "model.kind": "coarse", "goal": [0.1, 0.2, 0.3]}),
    ("icem", {"proposals": False, "distance.greedy_proposals": True, "low_pass": 0.5}),
    ("smooth", {"search.start": "zero", "smooth.rounds": 1}),
    ("smooth", {"smooth": False, "horizon": 3}),
    ("mppi", {"env": "point_maze", "search.finest": 1.0}),
    ("predictive_sampling", {"env": "point_maze", "search.finest": 0.5}),
])  # fmt: skip
def test_the_identity_is_what_was_asked_and_leads_back(planner, changes):
    config = PlanConfig.of(planner, changes)
    identity = json.loads(json.dumps(config.identity()))
    task = {name: value for name, value in changes.items() if name == "env"}
    assert all(identity[name] == value for name, value in changes.items() if name not in task)
    assert PlanConfig.of(planner, identity | task).identity() == identity
    said, _ = parse(planner, as_flags(identity | task).split())
    assert said.identity() == identity, "a row can be typed"


@pytest.mark.parametrize("planner", ["mppi", "predictive_sampling"])
def test_the_mazes_noise_shrinks_and_that_is_remembered(planner):
    maze, wall = PlanConfig.of(planner, {"env": "point_maze"}), PlanConfig.of(planner)
    assert maze.identity() == {"horizon": 16, "search.finest": 0.1}
    assert (maze.resolved().search.finest, wall.resolved().search.finest) == (0.1, 1.0)
    assert wall.identity() == PlanConfig.of(planner, {"search.finest": 1.0}).identity() == {"horizon": 5}


def test_noise_of_another_task_changes_no_identity(monkeypatch):
    asked = [{"env": env, "search.finest": size} for env in ("fetch_wall", "point_maze") for size in (None, 1.0, 0.1)]
    before = [PlanConfig.of("mppi", changes).identity() for changes in asked]
    card = CARDS["fetch_reach"]
    monkeypatch.setitem(CARDS, "fetch_reach", replace(card, planning=replace(card.planning, finest=0.5)))
    assert PlanConfig.of("mppi", {"env": "fetch_reach"}).identity()["search.finest"] == 0.5
    assert PlanConfig.of("mppi", {"env": "fetch_reach", "search.finest": 1.0}).identity()["search.finest"] == 1.0
    assert [PlanConfig.of("mppi", changes).identity() for changes in asked] == before


def test_what_a_task_decides_is_what_its_controller_searches_with():
    for env, finest in (("point_maze", 0.1), ("fetch_reach", 1.0)):
        controller = planners.controller("mppi", napsp.make(env), options={"cost": "euclidean"})
        assert controller.controller.planner.config.finest == finest
        controller.close()


def test_none_fits_only_what_a_task_decides():
    assert PlanConfig.of("mppi", {"search.finest": None}) == PlanConfig.of("mppi")
    with pytest.raises(UserError, match="temperature is None; it must be of kind float"):
        PlanConfig.of("mppi", {"search.temperature": None})


def test_what_is_off_is_no_difference():
    quiet, _ = parse("mppi", ["--no-smooth", "--smooth.rate", "3", "--smooth.multiples", "1", "2"])
    assert quiet.smooth is None and quiet.identity() == PlanConfig.of("mppi").identity()
    assert PlanConfig.of("mppi", {"smooth": False, "smooth.rate": 3.0}) == PlanConfig.of("mppi")
    loud = PlanConfig.of("mppi", {"smooth": True})
    usual = {"smooth": True, "smooth.multiples": [0.3, 1.0, 3.0, 10.0], "smooth.choice": 10.0}
    assert loud.identity() == {"horizon": 5} | usual
    said_aloud = PlanConfig.of("mppi", {"smooth": True, "smooth.multiples": (0.3, 1.0, 3.0, 10.0)})
    assert said_aloud.identity() == loud.identity()


def test_samples_have_a_short_name_and_a_long_one():
    short, long = (parse("cem", [flag, "9"])[0] for flag in ("--samples", "--search.samples"))
    assert short == long and short.search.samples == 9 and type(short.search) is SEARCHES["cem"].config


def test_a_configuration_is_checked_wherever_it_comes_from():
    with pytest.raises(UserError, match=r"--samples is 3; .* give at least 4"):
        PlanConfig("mppi", MPPIConfig(samples=3))
    with pytest.raises(ValueError, match="temperature is 0; it must lie between"):
        MPPIConfig(temperature=0)
    with pytest.raises(UserError, match=r"needs --model.kind coarse"):
        ModelConfig(substeps=2)
    with pytest.raises(UserError, match="rounds is -1; it must lie between"):
        SmoothingConfig(rounds=-1)
    with pytest.raises(UserError, match="there is no option 'lambda' in MPPIConfig"):
        PlanConfig.of("mppi", {"search.lambda": 1.0})


@pytest.mark.parametrize(("planner", "old", "new"), [
    ("mppi", "--temperature=1", "--search.temperature"), ("cem", "--elites", "--search.elites"),
    ("icem", "--noise_exponent", "--search.noise-exponent"), ("smooth", "--start", "--search.start"),
    ("smooth", "--smooth-rounds", "--smooth.rounds"), ("mppi", "--no-smooth-along", "--smooth.no-along"),
    ("mppi", "--knots", "--spline.knots"), ("mppi", "--planning-substeps", "--model.substeps"),
    ("mppi", "--ensemble", "--distance.ensemble"), ("cem", "--no-greedy-proposals", "--distance.no-greedy-proposals"),
])  # fmt: skip
def test_an_old_option_is_answered_with_its_new_name(planner, old, new):
    with pytest.raises(UserError, match=f"is now called {new}$"):
        parse(planner, ["--env", "claw", old, "1"])


def test_every_old_option_leads_to_one_there_is():
    config = PlanConfig.of("mppi")
    for new in options.RENAMED.values():
        group, _, option = new.replace(".no-", ".").replace("-", "_").partition(".")
        assert hasattr(SmoothingConfig() if group == "smooth" else getattr(config, group), option)


def test_other_plans_have_another_folder():
    def folder(planner, *arguments):
        return str(default_folder(*parse(planner, list(arguments))))

    usual = folder("mppi")
    assert usual == "plans/fetch_wall-mppi-distance-s90000"
    assert folder("mppi", "--no-video", "--threads", "1", "--horizon", "5") == usual
    assert folder("mppi", "--env", "point_maze", "--cost", "sparse", "--seed", "7") == "plans/point_maze-mppi-sparse-s7"
    others = [["--samples", "32"], ["--search.temperature", "0.1"], ["--smooth"], ["--checkpoint", "a"],
              ["--checkpoint", "b"], ["--distance.ensemble", "a"], ["--distance.ensemble", "b"], ["--where", "both"],
              ["--goal", "1", "1", "1"], ["--episodes", "3"], ["--hold", "0"]]  # fmt: skip
    names = [folder("mppi", *other) for other in others]
    assert len({usual, *names}) == 1 + len(others) and all(name.startswith(usual + "-") for name in names)
    assert folder("smooth") == "plans/fetch_wall-smooth-distance-s90000"
    assert folder("smooth", "--no-smooth", "--cost", "euclidean").startswith(
        "plans/fetch_wall-smooth-euclidean-s90000-"
    )


@dataclass(frozen=True)
class TimidConfig(PredictiveSamplingConfig):
    """Search close by."""

    reach: float = 0.5
    """Share of the noise that is left."""


class Timid(PredictiveSampling):
    """A search of the user's own."""

    tried = 0

    def sample(self, rng, proposals=None):
        knots = super().sample(rng, proposals)
        type(self).tried += len(knots)
        return self.plan + self.config.reach * (knots - self.plan)


def test_a_search_of_ones_own_is_a_file_and_a_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(SEARCHES, "timid", Search(Timid, TimidConfig))
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 3)
    arguments = ["--env", "point_maze", "--cost", "euclidean", "--episodes", "1", "--samples", "8", "--no-video"]
    assert run("timid", [*arguments, "--search.reach", "0.25", "--out", str(tmp_path)]) == 0
    assert Timid.tried == 3 * 8 and "timid on point_maze" in capsys.readouterr().out
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["differences"] == {
        "cost": "euclidean", "horizon": 16, "search.finest": 0.1, "search.reach": 0.25, "search.samples": 8
    }  # fmt: skip
    assert summary["config"]["search"]["reach"] == 0.25 and summary["run"]["episodes"] == 1


@pytest.mark.parametrize("file", ["policy_vs_mpc", "smoothing", "distance_as_cost"])
def test_published_rows_say_how_they_were_planned(file):
    rows = [row for row in read_results(ROOT / "results" / f"{file}.csv") if row[COLUMN]]
    assert rows
    for row in rows:
        planner = row["planner"].removesuffix(" + smoothing")
        config = PlanConfig.of(planner, {"env": row["env"], **json.loads(row[COLUMN])})
        assert column(config) == row[COLUMN]


def test_plans_do_not_depend_on_how_a_configuration_was_said(monkeypatch):
    from planners.app.session import Session

    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 2)
    found = []
    for config in (parse("mppi", ["--env", "point_maze", "--samples", "8"])[0],
                   PlanConfig("mppi", MPPIConfig(samples=8), env="point_maze", horizon=16)):  # fmt: skip
        session = Session.open(config, RunOptions(threads=1))
        found.append(session.run_episode(0).actions)
        session.close()
    np.testing.assert_array_equal(*found)
