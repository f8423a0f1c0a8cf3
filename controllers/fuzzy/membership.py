"""Fuzzy sets, eq (43).

A membership function says how far x belongs to a set: 0 is not at all, 1 is fully. The four kinds
here have a left and a right side of their own; one that reaches to infinity is an open shoulder, on
which the membership stays 1. Each is called with arrays of any shape, elementwise, and can be
spread over a range: `between` makes the set at a peak whose neighbours peak before and after it.

    Triangular(0.0, 0.5, 1.0)               # a tent on [0, 1]
    Triangular(-math.inf, -1.0, -0.5)       # 1 up to -1: an open left shoulder
    Gaussian(0.0, 0.2, math.inf)            # a Gaussian flank, then an open right shoulder
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import ClassVar, Self

import numpy as np

from octarm.errors import OctarmError


@dataclasses.dataclass(frozen=True)
class Trapezoidal:
    """Straight from 0 at `left` up to 1 on [top_left, top_right], and down to 0 at `right`.

    Raises OctarmError unless left <= top_left <= top_right <= right and the top is finite.
    """

    left: float
    top_left: float
    top_right: float
    right: float

    def __post_init__(self) -> None:
        name = type(self).__name__
        if not all(a <= b for a, b in itertools.pairwise(self.corners)):
            given = ", ".join(f"{x:g}" for x in self.corners)
            raise OctarmError(f"the corners of {name} are {given}; they must rise")
        if not math.isfinite(self.top_right - self.top_left):
            raise OctarmError(f"the top of {name} is infinite; it must be finite")

    @property
    def corners(self) -> tuple[float, ...]:
        """Where the membership stops rising or falling, in rising order; they may be infinite."""
        return self.left, self.top_left, self.top_right, self.right

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], of the shape of x."""
        with np.errstate(over="ignore"):  # a slope that overflows is below 0 or above 1
            rising = _slope(x, self.left, self.top_left)
            falling = _slope(-x, -self.right, -self.top_right)
        return np.maximum(np.minimum(np.minimum(rising, falling), 1.0), np.zeros_like(x))

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Self:
        """Top over the middle half of the way to its neighbours; all memberships add up to 1."""
        before, after = peak - before, after - peak
        near, far = (0.25 * gap if math.isfinite(gap) else 0.0 for gap in (before, after))
        return cls(peak - 0.75 * before, peak - near, peak + far, peak + 0.75 * after)


def _slope(x: np.ndarray, foot: float, top: float) -> np.ndarray | float:
    """0 at the foot and 1 at the top; upright if both are one, and not there without a foot."""
    if math.isinf(foot):
        return 1.0
    return np.heaviside(x - foot, 1.0) if foot == top else (x - foot) / (top - foot)


class Triangular(Trapezoidal):
    """Straight from 0 at `left` up to 1 at `peak`, and down to 0 at `right`.

    Raises OctarmError unless left <= peak <= right and the peak is finite.
    """

    def __init__(self, left: float, peak: float, right: float) -> None:
        super().__init__(left, peak, peak, right)

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Self:
        """Ends where its neighbours peak: the memberships of all sets add up to 1."""
        return cls(before, peak, after)


@dataclasses.dataclass(frozen=True)
class Gaussian:
    """exp(-((x - center) / width)^2), with a width for each side; 1 / width is the paper's sigma.

    The widths, at which it is 1/e, are inf for open shoulders. Raises OctarmError unless the center
    is finite, and the other fields are above 0.
    """

    half: ClassVar[float] = math.sqrt(math.log(2.0))  # widths at which the membership is 1/2

    center: float
    left: float
    right: float

    def __post_init__(self) -> None:
        kind = type(self).__name__
        if not math.isfinite(self.center):
            raise OctarmError(f"center of {kind} is {self.center:g}; it must be finite")
        for name, value in vars(self).items():
            if name != "center" and not value > 0.0:
                raise OctarmError(f"{name} of {kind} is {value:g}; it must be above 0")

    @property
    def corners(self) -> tuple[float, ...]:
        """The center alone."""
        return (self.center,)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], of the shape of x."""
        z = np.zeros_like(x)
        with np.errstate(over="ignore"):  # beyond all numbers the membership is 0
            for distance, width in ((self.center - x, self.left), (x - self.center, self.right)):
                if math.isfinite(width):
                    z = z + np.maximum(distance, 0.0) / width
            return self.profile(z)

    def profile(self, z: np.ndarray) -> np.ndarray:
        """Membership [1] at a distance of z widths from the center, of the shape of z."""
        return np.exp(-z * z)

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Self:
        """Crosses its neighbours at a membership of 1/2."""
        return cls(peak, (peak - before) / (2.0 * cls.half), (after - peak) / (2.0 * cls.half))


@dataclasses.dataclass(frozen=True)
class GeneralisedBell(Gaussian):
    """1 / (1 + |(x - center) / width|^(2 slope)), which is 1/2 at one width from the center.

    Attributes:
        slope: how square the bell is [1].
    """

    half: ClassVar[float] = 1.0

    slope: float = 2.0

    def profile(self, z: np.ndarray) -> np.ndarray:
        """Membership [1] at a distance of z widths from the center, of the shape of z."""
        return 1.0 / (1.0 + np.power(z, 2.0 * self.slope))


Membership = Trapezoidal | Gaussian
