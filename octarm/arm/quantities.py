"""Quantities as the files of arms have them, each with its unit.

A quantity is a word, `"120 mm"` or `"120mm"`; a list of such words; or a table for many numbers of
one unit, `{ value = [1200, 1000, 800], unit = "N/m" }`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from octarm.formats import spelt
from octarm.units import NUMBER, UNITS, closed_up


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
            number = NUMBER.match(given)
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
    known = {closed_up(name): size for name, size in units.items()}
    if closed_up(unit) not in known:
        *most, last = units
        raise ValueError(f"in {', '.join(most)} or {last}, which are the units of {kind}")
    return known[closed_up(unit)]
