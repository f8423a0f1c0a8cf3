"""Numbers with units, as people write them: 40%, 100g, 15deg, 60ms, "1.5 mm"."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from octarm.errors import OctarmError, quoted

# The units of each kind of quantity with their sizes; the first one is that of the SI.
UNITS: Mapping[str, Mapping[str, float]] = {
    "percentage": {"%": 1.0},  # before shares, which a % of any unit means
    "share": {"1": 1.0, "%": 1e-2},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0},
    "mass": {"kg": 1.0, "g": 1e-3},
    "inertia": {"kg m^2": 1.0, "kg cm^2": 1e-4, "kg mm^2": 1e-6, "g m^2": 1e-3, "g mm^2": 1e-9},
    "stiffness": {"N/m": 1.0, "N/cm": 1e2, "N/mm": 1e3, "kN/m": 1e3},
    "bending stiffness": {"N m/rad": 1.0, "N mm/rad": 1e-3, "N m/deg": 180.0 / math.pi, "N m": 1.0},
    "damping": {"N s/m": 1.0, "N s/mm": 1e3, "kg/s": 1.0},
    "bending damping": {"N m s/rad": 1.0, "N mm s/rad": 1e-3, "N m s/deg": 180.0 / math.pi,
                        "N m s": 1.0},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "torque": {"N m": 1.0, "N mm": 1e-3},
    "rate of force": {"N/s": 1.0, "kN/s": 1e3},
    "energy": {"J": 1.0, "mJ": 1e-3},
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
    "rate": {"1/s": 1.0, "%/s": 1e-2},
    "flexural rigidity": {"N m^2": 1.0, "N cm^2": 1e-4, "N mm^2": 1e-6},
    "mass per length": {"kg/m": 1.0, "g/m": 1e-3, "g/mm": 1.0, "g/cm": 0.1},
    "inertia per length": {"kg m": 1.0, "g m": 1e-3, "kg mm": 1e-3, "g mm": 1e-6},
}  # fmt: skip


ANY = "any unit"  # of a number whose unit is not known yet

NUMBER = re.compile(r"\s*[-+]?(?:inf|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w.]*\d|[eE])")
_LETTERS = str.maketrans("%/1^2", "aaaaa")  # signs that units are made of, too


def number(name: str, text: str, unit: str) -> float:
    """The number that a text such as "0.06", "60ms" or "40 %" spells, in some unit.

    Without a unit of its own the text is in that unit, or those such as "N or N m"; with one, it is
    converted. The unit is "1" for a share, or `ANY`. Raises OctarmError if the text is no number,
    or its unit is another quantity's.
    """
    try:
        return float(text)
    except ValueError:
        pass
    match = NUMBER.match(text)
    given = closed_up(text[match.end() :]) if match is not None else ""
    if match is None or not given.translate(_LETTERS).isalpha():
        raise OctarmError(f"{name} is {quoted(text)}; it must be a number")
    parts = unit.split(" or ")
    tables = [units for units in UNITS.values() if unit == ANY or next(iter(units)) in parts]
    known = {word: size for units in tables for word, size in units.items() if word != "1"}
    sizes = {closed_up(word): size for word, size in known.items()}
    if not sizes:  # a unit that nobody spells otherwise
        raise OctarmError(f"{name} is {quoted(text)}; it must be a number [{unit}]")
    if given not in sizes:
        *others, last = known
        words = f"{', '.join(others)} or {last}" if others else last
        raise OctarmError(f"{name} is {quoted(text)}; its unit must be {words}")
    return float(match[0]) * sizes[given]


def closed_up(unit: str) -> str:
    """A unit without what people write differently: `N m`, `N*m` and `Nm` are one."""
    return re.sub(r"[\s·*]", "", unit.replace("²", "^2"))
