"""Fuzzy sets, eq (43).

A membership function says how far x belongs to a set: 0 is not at all, 1 is fully. The four kinds
here have a left and a right side of their own. A side that reaches to infinity is an open shoulder:
the membership stays 1 on it. Each is called with arrays of any shape, elementwise.

    Triangular(0.0, 0.5, 1.0)               # a tent on [0, 1]
    Triangular(-math.inf, -1.0, -0.5)       # 1 up to -1: an open left shoulder
    Gaussian(0.0, 0.2, math.inf)            # a Gaussian flank, then an open right shoulder
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Protocol

import numpy as np

from octarm.errors import OctarmError


class Membership(Protocol):
    """A fuzzy set on the real line."""

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], in [0, 1]; of the shape of x."""
        ...

    def cut(self, level: float) -> tuple[float, float]:
        """The ends of the interval in which the membership is at least `level`, in (0, 1]."""
        ...


class Family(Protocol):
    """A family of membership functions that can be spread over a range."""

    def between(self, before: float, peak: float, after: float) -> Membership:
        """The set at `peak` whose neighbours peak at `before` and `after`."""
        ...


@dataclasses.dataclass(frozen=True)
class Triangular:
    """Straight from 0 at `left` up to 1 at `peak`, and down to 0 at `right`.

    Attributes:
        left: where it begins; -inf for an open left shoulder.
        peak: where it is 1.
        right: where it ends; inf for an open right shoulder.

    Raises:
        ValueError: unless left <= peak <= right and the peak is finite.
    """

    left: float
    peak: float
    right: float

    def __post_init__(self) -> None:
        _check_rising(self)
        _check_finite(self, "peak")

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], of the shape of x."""
        return _below_slopes(x, self.left, self.peak, self.peak, self.right)

    def cut(self, level: float) -> tuple[float, float]:
        """The interval in which the membership is at least `level`."""
        return _foot(self.left, self.peak, level), _foot(self.right, self.peak, level)

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Triangular:
        """Ends where its neighbours peak: the memberships of all sets add up to 1."""
        return cls(before, peak, after)


@dataclasses.dataclass(frozen=True)
class Trapezoidal:
    """Straight from 0 at `left` up to 1 on [top_left, top_right], and down to 0 at `right`.

    Attributes:
        left: where it begins; -inf for an open left shoulder.
        top_left: where it reaches 1.
        top_right: where it leaves 1.
        right: where it ends; inf for an open right shoulder.

    Raises:
        ValueError: unless left <= top_left <= top_right <= right and the top is finite.
    """

    left: float
    top_left: float
    top_right: float
    right: float

    def __post_init__(self) -> None:
        _check_rising(self)
        _check_finite(self, "top_left", "top_right")

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], of the shape of x."""
        return _below_slopes(x, self.left, self.top_left, self.top_right, self.right)

    def cut(self, level: float) -> tuple[float, float]:
        """The interval in which the membership is at least `level`."""
        return _foot(self.left, self.top_left, level), _foot(self.right, self.top_right, level)

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Trapezoidal:
        """Top over the middle half of the way to its neighbours; all memberships add up to 1."""
        before, after = peak - before, after - peak
        near, far = (0.25 * gap if math.isfinite(gap) else 0.0 for gap in (before, after))
        return cls(peak - 0.75 * before, peak - near, peak + far, peak + 0.75 * after)


