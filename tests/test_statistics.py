"""Medians, shares and paired differences, and what their intervals promise."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from octarm.reports.statistics import (
    FEWEST,
    adjusted,
    binomial,
    medians,
    paired,
    seeds_with_values,
    share,
)

values = st.lists(st.floats(-1e6, 1e6) | st.just(np.inf) | st.just(np.nan), min_size=1, max_size=60)


@given(values)
def test_medians_are_those_of_the_values_there_are(column):
    known = np.array(column)[~np.isnan(column)]
    found = medians(np.array(column)[:, None], np.arange(len(column))).value[0]
    assert found == np.median(known) if known.size else np.isnan(found)


@pytest.mark.parametrize("n", [6, 7, 8, 9, 11, 16, 25, 41, 64, 150])
def test_intervals_of_one_value_a_seed_are_those_of_order_statistics(n):
    """Hence they hold the median of any distribution as often as they say."""
    sample = np.random.default_rng(n).lognormal(size=n)
    found, order = medians(sample[:, None], np.arange(n)), np.sort(sample)
    (low,), (high,) = (np.flatnonzero(order == end) for end in (found.low, found.high))
    tail = scipy.stats.binom(n, 0.5).cdf
    assert 0.93 <= tail(high) - tail(low) <= (1.0 if n < 25 else 0.98)
    if n <= 64:  # of more, some are added up
        assert high == n - 1 - low
        sure = 0.0 if n <= 12 else 0.004  # of the share of signs that are drawn
        assert tail(low) <= 0.025 + sure and tail(low + 1) > 0.025 - sure


DRAWS = 2000


def coverage(draw, truth: float) -> float:
    """The share of samples whose interval holds the truth."""
    generator = np.random.default_rng(0)
    held = 0
    for _ in range(DRAWS):
        column, seeds = draw(generator)
        found = medians(column[:, None], seeds)
        held += found.low[0] <= truth <= found.high[0]
    return held / DRAWS


@pytest.mark.slow
@pytest.mark.parametrize("n", [6, 11, 25, 150])
@pytest.mark.parametrize(
    ("distribution", "truth"),
    [("exponential", np.log(2.0)), ("standard_cauchy", 0.0)],
)
def test_intervals_hold_the_true_median_as_often_as_they_say(distribution, truth, n):
    """They are exact: conservative where few seeds leave few places for an end."""

    def draw(generator):
        return getattr(generator, distribution)(size=n), np.arange(n)

    assert 0.93 <= coverage(draw, truth) <= (1.0 if n < 25 else 0.98)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "cells"), [(6, 24), (16, 4), (64, 6)])
@pytest.mark.parametrize("common", [0.0, 0.5, 1.0])
def test_what_cells_share_by_their_seed_is_not_taken_for_new_evidence(n, cells, common):
    """Cells of different sizes, with a factor that the seed brings to all of them."""
    size, seeds = np.linspace(1.0, 3.0, cells), np.repeat(np.arange(n), cells)

    def draw(generator):
        of_seed = generator.exponential(size=(n, 1)) ** common
        return (size * of_seed * generator.exponential(size=(n, cells)) ** (1.0 - common)), seeds

    many = np.random.default_rng(1).exponential(size=(2, 200_000, 1))
    truth = float(np.median(size * many[0] ** common * many[1] ** (1.0 - common)))
    assert coverage(lambda g: (draw(g)[0].ravel(), seeds), truth) >= 0.93


def test_taken_for_independent_the_same_cells_would_be_overconfident():
    seeds = np.arange(16 * 8)

    def draw(generator):
        return np.repeat(generator.normal(size=16), 8), seeds

    assert coverage(draw, 0.0) < 0.7


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_few_seeds_have_a_range(count):
    generator = np.random.default_rng(count)
    cells = generator.normal(size=(count, 3))
    found = medians(cells.reshape(-1, 1), np.repeat(np.arange(count), 3))
    of_seeds = np.median(cells, axis=1)
    assert (found.low[0], found.high[0]) == (of_seeds.min(), of_seeds.max())
    assert found.low[0] <= found.value[0] <= found.high[0]
    assert count < FEWEST


def test_a_column_has_the_seeds_that_have_a_value_in_it():
    column = np.array([1.0, 2.0, np.nan, 4.0, np.nan, np.nan])
    seeds = [1, 1, 1, 2, 2, 3]
    np.testing.assert_array_equal(seeds_with_values(np.stack([column] * 2, 1), seeds), [2, 2])


def test_the_grid_is_not_resampled():
    cells = np.tile([0.0, 1.0, 100.0], 20)  # three cells without anything random
    found = medians(cells[:, None], np.repeat(np.arange(20), 3))
    assert (found.value, found.low, found.high) == (1.0, 1.0, 1.0)


def test_intervals_depend_on_the_sample_alone():
    generator = np.random.default_rng(5)
    sample, seeds = generator.normal(size=(90, 3)), np.repeat(np.arange(30), 3)
    before = medians(sample, seeds)
    shuffled = generator.permutation(90)
    after = medians(sample[shuffled], seeds[shuffled] * 7 + 2)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)
    assert not np.array_equal(before.low, before.high)


def test_infinite_values_count_as_larger_than_all_others():
    column = np.array([1.0, 2.0, 3.0, 4.0, np.inf, np.inf])
    found = medians(np.stack([column, -column], axis=1), np.arange(6))
    np.testing.assert_array_equal(found.value, [3.5, -3.5])
    assert found.high[0] == np.inf and found.low[0] < 3.5
    assert found.low[1] == -np.inf


def test_one_seed_has_no_interval_and_nothing_has_no_median():
    found = medians(np.array([[1.0, np.nan], [3.0, np.nan]]), [4, 4])
    np.testing.assert_array_equal(found.value, [2.0, np.nan])
    assert np.isnan([found.low, found.high]).all()
    nothing = medians(np.empty((0, 1)), [])
    assert np.isnan([nothing.value, nothing.low, nothing.high]).all()


@pytest.mark.parametrize(("count", "total"), [(0, 16), (3, 16), (16, 16), (500, 1000), (1, 1)])
def test_shares_of_independent_trials_have_the_exact_interval(count, total):
    exact = scipy.stats.binomtest(count, total).proportion_ci(method="exact")
    expected = [count / total, exact.low, exact.high]
    np.testing.assert_allclose(binomial(count, total), expected, atol=1e-12)
    single = share(np.arange(total) < count, np.arange(total))
    np.testing.assert_allclose(single, expected, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "cells"), [(16, 24), (64, 6), (16, 4), (6, 10), (40, 1)])
@pytest.mark.parametrize("alike", [0.0, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("true", [0.02, 0.1, 0.5])
def test_intervals_hold_the_true_share_however_alike_the_rows_of_a_seed_are(n, cells, alike, true):
    """The audit's grids; they may hold it more often than they say."""
    generator = np.random.default_rng(n)
    limit, seeds = scipy.stats.norm.ppf(true), np.repeat(np.arange(n), cells)
    held = 0
    for _ in range(DRAWS):
        luck = np.sqrt(alike) * generator.normal(size=(n, 1))
        rows = luck + np.sqrt(1.0 - alike) * generator.normal(size=(n, cells)) < limit
        found = share(rows.ravel(), seeds)
        held += found.low <= true <= found.high
    assert held / DRAWS >= 0.93


