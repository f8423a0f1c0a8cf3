"""Medians, shares and paired differences, each with its interval; all of it repeatable.

What is drawn at random in a sweep is its seeds. Episodes of one seed in several cells of the grid
share their random numbers, so that they are drawn, and here resampled, together: the grid is taken
as it is. With one cell this is the usual bootstrap over episodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

from octarm.errors import OctarmError

CONFIDENCE = 0.95
RESAMPLES = 2000

_SEED = 20_250_101  # of the resampling: a report depends on the sweep alone
_NUMBERS = 1_000_000  # that are worked on at a time


class Interval(NamedTuple):
    """An estimate, and an interval that holds the true value in `CONFIDENCE` of all samples.

    Attributes:
        value: the estimate.
        low: lower end of the interval; NaN if there is none, as with a single seed.
        high: upper end.
    """

    value: Any
    low: Any
    high: Any


def binomial(count: int, total: int, confidence: float = CONFIDENCE) -> Interval:
    """The share of a count with Wilson's interval, for independent trials; NaN without a trial.

    Raises:
        OctarmError: if the count is negative or above the total.
    """
    if total == 0 and count == 0:
        return Interval(np.nan, np.nan, np.nan)
    if not 0 <= count <= total:
        raise OctarmError(f"the count is {count}; it must be between 0 and the total, {total}")
    bounds = binomtest(count, total).proportion_ci(confidence, method="wilson")
    return Interval(count / total, float(bounds.low), float(bounds.high))


def medians(
    values: npt.ArrayLike,
    seeds: npt.ArrayLike,
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
) -> Interval:
    """Medians of columns, with percentile bootstrap intervals over seeds.

    A value may be infinite: it counts as larger, or smaller, than all others.

    Args:
        values: a row an episode, shape (n, M); NaN where there is no value.
        seeds: of the rows, shape (n,); rows of one seed are drawn together.
        confidence: of the intervals.
        resamples: their number.

    Returns:
        Three arrays of shape (M,); NaN where a column has no value, and for intervals over fewer
        than two seeds.
    """
    rows = np.asarray(values, dtype=np.float64)
    owners, owner = np.unique(np.asarray(seeds), return_inverse=True)
    columns = [_Column(rows[:, j], owner, len(owners)) for j in range(rows.shape[1])]
    value = np.array([column.medians(np.ones((1, len(owners))))[0] for column in columns])
    if len(owners) < 2:
        return Interval(value, np.full_like(value, np.nan), np.full_like(value, np.nan))
    drawn = np.empty((resamples, len(columns)))
    for part, weights in _resampled(
        len(owners), resamples, max(len(owners), math.isqrt(len(rows)))
    ):
        for j, column in enumerate(columns):
            drawn[part, j] = column.medians(weights)
    low, high = _percentiles(drawn, confidence)
    return Interval(value, low, high)


class Paired(NamedTuple):
    """Rows against partners that had the same random numbers; arrays of shape (M,).

    Attributes:
        pairs: in which both have a value.
        won: of them, those in which the own value is the better one.
        lost: those in which the partner's is.
        difference: median of own less partner's value, with its interval. A pair in which both are
            infinite has no difference.
    """

    pairs: np.ndarray
    won: np.ndarray
    lost: np.ndarray
    difference: Interval


def paired(
    own: npt.ArrayLike,
    partner: npt.ArrayLike,
    seeds: npt.ArrayLike,
    sign: npt.ArrayLike,
    **options: Any,
) -> Paired:
    """Compares rows with their partners.

    Args:
        own: values, shape (n, M); see `medians`.
        partner: those of the partners, shape (n, M).
        seeds: of the rows, shape (n,).
        sign: 1 where less is better, -1 where more is, 0 where neither, shape (M,).
        options: those of `medians`.
    """
    one, other = (np.asarray(x, dtype=np.float64) for x in (own, partner))
    sign = np.asarray(sign)
    with np.errstate(invalid="ignore"):  # infinity less infinity
        difference = one - other
    return Paired(
        pairs=np.sum(~np.isnan(one) & ~np.isnan(other), axis=0),
        won=np.sum(sign * np.sign(difference) < 0, axis=0),
        lost=np.sum(sign * np.sign(difference) > 0, axis=0),
        difference=medians(difference, seeds, **options),
    )


class _Column:
    """The values that there are in a column, sorted, and the seed that each belongs to.

    Blocks of neighbours are counted first, so that a resample costs one block and not the column.
    """

    def __init__(self, values: np.ndarray, owner: np.ndarray, seeds: int) -> None:
        """The values of a column, shape (n,), and the seeds 0 .. seeds - 1 of the rows."""
        known = np.flatnonzero(~np.isnan(values))
        order = known[np.argsort(values[known], kind="stable")]
        blocks = max(16, min(math.isqrt(len(order)), _NUMBERS // max(1, seeds)))
        self._values, self._size = values[order], max(16, -(-len(order) // blocks))
        self._blocks = -(-len(order) // self._size)
        missing = self._blocks * self._size - len(order)
        self._owner = np.pad(owner[order], (0, missing), constant_values=seeds)
        block = np.arange(len(self._owner)) // self._size
        share = np.bincount(block * (seeds + 1) + self._owner, minlength=self._blocks * (seeds + 1))
        self._share = share.reshape(self._blocks, seeds + 1).T[:-1].astype(np.float64)

    def medians(self, weights: np.ndarray) -> np.ndarray:
        """Medians when seeds occur so many times, shape (k, S); NaN when no value does."""
        if not self._values.size:
            return np.full(len(weights), np.nan)
        count = np.cumsum(weights @ self._share, axis=1)  # whole numbers, so exact
        total = count[:, -1]
        padded = np.pad(weights, ((0, 0), (0, 1)))  # no weight for what fills the last block
        with np.errstate(invalid="ignore"):  # halfway between two infinities
            middle = 0.5 * (
                self._value_at(np.floor(0.5 * (total - 1.0)), count, padded)
                + self._value_at(np.floor(0.5 * total), count, padded)
            )
        return np.where(total > 0.0, middle, np.nan)

    def _value_at(self, rank: np.ndarray, count: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """The values that have so many before them, shape (k,)."""
        rows = np.arange(len(rank))
        block = np.minimum(np.sum(count <= rank[:, None], axis=1), self._blocks - 1)
        before = np.where(block > 0, count[rows, block - 1], 0.0)
        place = block[:, None] * self._size + np.arange(self._size)
        inside = before[:, None] + np.cumsum(weights[rows[:, None], self._owner[place]], axis=1)
        first = block * self._size + np.sum(inside <= rank[:, None], axis=1)
        return self._values[np.minimum(first, len(self._values) - 1)]


def _resampled(seeds: int, resamples: int, width: int) -> Iterator[tuple[slice, np.ndarray]]:
    """How often each seed occurs in each resample, shape (k, S), some resamples at a time."""
    generator = np.random.default_rng(_SEED)
    step = max(1, _NUMBERS // width)
    for begin in range(0, resamples, step):
        k = min(step, resamples - begin)
        drawn = generator.integers(seeds, size=(k, seeds)) + seeds * np.arange(k)[:, None]
        weights = np.bincount(drawn.ravel(), minlength=k * seeds).reshape(k, seeds)
        yield slice(begin, begin + k), weights.astype(np.float64)


def _percentiles(drawn: np.ndarray, confidence: float) -> tuple[np.ndarray, np.ndarray]:
    """The values that cut off both tails, without interpolation as they may be infinite."""
    ordered = np.sort(drawn, axis=0)  # NaN last
    known = np.sum(~np.isnan(drawn), axis=0)
    tail = 0.5 * (1.0 - confidence)
    last = np.maximum(known - 1, 0)
    columns = np.arange(int(drawn.shape[1]))
    low = ordered[np.floor(tail * last + 1e-9).astype(int), columns]
    high = ordered[np.ceil((1.0 - tail) * last - 1e-9).astype(int), columns]
    return low, high
