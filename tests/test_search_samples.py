"""What searches try: the noise they share and the plans that are not noise."""

import numpy as np
import pytest
from searches import SAMPLING, plans, rng, search

from planners.cem import CEM
from planners.icem import ICEM
from planners.mppi import MPPI
from planners.predictive_sampling import PredictiveSampling
from planners.sampling import best_plans, coloured_noise, correlated_noise
from planners.smooth import Held

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


@pytest.mark.parametrize("kind", [MPPI, PredictiveSampling])
def test_noise_shrinks_evenly_in_ratio_to_its_finest(kind):
    sizes = {"samples": 5, "noise_scale": 0.2, "noise_correlation": 0.0}
    spread = search(kind, 1, 20_000, **sizes, finest=0.0001).sample(rng())[1:, 0].std(1)
    np.testing.assert_allclose(spread, 0.2 * 10.0 ** -np.arange(1, 5), rtol=0.02)
    same = search(kind, 1, 4, **sizes, finest=1.0).sample(rng())
    np.testing.assert_array_equal(search(kind, 1, 4, **sizes).sample(rng()), same)


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


@pytest.mark.parametrize("kind", [*SAMPLING, Held])
def test_a_search_can_be_had_without_settings(kind):
    usual, same = (one.sample(rng(), plans(0.5, shape=(3, 2))) for one in (kind(3, 2), search(kind, 3, 2)))
    np.testing.assert_array_equal(usual, same)
