"""What one refinement of each search does, in numbers worked out by hand; and the noise they share."""

import numpy as np
import pytest

from planners.cem import CEM, CEMConfig
from planners.icem import ICEM, ICEMConfig
from planners.mppi import MPPI, MPPIConfig, softmin
from planners.predictive_sampling import PredictiveSampling, PredictiveSamplingConfig
from planners.sampling import best_plans, coloured_noise, correlated_noise
from planners.smooth import Held, HeldConfig

SAMPLING = [MPPI, CEM, ICEM, PredictiveSampling]
ONE_LATER = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])  # K = H = 3
CONFIGS = {
    MPPI: MPPIConfig,
    CEM: CEMConfig,
    ICEM: ICEMConfig,
    PredictiveSampling: PredictiveSamplingConfig,
    Held: HeldConfig,
}


def search(kind, n_knots, n_controls, **settings):
    """The one place that knows how a search is built."""
    return kind(n_knots, n_controls, CONFIGS[kind](**settings))


def rng(seed=0):
    return np.random.default_rng(seed)


def plans(*values, shape=(1, 1)):
    """One plan per value, constant over knots and controls, ``(N, *shape)``."""
    return np.array(values, float)[:, None, None] * np.ones(shape)


# -- noise --


def test_correlated_noise_is_the_ar1_recursion_over_white_noise():
    white, noise = rng().standard_normal((5, 3, 2)), correlated_noise(rng(), (5, 3, 2), 0.6)
    np.testing.assert_array_equal(noise[:, 0], white[:, 0])
    np.testing.assert_allclose(noise[:, 1], 0.6 * white[:, 0] + 0.8 * white[:, 1])
    np.testing.assert_allclose(noise[:, 2], 0.36 * white[:, 0] + 0.48 * white[:, 1] + 0.8 * white[:, 2])
    np.testing.assert_array_equal(correlated_noise(rng(), (5, 3, 2), 0.0), white)


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.95])
def test_correlated_noise_has_unit_variance_and_its_correlation_falls_as_a_power(correlation):
    noise = correlated_noise(rng(1), (40_000, 4, 2), correlation).reshape(40_000, 8)
    lags = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    expected = np.kron(correlation**lags, np.eye(2))  # controls do not know of each other
    np.testing.assert_allclose(np.cov(noise.T, bias=True), expected, atol=0.03)
    np.testing.assert_allclose(noise.mean(0), 0.0, atol=0.03)


# Covariances at lags 0 .. K - 1, from powers 1 / f^beta with the mean at f = 1 / K. K = 4, beta = 2 has powers
# 16, 16, 4: one share of the mean, two of f = 1/4, which turns by a quarter per knot, and one of f = 1/2, which
# turns by half: (16, 32 cos 90, 4 cos 180) of 52.
SPECTRA = {
    (1, 2.0): [1.0],
    (2, 2.0): [1.0, 0.0],
    (3, 2.0): [1.0, 0.0, 0.0],
    (4, 2.0): [1.0, 12 / 52, -12 / 52, 12 / 52],
    (4, 0.0): [1.0, 0.0, 0.0, 0.0],
    (5, 0.0): [1.0, 0.0, 0.0, 0.0, 0.0],
    # Powers 25 (the mean), 25 and 25 / 4: (25, 50 cos 72, 12.5 cos 144) of 87.5.
    (5, 2.0): [1.0, 0.34672, -0.13243, -0.13243, 0.34672],
    # Power over frequency: 5 (the mean), 5 and 5 / 2: (5, 10 cos 72, 5 cos 144) of 20.
    (5, 1.0): [1.0, 0.20225, -0.07725, -0.07725, 0.20225],
}


