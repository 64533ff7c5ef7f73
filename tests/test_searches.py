"""What one refinement of each search makes of costs, in numbers worked out by hand."""

import numpy as np
import pytest
from searches import ONE_LATER, SAMPLING, plans, rng, search

from planners.cem import CEM
from planners.icem import ICEM
from planners.mppi import MPPI, softmin
from planners.predictive_sampling import PredictiveSampling
from planners.smooth import Held

# -- a held plan --


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
