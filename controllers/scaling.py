"""Gains as numbers without a dimension, and their values in SI for an arm.

The unit that a gain is declared in says what it scales with: N with the nominal model's
`force_scale`, m or rad with its `scale`, s with its `time_scale`. So K_v [N s/m, N m s/rad] is a
number times force time / length of each coordinate, and the same number serves every arm that is
dynamically similar. This is the one place where numbers and SI values are turned into each other.
"""

from __future__ import annotations

import ast
import functools
import re
from typing import NamedTuple

import numpy as np

from octarm.errors import OctarmError, quoted
from octarm.interfaces import NominalModel


class GainScales(NamedTuple):
    """What gains are scaled by; an `octarm.interfaces.NominalModel` has the same.

    Attributes:
        scale: length of each coordinate, shape (..., 2N) [m], [rad].
        time_scale: time, shape () or (..., 1) [s].
        force_scale: force on each coordinate, shape (..., 2N) [N], [N m].
    """

    scale: np.ndarray
    time_scale: np.ndarray
    force_scale: np.ndarray


_UNITS = {  # exponents of force, length and time; an angle counts as a length
    "1": (0.0, 0.0, 0.0),
    "N": (1.0, 0.0, 0.0),
    "m": (0.0, 1.0, 0.0),
    "rad": (0.0, 1.0, 0.0),
    "s": (0.0, 0.0, 1.0),
    "kg": (1.0, -1.0, 2.0),
}


@functools.cache
def dimension_of(units: str) -> tuple[float, ...]:
    """Exponents of force, length and time in units such as "N s/m, N m s/rad", a slide's first.

    A product is spelt by spaces and slashes, from left to right, with powers such as s^2, brackets
    and sqrt(..). Raises OctarmError for another unit than N, m, rad, s, Hz, kg and 1, or
    another spelling.
    """
    text = units.partition(",")[0].strip().replace("Hz", "1/s").replace("^", "**")
    try:
        product = ast.parse(re.sub(r"(?<=[\w)]) +(?=[\w(])", "*", text), mode="eval")
        return tuple(_exponents(product.body).tolist())
    except (SyntaxError, ValueError):
        raise OctarmError(
            f"a gain has the units {quoted(units)}; they must be made of {', '.join(_UNITS)}, "
            'such as "N s/m, N m s/rad"'
        ) from None


def _exponents(product: ast.expr) -> np.ndarray:
    match product:
        case ast.BinOp(left, ast.Mult(), right):
            return _exponents(left) + _exponents(right)
        case ast.BinOp(left, ast.Div(), right):
            return _exponents(left) - _exponents(right)
        case ast.BinOp(base, ast.Pow(), ast.Constant(int(power))):
            return power * _exponents(base)
        case ast.Call(ast.Name("sqrt"), [root]):
            return 0.5 * _exponents(root)
        case ast.Name(word) | ast.Constant(1 as word) if str(word) in _UNITS:
            return np.array(_UNITS[str(word)])
        case _:
            raise ValueError


def unit(units: str, arm: GainScales | NominalModel) -> np.ndarray:
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