@pytest.mark.parametrize(("n_knots", "exponent"), SPECTRA)
def test_coloured_noise_has_the_covariance_of_its_spectrum(n_knots, exponent):
    noise = coloured_noise(rng(2), (40_000, n_knots, 2), exponent)
    assert noise.shape == (40_000, n_knots, 2) and np.abs(noise.mean(0)).max() < 0.03
    lags = np.subtract.outer(np.arange(n_knots), np.arange(n_knots)) % n_knots
    expected = np.kron(np.array(SPECTRA[n_knots, exponent])[lags], np.eye(2))
    np.testing.assert_allclose(np.cov(noise.reshape(40_000, -1).T, bias=True), expected, atol=0.03)


def test_best_plans_are_in_order_and_the_first_of_equals_comes_first():
    np.testing.assert_array_equal(best_plans(np.array([2.0, 1.0, 2.0, 1.0, 0.5]), 4), [4, 1, 3, 0])
    many = np.r_[np.zeros(100), -1.0]
    np.testing.assert_array_equal(best_plans(many, 50), [100, *range(49)])
    np.testing.assert_array_equal(best_plans(np.array([-np.inf, 2.0, np.nan, 1.0]), 3), [3, 1])
    assert len(best_plans(np.array([np.nan, np.inf, -np.inf]), 2)) == 0


# -- drawing --


@pytest.mark.parametrize("kind", SAMPLING)
def test_samples_are_the_stated_noise_around_the_plan_cut_to_the_controls_bounds(kind):
    colour = {CEM: {}, ICEM: {"noise_exponent": 1.5}}.get(kind, {"noise_correlation": 0.5})
    knots = search(kind, 4, 2, samples=9, noise_scale=0.7, **colour).sample(rng(5))
    if kind is CEM:
        noise = rng(5).standard_normal((9, 4, 2))
    else:
        noise = (coloured_noise if kind is ICEM else correlated_noise)(rng(5), (9, 4, 2), *colour.values())
    kept = 0 if kind is ICEM else 1  # the plan itself; iCEM tries its mean last
    expected = 0.7 * noise
    expected[:kept] = 0.0
    np.testing.assert_array_equal(knots, np.clip(expected, -1.0, 1.0))
    assert (knots == 1.0).any() and (knots == -1.0).any(), "the case cuts at both ends"


@pytest.mark.parametrize("kind", SAMPLING)
def test_samples_are_centred_at_the_plan_with_the_noise_scale(kind):
    colour = {CEM: {}, ICEM: {"noise_exponent": 0.0}}.get(kind, {"noise_correlation": 0.5})
    planner = search(kind, 3, 2, samples=20_000, noise_scale=0.1, **colour)
    plan = np.array([[0.3, -0.2], [0.0, 0.4], [-0.5, 0.1]])
    planner.adopt(plan)
    knots = planner.sample(rng(3))
    np.testing.assert_allclose(knots.mean(0), plan, atol=0.003)
    np.testing.assert_allclose(knots.std(0), 0.1, atol=0.003)
    neighbours = np.corrcoef(knots[:, 0, 0], knots[:, 1, 0])[0, 1]
    assert neighbours == pytest.approx(0.5 if "noise_correlation" in colour else 0.0, abs=0.03)


def test_the_samples_that_are_not_noise_stand_in_their_places():
    proposals = plans(0.5, 0.6, shape=(3, 2))
    for kind in (CEM, PredictiveSampling, Held):
        planner = search(kind, 3, 2) if kind is Held else search(kind, 3, 2, samples=6)
        planner.adopt(np.full((3, 2), 0.1))
        knots = planner.sample(rng(), proposals)
        np.testing.assert_array_equal(knots[:3], plans(0.1, 0.5, 0.6, shape=(3, 2)))
        assert len(knots) == (3 if kind is Held else 6) and (kind is Held or len(np.unique(knots[3:])) > 4)
        np.testing.assert_array_equal(planner.plan, 0.1)
    planner = search(MPPI, 3, 2, samples=6)
    np.testing.assert_array_equal(planner.sample(rng(), proposals)[:3], plans(0.0, 0.5, 0.6, shape=(3, 2)))
    planner.mean, planner.best = np.full((3, 2), 0.1), np.full((3, 2), 0.2)
    knots = planner.sample(rng(), proposals)
    np.testing.assert_array_equal(knots[:4], plans(0.1, 0.2, 0.5, 0.6, shape=(3, 2)))
    assert len(np.unique(knots[4:])) > 4
    np.testing.assert_array_equal(proposals, plans(0.5, 0.6, shape=(3, 2)))


