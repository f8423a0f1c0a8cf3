"""Medians, shares and paired differences, each with its interval; all of it repeatable.

What is drawn at random in a sweep is its seeds. Episodes of one seed share their random numbers, so
that a seed, not an episode, is one observation: the grid is taken as it is.

The interval of a median is that of a sign test over seeds. A seed's balance is the number of its
values below a limit, less half of all its values. If the limit is the true median, a balance is as
likely to be positive as negative, and the sum of all of them is compared with what it would be had
chance flipped their signs. Limits that this does not refute make up the interval. With one value a
seed it is the interval of order statistics, which is exact for any distribution; with several the
balances are taken to be symmetric. It needs 6 seeds: fewer are too often all on one side by chance.
"""

from __future__ import annotations

import bisect
import functools
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import betaincinv, stdtrit

from octarm.errors import OctarmError

CONFIDENCE = 0.95
_TAIL = 0.5 * (1.0 - CONFIDENCE)
FEWEST = 6  # seeds with which a median has an interval: 2 / 2^6 <= 1 - CONFIDENCE < 2 / 2^5

_SEED = 20_250_101  # of the signs: a report depends on the sweep alone
_ALL_SIGNS = 12  # balances of which all combinations of signs are tried; of more, as many as of 12
_MOST = 64  # balances; more are added up, which leaves the test what it is


class Interval(NamedTuple):
    """An estimate, and an interval that holds the true value in `CONFIDENCE` of all samples.

    Of a median of fewer than `FEWEST` seeds it is no interval, but the range from the smallest to
    the largest value of a seed.

    Its ends are NaN if there is none, as with a single seed.
    """

    value: Any
    low: Any
    high: Any


def binomial(count: float, total: float) -> Interval:
    """The share of a count with the exact interval of Clopper and Pearson; NaN without a trial.

    Trials are independent. Their number need not be whole, see `share`. Raises OctarmError for a
    count that is not between 0 and the total.
    """
    if total == 0 and count == 0:
        return Interval(np.nan, np.nan, np.nan)
    if not 0 <= count <= total:
        raise OctarmError(f"the count is {count}; it must be between 0 and the total, {total}")
    low = betaincinv(count, total - count + 1.0, _TAIL) if count > 0 else 0.0
    high = betaincinv(count + 1.0, total - count, 1.0 - _TAIL) if count < total else 1.0
    return Interval(count / total, float(low), float(high))


def share(true: npt.ArrayLike, seeds: npt.ArrayLike) -> Interval:
    """The share of rows that are true, with an interval that holds however alike a seed's rows are.

    It is that of `binomial` for as many independent trials as the rows are worth: p (1 - p) over
    the variance of the share, with Student's t for that of few seeds (Korn and Graubard, 1998), but
    no more than there are rows, and no less than there are seeds. The variance is the one between
    seeds, and to one part in m + 1 the largest that there can be, that of seeds whose rows are all
    alike: m is the number of seeds with a true row, or with a false one if they are fewer. Rows and
    their seeds have shape (n,).
    """
    rows = np.asarray(true, dtype=np.float64)
    owner = np.unique(np.asarray(seeds), return_inverse=True)[1]
    size, count = np.bincount(owner), np.bincount(owner, rows)
    n, seeds_there = len(rows), len(size)
    if not n:
        return binomial(0, 0)
    p, worth = float(np.sum(count)) / n, float(seeds_there)
    if seeds_there > 1 and 0.0 < p < 1.0:
        off = count - p * size
        between = float(np.sum(off * off)) / n**2 * seeds_there / (seeds_there - 1)
        largest = p * (1.0 - p) * float(np.sum(size * size)) / n**2
        part = 1.0 / (1.0 + min(np.count_nonzero(count), np.count_nonzero(size - count)))
        variance = between + part * (largest - between)
        narrower = float(stdtrit(n - 1, _TAIL) / stdtrit(seeds_there - 1, _TAIL))
        worth = min(max(p * (1.0 - p) / variance * narrower**2, worth), n)
    return binomial(p * worth, worth)._replace(value=p)


def medians(values: npt.ArrayLike, seeds: npt.ArrayLike) -> Interval:
    """Medians of columns, with the intervals of a sign test over seeds.

    There is a row an episode, shape (n, M), NaN where there is no value, with its seeds, shape
    (n,). A value may be infinite: it counts as larger, or smaller, than all others. The three
    arrays have the shape (M,); NaN where a column has no value, and for intervals where fewer than
    two seeds have one. See `seeds_with_values` for which of them are ranges.
    """
    rows, owner = np.asarray(values, dtype=np.float64), np.asarray(seeds)
    found = [_median(rows[:, j], owner) for j in range(rows.shape[1])]
    return Interval(*np.array(found).reshape(-1, 3).T)


def seeds_with_values(values: npt.ArrayLike, seeds: npt.ArrayLike) -> np.ndarray:
    """How many seeds have a value in each column, for rows as `medians` takes them, shape (M,)."""
    rows, owner = np.asarray(values, dtype=np.float64), np.asarray(seeds)
    return np.array([len(np.unique(owner[~np.isnan(column)])) for column in rows.T], dtype=int)


