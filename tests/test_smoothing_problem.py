"""What the smoothing layer solves: roughness is its formula, and solvers find the optimum."""

import numpy as np
import pytest
from scipy.optimize import minimize
from test_smoothing_distance import random_model

from mpc.filters import LowPass
from mpc.motion import action_rate, jerk
from mpc.smoothing.distance import SmoothDistance
from mpc.smoothing.problem import SOLVERS, Problem, Roughness


def random_problem(rng, smooth, horizon=4, n_actions=2, n_readings=2, goal_size=2):
    n_unknowns = horizon * n_actions
    actions, executed = rng.uniform(-1, 1, (horizon, n_actions)), rng.uniform(-1, 1, (2, n_actions))
    matrix, gradient, _ = Roughness(0.5, 0.1, 0.02).quadratic(actions, executed)
    slopes = rng.normal(size=(n_readings, smooth.n_inputs, n_unknowns))
    slopes[:, -goal_size:] = 0.0
    trust = rng.uniform(0.05, 0.8)
    bounds = np.maximum(-1 - actions, -trust).ravel(), np.minimum(1 - actions, trust).ravel()
    return Problem(matrix, gradient, rng.normal(size=(n_readings, smooth.n_inputs)), slopes, np.full(n_readings, 0.1),
                   *bounds)  # fmt: skip


def test_both_solvers_find_scipys_optimum_within_bounds():
    smooth, rng = SmoothDistance(random_model(), "policy"), np.random.default_rng(0)
    solvers = [SOLVERS["qp"](smooth, 8, 2, 30), SOLVERS["ipopt"](smooth, 8, 2, 50)]
    for _ in range(20):
        problem = random_problem(rng, smooth)
        best = minimize(
            lambda du, p: p.value(smooth, du[None])[0], np.zeros(8), (problem,), "L-BFGS-B",
            bounds=list(zip(problem.lower, problem.upper, strict=True)), options={"ftol": 1e-12, "maxiter": 500},
        )  # fmt: skip
        start = problem.value(smooth, np.zeros((1, 8)))[0]
        for solver in solvers:
            change = solver.solve(problem)
            assert (change >= problem.lower - 1e-9).all() and (change <= problem.upper + 1e-9).all()
            assert problem.value(smooth, change[None])[0] <= best.fun + 5e-3 * (start - best.fun) + 1e-5


def test_roughness_is_its_formula():
    rng = np.random.default_rng(0)
    roughness, actions = Roughness(0.7, 0.2, 0.1), rng.normal(size=(5, 2))
    for n_executed in (0, 1, 2):
        executed = rng.normal(size=(n_executed, 2))

        def value(du, executed=executed, actions=actions):
            u = actions + du
            joined = np.concatenate([executed[-1:], u])
            jerked = np.concatenate([executed[-2:], u])
            return (0.7 * np.square(np.diff(joined, axis=0)).sum() + 0.1 * np.square(u).sum()
                    + 0.2 * np.square(np.diff(jerked, 2, axis=0)).sum())  # fmt: skip

        matrix, gradient, start = roughness.quadratic(actions, executed)
        for change in rng.normal(size=(3, 5, 2)):
            flat = change.ravel()
            expected = start + gradient @ flat + 0.5 * flat @ matrix @ flat
            np.testing.assert_allclose(value(change), expected)
            np.testing.assert_allclose(roughness((actions + change)[None], executed), [expected])


def test_low_pass_is_its_recursion():
    actions = np.array([[1.0], [0.0], [1.0]])
    found = LowPass(0.6)(np.zeros(1), {}, actions, np.array([[0.5]])).actions
    np.testing.assert_allclose(found[:, 0], [0.7, 0.42, 0.652])
    np.testing.assert_allclose(LowPass(0.6)(np.zeros(1), {}, actions, np.zeros((0, 1))).actions[0], 1.0)


def test_figures_of_smoothness():
    assert action_rate(np.array([[0.0, 0.0], [1.0, 2.0], [1.0, 2.0]])) == pytest.approx(2.5)
    times = 0.1 * np.arange(10)
    assert jerk(np.stack([2.0 * times**3, 0.0 * times], axis=1), 0.1) == pytest.approx(12.0)
