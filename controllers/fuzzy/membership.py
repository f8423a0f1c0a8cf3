"""Fuzzy sets, eq (43).

A membership function says how far x belongs to a set: 0 is not at all, 1 is fully. The four kinds
here have a left and a right side of their own. A side that reaches to infinity is an open shoulder:
the membership stays 1 on it. Each is called with arrays of any shape, elementwise.

    Triangular(0.0, 0.5, 1.0)               # a tent on [0, 1]
    Triangular(-math.inf, -1.0, -0.5)       # 1 up to -1: an open left shoulder
    Gaussian(0.0, 0.2, math.inf)            # a Gaussian flank, then an open right shoulder
"""

from __future__ import annotations

import abc
import dataclasses
import itertools
import math
from typing import ClassVar, Self

import numpy as np

from octarm.errors import OctarmError


class Membership(abc.ABC):
    """A fuzzy set on the real line, of a family that can be spread over a range."""

    @property
    @abc.abstractmethod
    def corners(self) -> tuple[float, ...]:
        """Where the membership stops rising or falling, in rising order; it may be infinite."""

    @abc.abstractmethod
    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], in [0, 1]; of the shape of x."""

    @classmethod
    @abc.abstractmethod
    def between(cls, before: float, peak: float, after: float) -> Self:
        """The set at `peak` whose neighbours peak at `before` and `after`."""


class _Straight(Membership):
    """Straight from 0 up to 1 and down to 0, between four corners."""

    def __post_init__(self) -> None:
        _, top_left, top_right, _ = corners = self.corners
        if not all(a <= b for a, b in itertools.pairwise(corners)):
            given = ", ".join(f"{x:g}" for x in vars(self).values())
            raise OctarmError(f"the corners of {type(self).__name__} are {given}; they must rise")
        if not math.isfinite(top_right - top_left):
            raise OctarmError(f"the top of {type(self).__name__} is infinite; it must be finite")

    def __call__(self, x: np.ndarray) -> np.ndarray:
        left, top_left, top_right, right = self.corners
        y = 1.0  # what lies under both slopes; a slope with no foot is not there
        with np.errstate(over="ignore"):  # a slope that overflows is below 0 or above 1
            if math.isfinite(left):
                rising = (x - left) / (top_left - left) if left < top_left else _step(x - left)
                y = np.minimum(rising, y)
            if math.isfinite(right):
                width = right - top_right
                falling = (right - x) / width if top_right < right else _step(right - x)
                y = np.minimum(falling, y)
        return np.maximum(y, np.zeros_like(x))


def _step(x: np.ndarray) -> np.ndarray:
    return np.heaviside(x, 1.0)  # a vertical slope; NaN stays NaN


@dataclasses.dataclass(frozen=True)
class Triangular(_Straight):
    """Straight from 0 at `left` up to 1 at `peak`, and down to 0 at `right`.

    Raises OctarmError unless left <= peak <= right and the peak is finite.
    """

    left: float
    peak: float
    right: float

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left, peak, peak, right."""
        return self.left, self.peak, self.peak, self.right

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Self:
        """Ends where its neighbours peak: the memberships of all sets add up to 1."""
        return cls(before, peak, after)


@dataclasses.dataclass(frozen=True)
class Trapezoidal(_Straight):
    """Straight from 0 at `left` up to 1 on [top_left, top_right], and down to 0 at `right`.

    Raises OctarmError unless left <= top_left <= top_right <= right and the top is finite.
    """

    left: float
    top_left: float
    top_right: float
    right: float

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """All fields."""
        return self.left, self.top_left, self.top_right, self.right

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Self:
        """Top over the middle half of the way to its neighbours; all memberships add up to 1."""
        before, after = peak - before, after - peak
        near, far = (0.25 * gap if math.isfinite(gap) else 0.0 for gap in (before, after))
        return cls(peak - 0.75 * before, peak - near, peak + far, peak + 0.75 * after)


@dataclasses.dataclass(frozen=True)
class Gaussian(Membership):
    """exp(-((x - center) / width)^2), with a width for each side; 1 / width is the paper's sigma.

    The widths, at which it is 1/e, are inf for open shoulders. Raises OctarmError unless the center
    is finite, and the other fields are above 0.
    """

    half: ClassVar[float] = math.sqrt(math.log(2.0))  # widths at which the membership is 1/2

    center: float
    left: float
    right: float

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            allowed = "finite" if name == "center" else "above 0"
            if not (math.isfinite(value) if name == "center" else value > 0.0):
                kind = type(self).__name__
                raise OctarmError(f"{name} of {kind} is {value:g}; it must be {allowed}")

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