class Paired(NamedTuple):
    """Rows against partners that had the same random numbers; arrays of shape (M,).

    Attributes:
        pairs: in which both have a value.
        won: of them, those in which the own value is the better one.
        lost: those in which the partner's is.
        difference: median of own less partner's value, with its interval. A pair in which both are
            infinite has no difference.
        seeds: of these pairs that have a difference.
        chance: probability of a sum of balances this far from zero if the true median of the
            differences were zero [1]; NaN without a pair.
    """

    pairs: np.ndarray
    won: np.ndarray
    lost: np.ndarray
    difference: Interval
    seeds: np.ndarray
    chance: np.ndarray


def paired(
    own: npt.ArrayLike, partner: npt.ArrayLike, seeds: npt.ArrayLike, sign: npt.ArrayLike
) -> Paired:
    """Compares rows with their partners, both of shape (n, M) as `medians` takes them.

    The sign is 1 where less is better, -1 where more is, 0 where neither, shape (M,).
    """
    one, other = (np.asarray(x, dtype=np.float64) for x in (own, partner))
    with np.errstate(invalid="ignore"):  # infinity less infinity
        difference = one - other
    worse = np.asarray(sign) * np.sign(difference)
    return Paired(
        pairs=np.sum(~np.isnan(one) & ~np.isnan(other), axis=0),
        won=np.sum(worse < 0, axis=0),
        lost=np.sum(worse > 0, axis=0),
        difference=medians(difference, seeds),
        seeds=seeds_with_values(difference, seeds),
        chance=np.array([_chance(column, seeds) for column in difference.T]),
    )


def adjusted(chances: npt.ArrayLike) -> np.ndarray:
    """Probabilities, shape (...), adjusted by Benjamini and Hochberg for the number of them.

    Of the comparisons whose adjusted probability is at most 5 %, at most 5 % are expected to be
    without a difference. NaN stays so and does not count.
    """
    from scipy.stats import false_discovery_control  # takes half a second to import

    out = np.array(chances, dtype=np.float64)
    known = ~np.isnan(out)
    if known.any():
        out[known] = false_discovery_control(out[known])
    return out


def _median(column: np.ndarray, seeds: np.ndarray) -> tuple[float, float, float]:
    """The fields of the `Interval` of one column, shape (n,)."""
    known = ~np.isnan(column)
    order = np.argsort(column[known], kind="stable")
    values = column[known][order]
    owners, owner = np.unique(seeds[known], return_inverse=True)
    owner, n = owner[order], len(values)
    if not n:
        return math.nan, math.nan, math.nan
    value = middle(values)
    if len(owners) < 2:
        return value, math.nan, math.nan
    if len(owners) < FEWEST:
        each = [middle(values[owner == k]) for k in range(len(owners))]
        return value, min(each), max(each)
    low, high = _place(owner), n - 1 - _place(owner[::-1])
    return value, float(values[low]), float(values[high])


def middle(values: np.ndarray) -> float:
    """The median of values that rise, of which there is at least one, shape (n,)."""
    n = len(values)
    with np.errstate(invalid="ignore"):  # halfway between two infinities
        return float(0.5 * (values[(n - 1) // 2] + values[n // 2]))


def _place(owner: np.ndarray) -> int:
    """The first of values that rise which is not refuted as their median, given their seeds."""
    half = 0.5 * np.bincount(owner)

    def kept(place: int) -> bool:
        return not _below(np.bincount(owner[: place + 1], minlength=len(half)) - half)

    # Half of the values or more are up to the middle one, which is kept.
    return bisect.bisect_left(range(len(owner) // 2), True, key=kept)


def _below(balance: np.ndarray) -> bool:
    """Whether signs flipped by chance seldom give at most the sum of balances."""
    total, square = float(np.sum(balance)), float(np.sum(balance * balance))
    certain = total * total > -2.0 * math.log(_TAIL) * square  # by Hoeffding's bound
    return total < 0.0 and (certain or _shares(balance)[0] <= _TAIL)


def _shares(balance: np.ndarray) -> tuple[float, float]:
    """How often flipped signs give at most, and at least, the sum of balances, shape (S,) [1]."""
    if len(balance) > _MOST:
        balance = np.bincount(np.arange(len(balance)) % _MOST, balance)
    sums, total = _signs(len(balance)) @ balance, float(np.sum(balance))
    rounding = 1e-9 * float(np.sum(np.abs(balance)))
    return float(np.mean(sums <= total + rounding)), float(np.mean(sums >= total - rounding))


@functools.cache
def _signs(count: int) -> np.ndarray:
    """Combinations of signs and their opposites, shape (R, count): all, or always the same."""
    if count <= _ALL_SIGNS:
        return np.array(list(itertools.product((-1.0, 1.0), repeat=count)))
    drawn = np.random.default_rng(_SEED).integers(2, size=(2 ** (_ALL_SIGNS - 1), _MOST))
    half = 2.0 * drawn[:, :count] - 1.0
    half[0] = 1.0
    return np.concatenate([half, -half])


def _chance(column: np.ndarray, seeds: npt.ArrayLike) -> float:
    """See `Paired.chance`, of one column of differences, shape (n,)."""
    known = ~np.isnan(column)
    if not known.any():
        return math.nan
    owner = np.unique(np.asarray(seeds)[known], return_inverse=True)[1]
    balance = np.bincount(owner, np.sign(column[known]))
    return min(1.0, 2.0 * min(_shares(balance)))