def test_rows_of_a_seed_count_for_more_the_less_they_are_alike():
    generator = np.random.default_rng(0)
    seeds = np.repeat(np.arange(64), 6)
    alike = share(np.repeat(np.arange(64) < 16, 6), seeds)
    apart = share(generator.permutation(384) < 96, seeds)
    assert alike.value == apart.value == 0.25
    np.testing.assert_allclose(alike, binomial(16, 64), atol=1e-12)
    independent = binomial(96, 384)
    assert apart.high - apart.low < 1.1 * (independent.high - independent.low)
    nothing = share(np.zeros(384), seeds)  # seen of a variance
    np.testing.assert_allclose(nothing, binomial(0, 64), atol=1e-12)


def test_shares_without_trials_and_impossible_ones():
    assert np.isnan(binomial(0, 0)).all()
    for count, total in ((3, 2), (-1, 4), (1, 0)):
        with pytest.raises(ValueError, match=f"the count is {count}"):
            binomial(count, total)


def test_pairs_are_won_by_less_or_by_more():
    own, partner = np.array([[1.0, 1.0, 1.0]]), np.array([[3.0, 3.0, 3.0]])
    found = paired(own, partner, [0], sign=[1, -1, 0])
    np.testing.assert_array_equal(found.difference.value, [-2.0, -2.0, -2.0])
    np.testing.assert_array_equal(found.won, [1, 0, 0])
    np.testing.assert_array_equal(found.lost, [0, 1, 0])