@pytest.mark.parametrize("kind", SAMPLING)
def test_no_more_plans_are_tried_than_were_asked_for(kind):
    planner = search(kind, 2, 1, samples=2, **({"elites": 1} if kind in (CEM, ICEM) else {}))
    assert len(planner.sample(rng(), plans(0.1, 0.2, 0.3, shape=(2, 1)))) == 2


@pytest.mark.parametrize("kind", [*SAMPLING, Held])
def test_proposals_beyond_the_bounds_are_cut(kind):
    knots = search(kind, 2, 1).sample(rng(), plans(1.5, -3.0, shape=(2, 1)))
    assert knots.max() == 1.0 and knots.min() == -1.0


def test_the_held_plan_adds_no_noise_and_from_zero_takes_no_proposals():
    held = search(Held, 2, 1, start="zero")
    np.testing.assert_array_equal(held.sample(rng(), plans(0.5, shape=(2, 1))), plans(0.0, shape=(2, 1)))
    for start in ("policy", "zero"):
        np.testing.assert_array_equal(search(Held, 2, 1, start=start).sample(rng()), plans(0.0, shape=(2, 1)))
    held = search(Held, 2, 1)  # from the policy unless told otherwise
    tried = held.sample(rng(), plans(0.5, shape=(2, 1)))
    held.update(tried, np.array([2.0, 1.0]))
    np.testing.assert_array_equal(held.plan, 0.5)
    held.update(tried, np.array([1.0, 1.0]))  # no cheaper plan: the plan itself, which comes first
    np.testing.assert_array_equal(held.plan, 0.0)
    held.update(plans(0.1, 0.2, 0.3, shape=(2, 1)), np.array([3.0, 1.0, 2.0]))
    np.testing.assert_array_equal(held.plan, 0.2)
    held.shift(np.array([[0.0, 2.0], [1.0, 1.0]]))
    np.testing.assert_array_equal(held.plan, 0.4)
    assert held.effective_samples == 1.0
    held.reset()
    np.testing.assert_array_equal(held.plan, np.zeros((2, 1)))
    assert held.effective_samples == 1.0


# -- MPPI --


def test_weights_are_exponential_in_costs_over_temperature_times_their_spread():
    weights = softmin(np.array([1.0, 3.0, 1.0, 3.0, np.inf, np.nan]), 0.5)  # the finite costs deviate by 1
    np.testing.assert_allclose(weights, np.array([1, np.exp(-4), 1, np.exp(-4), 0, 0]) / (2 + 2 * np.exp(-4)))
    weights = softmin(np.array([0.0, 4.0]), 2.0)  # a deviation of 2
    np.testing.assert_allclose(weights, np.array([1, np.exp(-1)]) / (1 + np.exp(-1)))


def test_costs_equal_but_for_rounding_count_the_same_and_small_spreads_do_not_vanish():
    np.testing.assert_array_equal(softmin(np.array([0.3, 0.1 + 0.2, 0.3, np.inf]), 0.2), [1 / 3, 1 / 3, 1 / 3, 0])
    np.testing.assert_allclose(softmin(np.array([1.0, 3.0]) * 1e-9, 0.5), softmin(np.array([1.0, 3.0]), 0.5))
    np.testing.assert_array_equal(softmin(np.array([1.5, 1.0, 1.0]), 1e-13), [0.0, 0.5, 0.5])


