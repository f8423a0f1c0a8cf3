"""Numbers with units, as people write them: 40%, 100g, 15deg, 60ms, "1.5 mm"."""

from __future__ import annotations

import math
import re

from octarm.errors import OctarmError, quoted

ANY = "any unit"  # of a number whose unit is not known yet

# What may stand behind a number, by the unit that the program computes in.
_UNITS: dict[str, dict[str, float]] = {
    "1": {"%": 1e-2},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "kg": {"kg": 1.0, "g": 1e-3},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "N m": {"Nm": 1.0, "mNm": 1e-3},
    "N/s": {"N/s": 1.0, "kN/s": 1e3},
    "1/s": {"1/s": 1.0, "%/s": 1e-2},
}
_NUMBER = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(?!e)(\S.*?)\s*", re.IGNORECASE
)
_LETTERS = str.maketrans("%/1", "aaa")  # signs that units are made of, too


def number(name: str, text: str, unit: str) -> float:
    """The number that a text spells, in a unit such as "s" or "N or N m".

    Without a unit of its own the text is in that unit; with one, it is converted.

    Args:
        name: of the value, for the error.
        text: such as "0.06", "60ms" or "40 %".
        unit: that the program computes in; "1" for a ratio, or `ANY`.

    Raises:
        OctarmError: if the text is no number, or its unit is another quantity's.
    """
    try:
        return float(text)
    except ValueError:
        pass
    parts = _UNITS if unit == ANY else unit.split(" or ")
    known = {word: size for part in parts for word, size in _UNITS[part].items()}
    match = _NUMBER.fullmatch(text)
    if match is None or not match[2].translate(_LETTERS).isalpha():
        raise OctarmError(f"{name} is {quoted(text)}; it must be a number")
    if match[2] not in known:
        *others, last = known
        words = f"{', '.join(others)} or {last}" if others else last
        raise OctarmError(f"{name} is {quoted(text)}; its unit must be {words}")
    return float(match[1]) * known[match[2]]


def has_unit(text: str) -> bool:
    """Whether a text looks like a number with something behind it."""
    return _NUMBER.fullmatch(text) is not None