def test_what_both_share_cancels_in_a_pair():
    generator = np.random.default_rng(3)
    luck = 10.0 * generator.normal(size=(30, 1))
    better = luck - 0.1 + 0.01 * generator.normal(size=(30, 1))
    seeds = np.arange(30)
    found = paired(better, luck, seeds, [1])
    assert found.difference.high[0] < 0.0 and found.won[0] == 30
    alone, other = medians(better, seeds), medians(luck, seeds)
    assert alone.high[0] > other.low[0]  # not seen without pairs
    swapped = paired(luck, better, seeds, [1])
    np.testing.assert_allclose(swapped.difference.value, -found.difference.value)
    assert (swapped.won[0], swapped.lost[0]) == (0, 30)


def test_the_chance_of_a_difference_is_that_of_a_sign_test():
    own = np.array([[1.0], [2.0], [3.0], [4.0], [5.0], [-1.0], [6.0]])
    found = paired(own, np.zeros((7, 1)), np.arange(7), [1])
    assert found.chance[0] == pytest.approx(scipy.stats.binomtest(1, 7).pvalue)
    even = paired(own, own, np.arange(7), [1])
    assert even.chance[0] == 1.0
    assert np.isnan(paired(np.full((2, 1), np.nan), own[:2], [0, 1], [1]).chance[0])
    cells = paired(np.repeat(own, 4, axis=0), np.zeros((28, 1)), np.repeat(np.arange(7), 4), [1])
    assert cells.chance[0] == found.chance[0]  # the same cell four times is no more evidence


def test_fewer_than_six_seeds_are_never_beyond_chance():
    for count in range(1, FEWEST):
        found = paired(np.ones((count, 1)), np.zeros((count, 1)), np.arange(count), [1])
        assert found.chance[0] == 2.0 * 0.5**count > 0.05
    found = paired(np.ones((6, 1)), np.zeros((6, 1)), np.arange(6), [1])
    assert found.chance[0] == 2.0 * 0.5**6 <= 0.05


def test_of_many_comparisons_without_a_difference_few_reports_have_one():
    """The audit's case: at 95 % each, of 200 comparisons some ten would be coloured."""
    generator = np.random.default_rng(2)
    single, family = 0, 0
    for _ in range(40):
        own, partner = generator.normal(size=(2, 16, 200))
        chances = paired(own, partner, np.arange(16), np.ones(200)).chance
        single += np.any(chances <= 0.05)
        family += np.any(adjusted(chances) <= 0.05)
    assert single == 40 and family <= 5


def test_adjusted_chances_are_those_of_benjamini_and_hochberg():
    chances = np.array([[0.01, np.nan, 0.04], [0.03, 0.5, 0.005]])
    expected = [[0.025, np.nan, 0.05], [0.05, 0.5, 0.025]]
    np.testing.assert_allclose(adjusted(chances), expected)
    assert np.isnan(adjusted([np.nan])).all() and adjusted([]).size == 0


def test_pairs_with_an_infinite_side():
    own = np.array([[np.inf], [1.0], [np.inf], [2.0], [np.nan]])
    partner = np.array([[1.0], [np.inf], [np.inf], [2.0], [1.0]])
    found = paired(own, partner, np.arange(5), [1])
    assert (found.pairs[0], found.won[0], found.lost[0]) == (4, 1, 1)
    assert found.difference.value[0] == 0.0  # of -inf, 0 and inf