def test_mppi_moves_to_the_weighted_mean_and_counts_the_samples_that_matter():
    planner = search(MPPI, 1, 1, samples=4, temperature=0.5)
    assert planner.effective_samples == 4.0
    knots, low = plans(0.8, -0.4, 0.2, 0.6), np.exp(-4)
    planner.update(knots, np.array([3.0, 1.0, 1.0, 3.0]))
    total = 2 + 2 * low
    assert planner.plan[0, 0] == pytest.approx((-0.4 + 0.2 + low * (0.8 + 0.6)) / total)
    assert planner.effective_samples == pytest.approx(total**2 / (2 + 2 * low**2))
    np.testing.assert_array_equal(planner.best, [[-0.4]])  # the first of the cheapest
    planner.update(plans(np.nan, 0.1), np.array([np.nan, 5.0]))  # the old mean has no weight, the best is this round's
    assert planner.plan == planner.best == 0.1 and planner.effective_samples == 1.0
    knots = plans(0.3, 0.9)
    planner.update(knots, np.array([2.0, 2.0]))
    assert planner.plan[0, 0] == pytest.approx(0.6) and planner.effective_samples == 2.0
    knots[:] = 7.0
    assert planner.best == 0.3, "kept, whatever becomes of the samples"


def test_mppi_without_a_finite_cost_stays_as_it_was():
    planner = search(MPPI, 1, 1, samples=2)
    planner.update(plans(0.1, 0.9), np.array([1.0, 2.0]))
    before = planner.plan.copy(), planner.best.copy(), planner.effective_samples
    planner.update(plans(-1.0, -1.0), np.array([np.inf, np.nan]))
    assert (planner.plan, planner.best, planner.effective_samples) == before


def test_mppi_shifts_its_mean_and_its_best_and_forgets_both():
    planner = search(MPPI, 3, 1, samples=4)
    planner.shift(ONE_LATER)
    np.testing.assert_array_equal(planner.plan, 0.0)
    assert planner.best is None
    planner.mean, planner.best = np.array([[0.1], [0.2], [0.3]]), np.array([[0.4], [0.5], [0.6]])
    planner.shift(ONE_LATER)
    np.testing.assert_array_equal(planner.plan[:, 0], [0.2, 0.3, 0.3])
    np.testing.assert_array_equal(planner.sample(rng())[:2, :, 0], [[0.2, 0.3, 0.3], [0.5, 0.6, 0.6]])
    planner.effective_samples = 1.5
    planner.reset()
    np.testing.assert_array_equal(planner.plan, np.zeros((3, 1)))
    assert planner.best is None and planner.effective_samples == 4.0


# -- CEM --


def test_cem_fits_mean_and_deviation_to_its_elites_with_momentum():
    planner = search(CEM, 1, 1, samples=5, elites=2, noise_scale=0.8, min_noise_scale=0.05, momentum=0.25)
    assert planner.effective_samples == 2.0
    planner.adopt(np.array([[0.4]]))
    planner.update(plans(0.9, 0.1, -0.7, 0.3, 0.5), np.array([5.0, 1.0, 4.0, 2.0, 3.0]))
    assert planner.plan[0, 0] == pytest.approx(0.25 * 0.4 + 0.75 * 0.2)  # elites 0.1 and 0.3
    assert planner.deviation[0, 0] == pytest.approx(0.25 * 0.8 + 0.75 * 0.1)
    mean, deviation = planner.plan[0, 0], planner.deviation[0, 0]
    planner.update(plans(0.9, 0.1, -0.7), np.array([np.inf, 1.0, np.nan]))
    assert planner.effective_samples == 1.0
    assert planner.plan[0, 0] == pytest.approx(0.25 * mean + 0.75 * 0.1)
    assert planner.deviation[0, 0] == pytest.approx(0.25 * deviation)
    before = planner.plan.copy(), planner.deviation.copy(), 1.0
    planner.update(plans(0.9, 0.1), np.array([np.inf, np.nan]))
    assert (planner.plan, planner.deviation, planner.effective_samples) == before


