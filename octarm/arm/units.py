"""Quantities of many numbers as files have them, each with its unit, in SI units and rad.

A quantity is a word, `"120 mm"` or `"120mm"`; a list of such words; or a table for many numbers of
one unit, `{ value = [1200, 1000, 800], unit = "N/m" }`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from octarm.formats import spelt

# The units of each kind of quantity with their sizes; the first one is that of the SI.
UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "mass": {"kg": 1.0, "g": 1e-3},
    "inertia": {"kg m^2": 1.0, "kg cm^2": 1e-4, "kg mm^2": 1e-6, "g m^2": 1e-3, "g mm^2": 1e-9},
    "stiffness": {"N/m": 1.0, "N/cm": 1e2, "N/mm": 1e3, "kN/m": 1e3},
    "bending stiffness": {"N m/rad": 1.0, "N mm/rad": 1e-3, "N m/deg": 180.0 / math.pi, "N m": 1.0},
    "damping": {"N s/m": 1.0, "N s/mm": 1e3, "kg/s": 1.0},
    "bending damping": {"N m s/rad": 1.0, "N mm s/rad": 1e-3, "N m s/deg": 180.0 / math.pi,
                        "N m s": 1.0},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3},
    "flexural rigidity": {"N m^2": 1.0, "N cm^2": 1e-4, "N mm^2": 1e-6},
    "mass per length": {"kg/m": 1.0, "g/m": 1e-3, "g/mm": 1.0, "g/cm": 0.1},
    "inertia per length": {"kg m": 1.0, "g m": 1e-3, "kg mm": 1e-3, "g mm": 1e-6},
}  # fmt: skip


_NUMBER = re.compile(r"\s*[-+]?(?:inf|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w.]*\d)")


def quantity(kind: str, given: Any) -> np.ndarray:
    """The numbers of a quantity in SI units, of any shape.

    Args:
        kind: of `UNITS`.
        given: what a file has.

    Raises:
        ValueError: what it must be, unless it is a quantity of this kind.
    """
    si = next(iter(UNITS[kind]))
    match given:
        case str():
            number = _NUMBER.match(given)
            if number is None or number.end() == len(given):
                raise ValueError(f'a number with a unit, such as "1 {si}"')
            return np.array(float(number[0])) * _size(given[number.end() :], kind)
        case {"value": value, "unit": str() as unit, **rest} if not rest:
            return _numbers(value) * _size(unit, kind)
        case dict():
            raise ValueError(f'a table such as {{ value = [1, 2], unit = "{si}" }}')
        case list() | tuple() if given:
            parts = [quantity(kind, part) for part in cast(Sequence[Any], given)]
            if len({part.shape for part in parts}) > 1:
                raise ValueError("a list of as many values in each row")
            return np.stack(parts)
        case bool() | int() | float():
            raise ValueError(f'given with a unit, such as "{spelt(given)} {si}"')
        case _:
            raise ValueError(f'a number with a unit, such as "1 {si}"')


def _numbers(value: Any) -> np.ndarray:
    """The numbers in a table's `value`, a number or lists of them."""
    rows: list[Any] = [value]
    while rows:
        part = rows.pop()
        if isinstance(part, list | tuple):
            rows += cast(Sequence[Any], part)
        elif isinstance(part, bool) or not isinstance(part, int | float):
            raise ValueError("a table whose value is a number, or a list of numbers")
    try:
        return _finite_or_inf(np.array(value, dtype=np.float64))
    except (ValueError, OverflowError):
        raise ValueError("a list of as many numbers in each row") from None


def _finite_or_inf(x: Any) -> np.ndarray:
    numbers = np.asarray(x, dtype=np.float64)
    if not numbers.size or np.isnan(numbers).any():
        raise ValueError("made of numbers")
    return numbers


def _size(unit: str, kind: str) -> float:
    units = UNITS[kind]
    known = {_closed_up(name): size for name, size in units.items()}
    if _closed_up(unit) not in known:
        *most, last = units
        raise ValueError(f"in {', '.join(most)} or {last}, which are the units of {kind}")
    return known[_closed_up(unit)]


def _closed_up(unit: str) -> str:
    """A unit without what people write differently: `N m`, `N*m` and `Nm` are one."""
    return re.sub(r"[\s·*]", "", unit.replace("²", "^2"))
