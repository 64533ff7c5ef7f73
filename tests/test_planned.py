"""How the rows of results are planned, and whether models that ship are of today's training."""

import numpy as np
import pytest

from benchmarks import cells, distance_as_cost
from benchmarks.curves import full_line_of
from benchmarks.planned import of_budget
from napsp.config import preset
from napsp.storage.shipped import SHIPPED
from planners.app.searches import SEARCHES


@pytest.mark.parametrize("planner", ["mppi", "cem", "icem", "predictive_sampling"])
@pytest.mark.parametrize("budget", [16, 32, 64])
def test_a_budget_is_the_plans_of_all_refinements(planner, budget):
    config = of_budget(planner, budget, {"env": "point_maze", "proposals": False})
    search, simulated = SEARCHES[planner].kind(3, 2, config.search), 0
    for _ in range(config.search.refinements):
        knots = search.sample(np.random.default_rng(0))
        search.update(knots, np.arange(len(knots), dtype=float))
        simulated += len(knots)
    assert abs(simulated - budget) <= 2


def test_lines_with_a_search_of_their_own_keep_it_and_its_plans():
    options = distance_as_cost.CostOptions(env="fetch_pick_place", samples=16)
    plain, own = ("plus: distance, mean", "plus, iCEM of 32 plans: distance, mean, no policy proposals")
    for line, search, plans in ((plain, "mppi", 16), (own, "icem", 32), ("plus: policy alone", "", 16)):
        config = distance_as_cost.plan_config(options.env, line, options)
        assert (distance_as_cost.search_of(line), distance_as_cost.plans_of(line, options)) == (search, plans)
        assert config == (of_budget(search, plans, {**distance_as_cost.VARIANTS[line].planner, "env": options.env})
                          if search else None)  # fmt: skip


def test_d_alone_acts_without_plans_and_asks_no_policy(monkeypatch):
    monkeypatch.setattr(distance_as_cost, "GreedyPolicy", None)
    line, options = "plus: the action of least d, no plans", distance_as_cost.CostOptions(env="fetch_wall", episodes=2)
    found = distance_as_cost.run_cell(options.env, line, SHIPPED / "fetch_wall_plus", options)
    assert found["success_rate"] == 1 and found["plan_ms_median"] == 0 and 4 < found["mean_steps_to_goal"] < 25
    assert distance_as_cost.plan_config(options.env, line, options) is None and distance_as_cost.search_of(line) == ""


@pytest.mark.parametrize("name", sorted(path.name for path in SHIPPED.glob("*_plus")))
def test_models_of_plus_that_ship_are_trained_as_the_tables_say(name):
    training, seed = cells.recorded_training(SHIPPED / name)
    line = full_line_of(training)
    assert line is not None and line == line.of_today() and line.method == "plus"
    assert preset(training["env"], "plus", line.recipe, seed=seed).identity() == training