def test_cem_draws_with_the_deviation_it_fitted_which_never_falls_below_its_floor():
    planner = search(CEM, 2, 1, samples=5, elites=2, noise_scale=0.8, min_noise_scale=0.1, momentum=0.5)
    knots = np.array([[[0.0], [0.0]], [[0.0], [0.8]]])
    for deviations in ([0.4, 0.6], [0.2, 0.5], [0.1, 0.45], [0.1, 0.425]):
        planner.update(knots, np.array([1.0, 2.0]))
        np.testing.assert_allclose(planner.deviation[:, 0], deviations)
    drawn = planner.sample(rng(4))
    expected = planner.plan + np.array([[0.1], [0.425]]) * rng(4).standard_normal((5, 2, 1))
    np.testing.assert_allclose(drawn[1:], np.clip(expected[1:], -1, 1))
    np.testing.assert_array_equal(drawn[0], planner.plan)


def test_cem_shifts_its_mean_and_searches_wide_again():
    planner = search(CEM, 3, 1, samples=5, elites=2, noise_scale=0.8)
    planner.update(np.array([[[0.1], [0.2], [0.3]]]), np.array([1.0]))
    mean = planner.plan[:, 0].copy()
    np.testing.assert_allclose(mean / mean[0], [1, 2, 3])
    assert planner.deviation.max() < 0.1
    planner.adopt(planner.plan / mean[0] / 10)
    assert planner.deviation.max() < 0.1, "an adopted plan is known as well as the one it replaces"
    planner.shift(ONE_LATER)
    np.testing.assert_allclose(planner.plan[:, 0], [0.2, 0.3, 0.3])
    np.testing.assert_array_equal(planner.deviation, np.full((3, 1), 0.8))
    planner.deviation, planner.effective_samples = planner.deviation / 2, 1.0
    planner.reset()
    np.testing.assert_array_equal(planner.plan, np.zeros((3, 1)))
    np.testing.assert_array_equal(planner.deviation, np.full((3, 1), 0.8))
    assert planner.effective_samples == 2.0


# -- iCEM --


def test_icem_fits_mean_and_deviation_to_its_elites_with_momentum():
    planner = search(ICEM, 1, 1, samples=6, elites=2, noise_scale=0.8, momentum=0.25)
    assert planner.effective_samples == 2.0
    planner.adopt(np.array([[0.4]]))
    planner.update(plans(0.9, 0.1, -0.7, 0.3, 0.5), np.array([5.0, 1.0, 4.0, 2.0, 3.0]))
    assert planner.mean[0, 0] == pytest.approx(0.25 * 0.4 + 0.75 * 0.2)  # elites 0.1 and 0.3
    assert planner.deviation[0, 0] == pytest.approx(0.25 * 0.8 + 0.75 * 0.1)
    assert planner.plan == 0.1, "the best plan is executed, not the mean"
    mean, deviation = planner.mean[0, 0], planner.deviation[0, 0]
    planner.update(plans(0.9, 0.2, -0.7), np.array([np.inf, 1.5, np.nan]))
    assert planner.mean[0, 0] == pytest.approx(0.25 * mean + 0.75 * 0.2)
    assert planner.deviation[0, 0] == pytest.approx(0.25 * deviation)
    assert planner.effective_samples == 1.0 and planner.plan == 0.1
    before = planner.mean.copy(), planner.deviation.copy()
    planner.update(plans(0.9, 0.2), np.array([np.inf, np.nan]))
    assert (planner.mean, planner.deviation) == before and planner.effective_samples == 1.0
    planner.update(plans(-0.6, 0.2), np.array([1.0, 2.0]))
    assert planner.plan == 0.1, "as good as the best is no reason to change"
    planner.update(plans(-0.6, 0.2), np.array([0.9, 2.0]))
    assert planner.plan == -0.6


