"""Medians, shares and paired differences, and what their intervals promise."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from octarm.reports import statistics
from octarm.reports.statistics import binomial, medians, paired

values = st.lists(st.floats(-1e6, 1e6) | st.just(np.inf) | st.just(np.nan), min_size=1, max_size=60)


@given(values)
def test_medians_are_those_of_the_values_there_are(column):
    known = np.array(column)[~np.isnan(column)]
    found = medians(np.array(column)[:, None], np.arange(len(column)), resamples=20).value[0]
    assert found == np.median(known) if known.size else np.isnan(found)


@given(values, st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_a_resample_is_as_if_its_rows_were_repeated(column, seeds, seed):
    column = np.array(column)
    generator = np.random.default_rng(seed)
    owner = generator.integers(seeds, size=len(column))
    weights = generator.integers(4, size=(5, seeds)).astype(float)
    found = statistics._Column(column, owner, seeds).medians(weights)
    for own, median in zip(weights, found, strict=True):
        repeated = np.repeat(column, own[owner].astype(int))
        known = repeated[~np.isnan(repeated)]
        assert median == np.median(known) if known.size else np.isnan(median)


@pytest.mark.parametrize("n", [9, 40, 301])
def test_intervals_are_those_of_scipys_bootstrap(n):
    sample = np.random.default_rng(n).lognormal(size=n)
    ours = medians(sample[:, None], np.arange(n))
    theirs = scipy.stats.bootstrap(
        (sample,), np.median, method="percentile", n_resamples=9999, rng=1
    ).confidence_interval
    order = np.sort(sample)
    for end, other in ((ours.low[0], theirs.low), (ours.high[0], theirs.high)):
        between = np.searchsorted(order, [end, other])
        assert abs(between[1] - between[0]) <= 1 + 0.01 * n  # ends lie on, or between, the same


def coverage(draw, truth: float, samples: int = 250) -> float:
    """The share of samples whose interval holds the truth."""
    generator = np.random.default_rng(0)
    held = 0
    for _ in range(samples):
        column, seeds = draw(generator)
        found = medians(column[:, None], seeds, resamples=400)
        held += found.low[0] <= truth <= found.high[0]
    return held / samples


@pytest.mark.parametrize(
    ("distribution", "truth"),
    [
        (lambda generator: generator.normal(size=16), 0.0),
        (lambda generator: generator.exponential(size=40), np.log(2.0)),
        (lambda generator: generator.standard_cauchy(size=25), 0.0),
    ],
)
def test_intervals_hold_the_true_median_as_often_as_they_say(distribution, truth):
    def draw(generator):
        column = distribution(generator)
        return column, np.arange(len(column))

    assert 0.91 <= coverage(draw, truth) <= 0.99


def test_what_cells_share_by_their_seed_is_not_taken_for_new_evidence():
    def draw(generator, together: bool = True):
        common = np.repeat(generator.normal(size=24), 8)  # 8 cells a seed
        column = common + 0.1 * generator.normal(size=common.size)
        seeds = np.repeat(np.arange(24), 8) if together else np.arange(common.size)
        return column, seeds

    assert 0.90 <= coverage(draw, 0.0) <= 0.99
    assert coverage(lambda generator: draw(generator, together=False), 0.0) < 0.7


def test_the_grid_is_not_resampled():
    cells = np.tile([0.0, 1.0, 100.0], 20)  # three cells without anything random
    found = medians(cells[:, None], np.repeat(np.arange(20), 3))
    assert (found.value, found.low, found.high) == (1.0, 1.0, 1.0)


def test_intervals_depend_on_the_sample_alone(monkeypatch):
    generator = np.random.default_rng(5)
    sample, seeds = generator.normal(size=(90, 3)), np.repeat(np.arange(30), 3)
    before = medians(sample, seeds)
    shuffled = generator.permutation(90)
    monkeypatch.setattr(statistics, "_NUMBERS", 1000)  # fewer at a time
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
def test_shares_have_wilsons_interval(count, total):
    z = scipy.stats.norm.ppf(0.975)
    p = count / total
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * np.sqrt(p * (1 - p) / total + (z / (2 * total)) ** 2)
    found = binomial(count, total)
    np.testing.assert_allclose(found, [p, middle - half, middle + half], atol=1e-12)
    exact = scipy.stats.binomtest(count, total).proportion_ci(method="exact")
    assert exact.low - 0.05 <= found.low and found.high <= exact.high + 0.05


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


def test_pairs_with_an_infinite_side():
    own = np.array([[np.inf], [1.0], [np.inf], [2.0], [np.nan]])
    partner = np.array([[1.0], [np.inf], [np.inf], [2.0], [1.0]])
    found = paired(own, partner, np.arange(5), [1])
    assert (found.pairs[0], found.won[0], found.lost[0]) == (4, 1, 1)
    assert found.difference.value[0] == 0.0  # of -inf, 0 and inf
