"""Gains as numbers without a dimension, and their values in SI for an arm.

The unit that a gain is declared in says what it scales with: N with the nominal model's
`force_scale`, m or rad with its `scale`, s with its `time_scale`. So K_v [N s/m, N m s/rad] is a
number times force time / length of each coordinate, and the same number serves every arm that is
dynamically similar. This is the one place where numbers and SI values are turned into each other.
"""

from __future__ import annotations

import functools
import re
from typing import NamedTuple, Protocol

import numpy as np

from octarm.errors import OctarmError, quoted


class Scales(Protocol):
    """What gains are scaled by; an `octarm.interfaces.NominalModel` is one."""

    @property
    def scale(self) -> np.ndarray:
        """Length of each coordinate, shape (..., 2N) [m], [rad]."""
        ...

    @property
    def time_scale(self) -> np.ndarray:
        """Time, shape () or (..., 1) [s]."""
        ...

    @property
    def force_scale(self) -> np.ndarray:
        """Force on each coordinate, shape (..., 2N) [N], [N m]."""
        ...


class Dimension(NamedTuple):
    """Exponents of force, length and time, multiples of 1/2; an angle counts as a length."""

    force: float = 0.0
    length: float = 0.0
    time: float = 0.0

    def power(self, exponent: float) -> Dimension:
        """The dimension of a quantity to a power."""
        return Dimension(*(exponent * x for x in self))

    def times(self, other: Dimension) -> Dimension:
        """The dimension of a product."""
        return Dimension(*(x + y for x, y in zip(self, other, strict=True)))


_UNITS = {
    "1": Dimension(),
    "N": Dimension(force=1.0),
    "m": Dimension(length=1.0),
    "rad": Dimension(length=1.0),
    "s": Dimension(time=1.0),
    "kg": Dimension(force=1.0, length=-1.0, time=2.0),
}


@functools.cache
def dimension_of(units: str) -> Dimension:
    """What a gain's units say, such as "N s/m, N m s/rad": those of a slide come first.

    A product is spelt by spaces and slashes, from left to right, with powers such as s^2, brackets
    and sqrt(..). Raises OctarmError for another unit than N, m, rad, s, Hz, kg and 1, or
    another spelling.
    """
    words = re.findall(r"[A-Za-z]+|\d+|\S", units.partition(",")[0].replace("Hz", "1/s"))
    dimension = _product(words, units)
    if words:
        raise _unreadable(units)
    return dimension


def _product(words: list[str], units: str) -> Dimension:
    dimension, exponent = Dimension(), 1.0
    while words and words[0] != ")":
        if words[0] == "/":
            words.pop(0)
            exponent = -1.0
            continue
        dimension = dimension.times(_factor(words, units).power(exponent))
        exponent = 1.0
    return dimension


def _factor(words: list[str], units: str) -> Dimension:
    """Takes a unit, a bracket or a root off the words, and its power."""
    word = words.pop(0)
    if word in ("(", "sqrt") and words:
        if word == "sqrt":
            words.pop(0)
        dimension = _product(words, units).power(0.5 if word == "sqrt" else 1.0)
        if not words or words.pop(0) != ")":
            raise _unreadable(units)
    elif word in _UNITS:
        dimension = _UNITS[word]
    else:
        raise _unreadable(units)
    if words and words[0] == "^":
        if len(words) < 2 or not words[1].isdigit():
            raise _unreadable(units)
        dimension = dimension.power(float(words[1]))
        del words[:2]
    return dimension


def _unreadable(units: str) -> OctarmError:
    return OctarmError(
        f"a gain has the units {quoted(units)}; they must be made of {', '.join(_UNITS)}, such as "
        '"N s/m, N m s/rad"'
    )


def unit(units: str, arm: Scales) -> np.ndarray:
    """The value of 1 in SI, shape () where at most time counts, for one arm, else (..., 2N).

    Of a batch where only time counts it has the shape (..., 1). Raises OctarmError if the units
    cannot be read, or the arm has no scales.
    """
    force, length, time = dimension_of(units)
    value = np.ones(())
    value = value * _power(arm.force_scale, force) if force else value
    value = value * _power(arm.scale, length) if length else value
    return value * _power(arm.time_scale, time) if time else value


def _power(x: np.ndarray, exponent: float) -> np.ndarray:
    """x to a multiple of 1/2, by products and roots, whose bits are the same for any batch."""
    root, count = (np.sqrt(x), 2.0 * exponent) if exponent % 1.0 else (x, exponent)
    value = np.ones(())
    for _ in range(round(abs(count))):
        value = value * root
    return 1.0 / value if exponent < 0.0 else value


def along(numbers: np.ndarray, modules: int, coordinates: int) -> np.ndarray:
    """Numbers of the coordinates of one arm, for an arm with more or fewer modules.

    A list in the order of q of M modules, shape (..., kinds M), becomes one of N, (..., kinds N):
    each kind of coordinate is interpolated along the arm, with module i of M at (i - 1/2) / M of
    its length, and constant at both ends. So two numbers are one for each slide and one for each
    bend. One number, shape () or (..., 1), stays one.
    """
    kinds = coordinates // modules
    size = numbers.shape[-1] if numbers.ndim else 1
    if size in (1, coordinates) or size % kinds:  # what does not fit is refused as a gain
        return numbers
    given = np.reshape(numbers, (*numbers.shape[:-1], kinds, size // kinds))
    place = (np.arange(modules) + 0.5) / modules * (size // kinds) - 0.5
    place = np.clip(place, 0.0, size // kinds - 1.0)
    below = np.minimum(place.astype(int), max(size // kinds - 2, 0))
    above = np.minimum(below + 1, size // kinds - 1)
    share = place - below
    spread = (1.0 - share) * given[..., below] + share * given[..., above]
    return np.reshape(spread, (*numbers.shape[:-1], coordinates))
