"""Search algorithms: exact properties, convergence on a quadratic, and no dependence on anything."""

import subprocess
import sys

import numpy as np
import pytest

from mpc.knots import interpolation_matrix, shift_matrix
from planners.mppi import MPPI, correlated_noise, softmin


def test_weights_sum_to_one_and_ignore_offset_and_scale():
    costs = np.array([3.0, 1.0, 7.0, 2.0])
    weights = softmin(costs, 0.3)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(softmin(costs + 100.0, 0.3), weights)
    np.testing.assert_allclose(softmin(costs * 40.0, 0.3), weights)
    assert weights.argmax() == 1


def test_cold_weights_pick_the_best_and_infinite_costs_get_none():
    np.testing.assert_allclose(softmin(np.array([3.0, 1.0, 7.0]), 1e-3), [0, 1, 0], atol=1e-12)
    weights = softmin(np.array([np.inf, 1.0, np.nan, 2.0]), 1.0)
    assert weights[0] == weights[2] == 0.0 and weights.sum() == pytest.approx(1.0)


def test_equal_costs_get_equal_weights():
    np.testing.assert_allclose(softmin(np.full(4, 2.0), 0.2), 0.25)
    np.testing.assert_allclose(softmin(np.array([2.0, np.inf]), 0.2), [1.0, 0.0])


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_no_finite_cost_keeps_the_plan(bad):
    planner = MPPI(3, 2, n_samples=8)
    planner.mean[:] = 0.3
    planner.update(planner.sample(np.random.default_rng(0)), np.full(8, bad))
    np.testing.assert_array_equal(planner.mean, 0.3)


def test_a_diverged_sample_can_not_win():
    planner = MPPI(2, 1, n_samples=4, temperature=1e-3)
    knots = np.arange(8.0).reshape(4, 2, 1) / 10
    planner.update(knots, np.array([np.inf, 5.0, 1.0, np.inf]))
    np.testing.assert_allclose(planner.mean, knots[2])
    np.testing.assert_array_equal(planner.best, knots[2])


def test_converges_on_a_quadratic():
    rng = np.random.default_rng(0)
    optimum = np.array([[0.4, -0.7], [0.1, 0.9], [-0.5, 0.2]])
    planner = MPPI(3, 2, n_samples=256, noise_scale=0.3, noise_correlation=0.0, temperature=0.1)
    for _ in range(60):
        knots = planner.sample(rng)
        planner.update(knots, np.square(knots - optimum).sum((1, 2)))
    np.testing.assert_allclose(planner.mean, optimum, atol=0.08)
    np.testing.assert_allclose(planner.best, optimum, atol=0.08)


def test_samples_hold_the_mean_the_best_and_the_proposals():
    planner, rng = MPPI(3, 2, n_samples=6), np.random.default_rng(0)
    planner.mean[:], planner.best = 0.1, np.full((3, 2), -0.2)
    knots = planner.sample(rng, np.full((1, 3, 2), 0.5))
    for row, value in enumerate((0.1, -0.2, 0.5)):
        np.testing.assert_allclose(knots[row], value)
    assert knots.shape == (6, 3, 2) and np.abs(knots).max() <= 1.0


def test_same_seed_same_samples():
    first, second = (MPPI(4, 2).sample(np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_noise_has_the_stated_scale_and_correlation():
    noise = correlated_noise(np.random.default_rng(0), (40_000, 3, 1), 0.6)[..., 0]
    np.testing.assert_allclose(noise.std(0), 1.0, atol=0.02)
    assert np.corrcoef(noise[:, 0], noise[:, 1])[0, 1] == pytest.approx(0.6, abs=0.02)
    assert np.corrcoef(noise[:, 0], noise[:, 2])[0, 1] == pytest.approx(0.36, abs=0.02)


@pytest.mark.parametrize("kind", ["zero", "linear", "cubic"])
def test_knots_are_hit_exactly_and_constants_are_kept(kind):
    matrix = interpolation_matrix(4, 10, kind)
    assert matrix.shape == (10, 4)
    np.testing.assert_allclose(matrix[[0, 3, 6, 9]], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(matrix.sum(1), 1.0)
    np.testing.assert_allclose(interpolation_matrix(10, 10, kind), np.eye(10), atol=1e-12)


@pytest.mark.parametrize("kind", ["zero", "linear", "cubic"])
def test_shift_of_one_knot_per_step_drops_the_first_and_repeats_the_last(kind):
    plan = np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(shift_matrix(4, 4, kind) @ plan, [2, 3, 4, 4], atol=1e-12)


def test_shifted_spline_is_the_same_curve_later():
    knots = np.array([0.0, 1.0, 2.0, 3.0])  # a straight line, held at its end
    matrix, shift = interpolation_matrix(4, 10, "linear"), shift_matrix(4, 10, "linear")
    np.testing.assert_allclose((matrix @ (shift @ knots))[:6], (matrix @ knots)[1:7], atol=1e-12)


def test_too_many_knots_are_refused():
    with pytest.raises(ValueError, match="n_knots is 9"):
        interpolation_matrix(9, 8, "linear")


def test_search_imports_nothing_but_numpy():
    code = (
        "import sys, planners.mppi; "
        "heavy = {'torch', 'mujoco', 'casadi', 'gymnasium', 'scipy'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
