"""The figure of policy against planner shows today's rows, of each training its last checkpoint."""

from pathlib import Path

import pytest
from matplotlib.axes import Axes

from benchmarks import versus_figure
from benchmarks.cells import RUNS, figures_folder
from benchmarks.curves import Line
from benchmarks.policy_vs_mpc import VersusOptions


def rows(method, episodes, budgets):
    line = Line(method)
    common = {"env": "point_maze", "line": line, "training_episodes": str(episodes), "success_rate": "0.5"}
    planned = [{**common, "planner": "mppi", "proposals": "1", "budget": str(budget)} for budget in budgets]
    return [{**common, "planner": "policy", "proposals": "0", "budget": "0"}, *planned]


@pytest.fixture
def plotted(monkeypatch):
    found, plot = [], Axes.plot
    monkeypatch.setattr(Axes, "plot", lambda self, *xy, **looks: (found.append(xy), plot(self, *xy, **looks))[1])
    return found


def test_a_training_of_fewer_episodes_is_not_left_out(plotted, tmp_path):
    path = versus_figure.draw([*rows("ours", 11_000, (64,)), *rows("plus", 4_000, (4, 16, 64))], tmp_path)
    assert path == tmp_path / "policy_vs_mpc_point_maze.png" and path.is_file()
    assert ((4, 16, 64), (0.5, 0.5, 0.5)) in plotted


@pytest.mark.parametrize(
    ("changes", "trial"),
    [({}, False), ({"checkpoint": Path("point_maze_plus")}, False), ({"checkpoint": Path("runs/mine")}, True),
     ({"training_seed": 3}, True), ({"seed": 5}, True), ({"episodes": 2}, True), ({"budgets": (4,)}, False)],
)  # fmt: skip
def test_figures_of_trials_lie_beside_their_runs(changes, trial):
    assert (figures_folder(VersusOptions(**changes)) == RUNS) is trial


def test_a_figure_of_rows_that_are_no_more_goes(plotted, tmp_path):
    old = tmp_path / "policy_vs_mpc_point_maze.png"
    old.write_bytes(b"of older rows")
    assert versus_figure.draw(rows("ours", 1000, (64,)), tmp_path) is None
    assert not old.exists() and not plotted