@dataclasses.dataclass(frozen=True)
class GeneralisedBell:
    """1 / (1 + |(x - center) / width|^(2 slope)), with a width for each side.

    Attributes:
        center: where it is 1.
        left: width on the left, at which it is 1/2; inf for an open left shoulder.
        right: width on the right; inf for an open right shoulder.
        slope: how square the bell is [1].

    Raises:
        ValueError: unless the center is finite, and the widths and the slope are above 0.
    """

    center: float
    left: float
    right: float
    slope: float = 2.0

    def __post_init__(self) -> None:
        _check_finite(self, "center", "slope")
        _check_positive(self, "left", "right", "slope")

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], of the shape of x."""
        with np.errstate(over="ignore"):  # 1 / (1 + inf) is the 0 it should be
            return 1.0 / (1.0 + np.power(_widths(x, self), 2.0 * self.slope))

    def cut(self, level: float) -> tuple[float, float]:
        """The interval in which the membership is at least `level`."""
        reach = (1.0 / level - 1.0) ** (0.5 / self.slope)
        return self.center - reach * self.left, self.center + reach * self.right

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> GeneralisedBell:
        """Crosses its neighbours at a membership of 1/2."""
        return cls(peak, 0.5 * (peak - before), 0.5 * (after - peak))


@dataclasses.dataclass(frozen=True)
class Gaussian:
    """exp(-((x - center) / width)^2), with a width for each side; 1 / width is the paper's sigma.

    Attributes:
        center: where it is 1.
        left: width on the left, at which it is 1/e; inf for an open left shoulder.
        right: width on the right; inf for an open right shoulder.

    Raises:
        ValueError: unless the center is finite and the widths are above 0.
    """

    center: float
    left: float
    right: float

    def __post_init__(self) -> None:
        _check_finite(self, "center")
        _check_positive(self, "left", "right")

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Membership of x [1], of the shape of x."""
        z = _widths(x, self)
        with np.errstate(over="ignore"):  # exp(-inf) is the 0 it should be
            return np.exp(-z * z)

    def cut(self, level: float) -> tuple[float, float]:
        """The interval in which the membership is at least `level`."""
        reach = math.sqrt(-math.log(level))
        return self.center - reach * self.left, self.center + reach * self.right

    @classmethod
    def between(cls, before: float, peak: float, after: float) -> Gaussian:
        """Crosses its neighbours at a membership of 1/2."""
        half = 2.0 * math.sqrt(math.log(2.0))
        return cls(peak, (peak - before) / half, (after - peak) / half)


def _below_slopes(
    x: np.ndarray, left: float, top_left: float, top_right: float, right: float
) -> np.ndarray:
    """What lies under a rising slope, a falling one, and 1; a slope with no foot is not there."""
    y = 1.0
    with np.errstate(over="ignore"):  # a slope that overflows is below 0 or above 1
        if math.isfinite(left):
            rising = (x - left) / (top_left - left) if left < top_left else _step(x - left)
            y = np.minimum(rising, y)
        if math.isfinite(right):
            falling = (right - x) / (right - top_right) if top_right < right else _step(right - x)
            y = np.minimum(falling, y)
    return np.maximum(y, np.zeros_like(x))


def _step(x: np.ndarray) -> np.ndarray:
    """A vertical slope; NaN stays NaN."""
    return np.heaviside(x, 1.0)


def _foot(foot: float, top: float, level: float) -> float:
    """Where a slope reaches a level."""
    return foot + level * (top - foot) if math.isfinite(foot) else foot


def _widths(x: np.ndarray, kind: GeneralisedBell | Gaussian) -> np.ndarray:
    """Distance of x from the center, in widths of the side it is on; 0 on an open shoulder."""
    z = np.zeros_like(x)
    with np.errstate(over="ignore"):
        if math.isfinite(kind.left):
            z = z + np.maximum(kind.center - x, 0.0) / kind.left
        if math.isfinite(kind.right):
            z = z + np.maximum(x - kind.center, 0.0) / kind.right
    return z


def _check_rising(shape: Triangular | Trapezoidal) -> None:
    corners = dataclasses.asdict(shape)
    values = list(corners.values())
    if not all(a <= b for a, b in itertools.pairwise(values)):
        given = ", ".join(f"{value:g}" for value in values)
        raise OctarmError(
            f"the corners of {type(shape).__name__} are {given}; they must rise: "
            f"{' <= '.join(corners)}"
        )


def _check_finite(shape: Membership, *names: str) -> None:
    for name in names:
        if not math.isfinite(getattr(shape, name)):
            raise OctarmError(
                f"{name} of {type(shape).__name__} is {getattr(shape, name):g}; it must be finite"
            )


def _check_positive(shape: Membership, *names: str) -> None:
    for name in names:
        if not getattr(shape, name) > 0.0:
            raise OctarmError(
                f"{name} of {type(shape).__name__} is {getattr(shape, name):g}; it must be above 0"
            )