def test_icem_tries_fewer_plans_in_every_refinement_but_never_less_than_two_per_elite():
    def sizes(**settings):
        planner = search(ICEM, 2, 1, **settings)
        found = []
        for n in range(1, 6):
            found.append(len(planner.sample(rng())))
            planner.update(np.zeros((n, 2, 1)), np.full(n, np.nan))  # a round without a cost is a round
        return found

    assert sizes(samples=40, elites=3, decay=2.0) == [40, 20, 10, 6, 6]
    assert sizes(samples=10, elites=2, decay=1.5) == [10, 6, 4, 4, 4]
    assert sizes(samples=5, elites=4, decay=1.5) == [5, 5, 5, 5, 5]
    planner = search(ICEM, 2, 1, samples=40, elites=3, decay=2.0)
    for again in (lambda: planner.shift(np.eye(2)), planner.reset):
        planner.update(plans(0.0, shape=(2, 1)), np.zeros(1))
        assert len(planner.sample(rng())) == 20
        again()
        assert len(planner.sample(rng())) == 40


def test_icem_tries_its_special_plans_in_their_refinements():
    planner = search(ICEM, 2, 1, samples=9, elites=4, refinements=3, kept=0.3)
    proposals = plans(0.5, 0.6, shape=(2, 1))
    elites = plans(0.01, 0.02, 0.03, 0.04, shape=(2, 1))
    costs = np.arange(4.0)

    def special(knots):
        return [float(one[0, 0]) for one in knots if one[0, 0] == one[1, 0]]

    assert special(planner.sample(rng(), proposals)) == [0.5, 0.6]  # no elites yet
    planner.update(elites, costs)
    assert special(planner.sample(rng(), proposals)) == [0.01, 0.02]  # 30 % of four, rounded up
    planner.update(elites, costs)
    planner.mean = np.full((2, 1), 0.7)
    assert special(planner.sample(rng(), proposals)) == [0.01, 0.02, 0.7]  # the mean, in the last
    planner.update(elites, costs)
    planner.shift(np.eye(2))
    assert special(planner.sample(rng(), proposals)) == [0.01, 0.02, 0.5, 0.6]
    assert special(search(ICEM, 2, 1, refinements=1).sample(rng(), proposals)) == [0.5, 0.6, 0.0]


def test_icem_shifts_mean_elites_and_best_searches_wide_again_and_trusts_no_old_cost():
    planner = search(ICEM, 3, 1, samples=8, elites=2, noise_scale=0.5, kept=1.0)
    knots = np.array([[[0.1], [0.2], [0.3]], [[0.4], [0.5], [0.6]], [[0.7], [0.8], [0.9]]])
    planner.update(knots, np.array([1.0, 2.0, 3.0]))
    mean = planner.mean[:, 0].copy()
    assert (np.diff(mean) > 0).all() and planner.deviation.max() < 0.5
    planner.shift(ONE_LATER)
    np.testing.assert_array_equal(planner.plan[:, 0], [0.2, 0.3, 0.3])
    np.testing.assert_allclose(planner.mean[:, 0], mean[[1, 2, 2]])
    np.testing.assert_array_equal(planner.sample(rng())[:2, :, 0], [[0.2, 0.3, 0.3], [0.5, 0.6, 0.6]])
    np.testing.assert_array_equal(planner.deviation, np.full((3, 1), 0.5))
    planner.update(plans(0.25, shape=(3, 1)), np.array([9.0]))
    np.testing.assert_array_equal(planner.plan, 0.25)


def test_icem_goes_on_from_an_adopted_plan_with_its_other_elites():
    planner = search(ICEM, 1, 1, samples=8, elites=3, kept=1.0)
    planner.update(plans(0.1, 0.2, 0.3, 0.4), np.arange(4.0))
    deviation = planner.deviation.copy()
    planner.adopt(np.array([[0.9]]))
    assert planner.plan == planner.mean == 0.9 and planner.deviation == deviation
    knots = planner.sample(rng())
    np.testing.assert_array_equal(knots[:3], plans(0.9, 0.1, 0.2))
    assert (knots[3:] != 0.3).all(), "three elites as before"


