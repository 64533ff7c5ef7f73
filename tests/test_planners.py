"""Search algorithms: exact properties, convergence on a quadratic, and no dependence on anything."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.interpolate import interp1d
from searches import SAMPLING as ALL
from searches import search as make

from mpc.knots import interpolation_matrix, shift_matrix
from planners.cem import CEM
from planners.icem import ICEM
from planners.mppi import MPPI, softmin
from planners.predictive_sampling import PredictiveSampling
from planners.sampling import best_plans, coloured_noise, correlated_noise
from planners.smooth import Held


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
@pytest.mark.parametrize("kind", ALL)
def test_no_finite_cost_keeps_the_plan(kind, bad):
    planner, rng = make(kind, 3, 2, samples=8), np.random.default_rng(0)
    planner.update(planner.sample(rng), np.arange(8.0))
    plan = planner.plan.copy()
    planner.shift(np.eye(3))
    knots = planner.sample(rng)
    planner.update(knots, np.full(len(knots), bad))
    np.testing.assert_array_equal(planner.plan, plan)


@pytest.mark.parametrize("kind", ALL)
def test_infinite_and_nan_costs_never_reach_the_plan(kind):
    planner = make(kind, 2, 1, samples=8, **({"elites": 3} if kind in (CEM, ICEM) else {}))
    knots = planner.sample(np.random.default_rng(1))
    costs = np.full(len(knots), np.inf)
    knots[[0, 2, 4, 6]], costs[[0, 2, 4, 6]] = 0.25, 1.0
    knots[1], costs[1] = -1.0, np.nan
    knots[3] = np.nan  # its simulation diverged
    planner.update(knots, costs)
    weight = 1.0 - planner.config.momentum if kind is CEM else 1.0
    np.testing.assert_allclose(planner.plan, 0.25 * weight)


def test_a_diverged_sample_can_not_win():
    planner = make(MPPI, 2, 1, samples=4, temperature=1e-3)
    knots = np.arange(8.0).reshape(4, 2, 1) / 10
    planner.update(knots, np.array([np.inf, 5.0, 1.0, np.inf]))
    np.testing.assert_allclose(planner.mean, knots[2])
    np.testing.assert_array_equal(planner.best, knots[2])


@pytest.mark.parametrize(
    "planner",
    [
        make(MPPI, 3, 2, samples=256, noise_scale=0.3, noise_correlation=0.0, temperature=0.1),
        make(CEM, 3, 2, samples=128, elites=12),
        make(ICEM, 3, 2, samples=128, elites=12, noise_exponent=0.0),
        make(PredictiveSampling, 3, 2, samples=256, noise_scale=0.2, noise_correlation=0.0),
    ],
    ids=lambda planner: type(planner).__name__,
)
def test_converges_on_a_quadratic(planner):
    rng = np.random.default_rng(0)
    optimum = np.array([[0.4, -0.7], [0.1, 0.9], [-0.5, 0.2]])
    for _ in range(60):
        knots = planner.sample(rng)
        planner.update(knots, np.square(knots - optimum).sum((1, 2)))
    np.testing.assert_allclose(planner.plan, optimum, atol=0.08)


def test_samples_hold_the_mean_the_best_and_the_proposals():
    planner, rng = make(MPPI, 3, 2, samples=6), np.random.default_rng(0)
    planner.mean[:], planner.best = 0.1, np.full((3, 2), -0.2)
    knots = planner.sample(rng, np.full((1, 3, 2), 0.5))
    for row, value in enumerate((0.1, -0.2, 0.5)):
        np.testing.assert_allclose(knots[row], value)
    assert knots.shape == (6, 3, 2) and np.abs(knots).max() <= 1.0


@pytest.mark.parametrize("kind", ALL)
def test_proposals_are_tried_and_controls_stay_in_bounds(kind):
    knots = make(kind, 3, 2, samples=8).sample(np.random.default_rng(0), np.full((1, 3, 2), 0.5))
    assert (knots == 0.5).all((1, 2)).sum() == 1
    assert knots.shape[1:] == (3, 2) and np.abs(knots).max() <= 1.0


@pytest.mark.parametrize("kind", ALL)
def test_same_seed_same_plans(kind):
    plans = []
    for _ in range(2):
        planner, rng = make(kind, 4, 2, samples=12), np.random.default_rng(3)
        for _ in range(4):
            knots = planner.sample(rng)
            planner.update(knots, np.abs(knots - 0.3).sum((1, 2)))
            planner.shift(shift_matrix(4, 4, "linear"))
        plans.append(planner.plan)
    np.testing.assert_array_equal(*plans)


@pytest.mark.parametrize("kind", ALL)
def test_reset_forgets_the_episode(kind):
    used, fresh = make(kind, 4, 2, samples=12), make(kind, 4, 2, samples=12)
    for _ in range(3):
        knots = used.sample(np.random.default_rng(0))
        used.update(knots, knots.sum((1, 2)))
        used.shift(np.eye(4))
    used.reset()
    first, second = (planner.sample(np.random.default_rng(1)) for planner in (used, fresh))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("kind", [*ALL, Held])
def test_an_adopted_plan_is_the_next_to_be_tried(kind):
    planner, rng = Held(3, 2) if kind is Held else make(kind, 3, 2, samples=12), np.random.default_rng(0)
    knots = planner.sample(rng)
    planner.update(knots, np.arange(float(len(knots))))
    found = np.full((3, 2), 0.25)
    planner.adopt(found)
    np.testing.assert_array_equal(planner.plan, found)
    planner.shift(np.eye(3))
    tried = planner.sample(rng)
    assert any(np.array_equal(one, found) for one in tried)
    for name in ("mean", "best"):  # what the next samples are drawn around
        if hasattr(planner, name):
            np.testing.assert_array_equal(getattr(planner, name), found)
    planner.update(tried, np.arange(float(len(tried))))
    np.testing.assert_array_equal(found, 0.25)  # nobody writes into it


def test_adopting_a_plan_leaves_icem_its_other_elites():
    planner = make(ICEM, 2, 1, samples=20, elites=4)
    knots = planner.sample(np.random.default_rng(0))
    planner.update(knots, np.arange(20.0))
    planner.adopt(np.zeros((2, 1)))
    np.testing.assert_array_equal(planner._elites, [np.zeros((2, 1)), *knots[:3]])


def test_icem_keeps_and_shifts_elites_shrinks_and_tries_its_mean_last():
    planner, rng = make(ICEM, 2, 1, samples=40, elites=10, kept=0.3, decay=1.25), np.random.default_rng(0)
    sizes = []
    for _ in range(3):
        knots = planner.sample(rng)
        sizes.append(len(knots))
        if len(sizes) > 1:  # three of ten elites, best first
            np.testing.assert_array_equal(knots[:3], planner._elites[:3])
        if len(sizes) == 3:
            np.testing.assert_array_equal(knots[3], planner.mean)
        planner.update(knots, knots.sum((1, 2)))
    assert sizes == [40, 32, 25]
    best, elites = planner.plan, planner._elites
    np.testing.assert_array_equal(best, elites[0])
    planner.shift(shift_matrix(2, 2, "linear"))
    np.testing.assert_array_equal(planner.sample(rng)[0], elites[0][[1, 1]])


def test_best_plans_skip_what_is_not_finite():
    costs = np.array([3.0, np.nan, 1.0, np.inf, 2.0])
    np.testing.assert_array_equal(best_plans(costs, 2), [2, 4])
    np.testing.assert_array_equal(best_plans(costs, 5), [2, 4, 0])


@pytest.mark.parametrize("n_knots", [2, 7, 30])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_coloured_noise_has_unit_variance_and_falling_power(n_knots, exponent):
    noise = coloured_noise(np.random.default_rng(0), (20_000, n_knots, 1), exponent)[..., 0]
    np.testing.assert_allclose(noise.std(0), 1.0, atol=0.03)
    power = np.square(np.abs(np.fft.rfft(noise))).mean(0)
    if n_knots == 30:  # power at frequencies 2 / K and 8 / K
        assert power[2] / power[8] == pytest.approx(4.0**exponent, rel=0.1)


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


@pytest.mark.parametrize(("kind", "theirs"), [("zero", "previous"), ("linear", "linear")])
def test_between_knots_plans_are_read_as_scipy_reads_them(kind, theirs):
    read = interp1d(np.linspace(0.0, 9.0, 4), np.eye(4), kind=theirs, axis=0)
    np.testing.assert_allclose(interpolation_matrix(4, 10, kind), read(np.arange(10)), atol=1e-15)


@pytest.mark.parametrize("kind", ["zero", "linear", "cubic"])
def test_shift_of_one_knot_per_step_drops_the_first_and_repeats_the_last(kind):
    plan = np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(shift_matrix(4, 4, kind) @ plan, [2, 3, 4, 4], atol=1e-12)


@pytest.mark.parametrize("kind", ["zero", "linear", "cubic"])
def test_repeated_shifts_bring_every_knot_of_a_sparse_plan_to_the_front(kind):
    knots, matrix, shift = np.arange(4.0), interpolation_matrix(4, 10, kind), shift_matrix(4, 10, kind)
    first = [knots[0]]
    for _ in range(40):
        knots = shift @ knots
        first.append((matrix @ knots)[0])
    assert first[1] > 0.1 and first[-1] == pytest.approx(3.0, abs=0.05)
    assert kind == "cubic" or (np.diff(first) > -1e-9).all()  # splines swing around the end


def test_shifted_spline_is_the_same_curve_later():
    knots = np.array([0.0, 1.0, 2.0, 3.0])  # a straight line, held at its end
    matrix, shift = interpolation_matrix(4, 10, "linear"), shift_matrix(4, 10, "linear")
    np.testing.assert_allclose((matrix @ (shift @ knots))[:6], (matrix @ knots)[1:7], atol=1e-12)


def test_too_many_knots_are_refused():
    with pytest.raises(ValueError, match="n_knots is 9"):
        interpolation_matrix(9, 8, "linear")


def test_search_imports_nothing_but_numpy():
    code = (
        "import sys, planners.mppi, planners.cem, planners.icem, planners.predictive_sampling, planners.smooth; "
        "heavy = {'torch', 'mujoco', 'casadi', 'gymnasium', 'scipy'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
