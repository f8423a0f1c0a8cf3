"""Robustness margins: how far something may grow before an error bound is broken.

Each seed has a margin of its own. The bound is tried on a coarse grid of values, the same for all
seeds, and then at some values between the last one that met it and the first one that did not, of
every seed at once, until that gap is small. It is taken for granted that the bound is not met again
further on; where the grid shows that it is, that is reported, and the margin is that of the first
failure.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

_POINTS = 3  # values that are tried within a gap at a time
_SMALLEST = 1e-5  # gap, in shares of the way, that is never made smaller
_DRAWS = 9999  # of the bootstrap


class Outcome(NamedTuple):
    """What came of some arms.

    Attributes:
        excess: the measure over its bound, the largest of them if there are several, shape (n,)
            [1]; the bound is met up to 1. Infinite for an arm that diverged.
        digest: a number that stands for the motion, shape (n,).
    """

    excess: np.ndarray
    digest: np.ndarray


# Seeds and shares of the way from the low to the high value, both of shape (n,), to their outcome.
Try = Callable[[np.ndarray, np.ndarray], Outcome]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Brackets:
    """Between which shares of the way from the low to the high value the bound is broken.

    Attributes:
        met: the largest share that met it, all smaller ones that were tried included, shape (n,);
            -inf where not even the low value did.
        failed: the smallest one that did not, shape (n,); inf where the high value met it.
        again: whether a larger share met it again, shape (n,).
        grid: the shares of the coarse grid, shape (k,).
        excess: what came of them, shape (n, k).
        alike: whether all seeds gave the same motion on the grid, bit by bit; the rest is then that
            of the first one.
    """

    met: np.ndarray
    failed: np.ndarray
    again: np.ndarray
    grid: np.ndarray
    excess: np.ndarray
    alike: bool

    @property
    def margins(self) -> np.ndarray:
        """The margin of each seed: `met`, or inf where the high value met the bound, shape (n,)."""
        return np.where(np.isinf(self.failed), np.inf, self.met)


def search(attempt: Try, seeds: int, *, intervals: int = 8, resolution: float = 0.01) -> Brackets:
    """The brackets of all seeds.

    That of a seed does not depend on the other seeds.

    Args:
        attempt: runs arms.
        seeds: number of seeds; they are 0, 1, ...
        intervals: of the coarse grid.
        resolution: largest gap between `met` and `failed`, as a share of `failed` [1].
    """
    grid = np.arange(intervals + 1) / intervals
    outcome = attempt(np.repeat(np.arange(seeds), len(grid)), np.tile(grid, seeds))
    excess, digest = (np.reshape(x, (seeds, len(grid))) for x in outcome)
    alike = seeds > 1 and bool(np.all(digest == digest[0]))
    every = np.arange(1 if alike else seeds)
    gaps = _Gaps(len(every))
    gaps.take(every, np.tile(grid, (len(every), 1)), excess[every])
    while len(wide := gaps.wide(resolution)):
        shares = gaps.inner(wide)
        tried = attempt(np.repeat(wide, _POINTS), shares.ravel())
        gaps.take(wide, shares, np.reshape(tried.excess, shares.shape))
    met, failed, again = (np.resize(x, seeds) for x in (gaps.met, gaps.failed, gaps.again))
    return Brackets(met=met, failed=failed, again=again, grid=grid, excess=excess, alike=alike)


class _Gaps:
    """What lies between `met` and `failed` of each seed, see `Brackets`."""

    def __init__(self, seeds: int) -> None:
        self.met, self.failed = np.full(seeds, -np.inf), np.full(seeds, np.inf)
        self.again = np.zeros(seeds, dtype=bool)

    def take(self, seeds: np.ndarray, shares: np.ndarray, excess: np.ndarray) -> None:
        """Takes up what came of rising shares within the gaps of seeds, both of shape (n, k)."""
        for i, row, good in zip(seeds, shares, excess <= 1.0, strict=True):
            first = int(np.argmin(good)) if not good.all() else len(row)  # that failed
            self.again[i] |= bool(good[first:].any())
            if first > 0:
                self.met[i] = row[first - 1]
            if first < len(row):
                self.failed[i] = row[first]

    def wide(self, resolution: float) -> np.ndarray:
        """The seeds whose gaps are not small enough yet."""
        gap = self.failed - self.met
        return np.flatnonzero(
            np.isfinite(gap) & (gap > np.maximum(resolution * self.failed, _SMALLEST))
        )

    def inner(self, seeds: np.ndarray) -> np.ndarray:
        """Shares that cut the gaps of seeds into equal parts, shape (n, `_POINTS`)."""
        part = np.arange(1, _POINTS + 1) / (_POINTS + 1)
        return self.met[seeds, None] + (self.failed - self.met)[seeds, None] * part


class Estimate(NamedTuple):
    """A margin of all seeds, in shares of the way; inf: beyond the high value, -inf: below the low.

    Attributes:
        value: the largest that so many of the seeds bear.
        low: lower end of its confidence interval; NaN when all seeds are alike.
        high: upper end.
    """

    value: float
    low: float
    high: float


def estimate(brackets: Brackets, share: float, confidence: float = 0.95) -> Estimate:
    """The largest value that a share of the seeds bears, with a bootstrap interval over seeds.

    The interval holds the middle of what samples of as many seeds, drawn with replacement, give.
    It says nothing of the gap of the search, which `resolution` bounds.

    Args:
        brackets: of the seeds.
        share: of the seeds that have to meet the bound [1]; 1 for all of them.
        confidence: of the interval [1].
    """
    margins = np.sort(brackets.margins)
    n = len(margins)
    place = n - max(1, math.ceil(share * n - 1e-9))
    if brackets.alike or n == 1:
        return Estimate(float(margins[place]), math.nan, math.nan)
    draws = np.random.default_rng(0).integers(n, size=(_DRAWS, n))
    values = np.sort(np.partition(margins[draws], place, axis=1)[:, place])
    tail = 0.5 * (1.0 - confidence) * (_DRAWS - 1)
    ends = values[math.floor(tail)], values[math.ceil(_DRAWS - 1 - tail)]
    return Estimate(float(margins[place]), float(ends[0]), float(ends[1]))