def test_icem_forgets_everything():
    planner = search(ICEM, 1, 1, samples=8, elites=2, kept=1.0, noise_scale=0.5)
    planner.update(plans(0.1, 0.2), np.array([np.nan, -5.0]))
    planner.reset()
    assert planner.plan == planner.mean == 0.0 and planner.deviation == 0.5 and planner.effective_samples == 2.0
    np.testing.assert_array_equal(
        planner.sample(rng()), search(ICEM, 1, 1, samples=8, elites=2, noise_scale=0.5).sample(rng())
    )
    planner.update(plans(0.3), np.array([7.0]))
    assert planner.plan == 0.3, "no cost of the last episode is remembered"


# -- predictive sampling --


def test_predictive_sampling_takes_the_cheapest_plan_shifts_it_and_forgets_it():
    planner = search(PredictiveSampling, 3, 1, samples=4)
    assert planner.effective_samples == 1.0
    knots = np.array([[[0.7], [0.8], [0.9]], [[0.1], [0.2], [0.3]], [[0.4], [0.5], [0.6]]])
    planner.update(knots, np.array([np.nan, 1.0, 1.0]))
    np.testing.assert_array_equal(planner.plan[:, 0], [0.1, 0.2, 0.3])  # the first of the cheapest
    planner.update(knots, np.array([np.nan, 9.0, 8.0]))  # this round's, though it costs more: costs of rounds differ
    np.testing.assert_array_equal(planner.plan[:, 0], [0.4, 0.5, 0.6])
    planner.update(knots, np.full(3, np.inf))
    planner.shift(ONE_LATER)
    np.testing.assert_array_equal(planner.plan[:, 0], [0.5, 0.6, 0.6])
    np.testing.assert_array_equal(planner.sample(rng())[0, :, 0], [0.5, 0.6, 0.6])
    planner.reset()
    np.testing.assert_array_equal(planner.plan, np.zeros((3, 1)))
    assert planner.effective_samples == 1.0


# -- all --


@pytest.mark.parametrize("kind", [*SAMPLING, Held])
def test_a_search_can_be_had_without_settings(kind):
    usual, same = (one.sample(rng(), plans(0.5, shape=(3, 2))) for one in (kind(3, 2), search(kind, 3, 2)))
    np.testing.assert_array_equal(usual, same)


@pytest.mark.parametrize("kind", [*SAMPLING, Held])
def test_effective_samples_are_a_plain_number(kind):
    planner = search(kind, 1, 1)
    assert type(planner.effective_samples) is float
    planner.update(plans(0.1, 0.2), np.array([1.0, 2.0]))
    assert type(planner.effective_samples) is float


@pytest.mark.parametrize("kind", SAMPLING)
def test_a_plan_that_is_shifted_stays_found_while_the_task_moves_on(kind):
    """The best plan is a stretch of random numbers, seen one step later every time, out of reach of the noise."""
    track = rng(100).uniform(-0.8, 0.8, 40)
    white = {ICEM: {"elites": 8, "noise_exponent": 0.0}, CEM: {"elites": 8}}.get(kind, {"noise_correlation": 0.0})
    errors = {}
    shifted = np.eye(6, k=1)
    shifted[-1, -1] = 1.0
    for shift in (shifted, np.eye(6)):
        planner, generator = search(kind, 6, 1, samples=64, noise_scale=0.1, refinements=4, **white), rng()
        errors[shift is shifted] = []
        for step in range(30):
            if step:
                planner.shift(shift)
            for _ in range(4):
                knots = planner.sample(generator)
                planner.update(knots, np.square(knots[:, :, 0] - track[step : step + 6]).sum(1))
            errors[shift is shifted].append(abs(planner.plan[0, 0] - track[step]))
    assert np.mean(errors[True][10:]) < 0.08 < np.mean(errors[False][10:])
