"""Numbers with units, as people write them: 40%, 100g, 15deg, 60ms, "1.5 mm"."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Any

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
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "rate of bend": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.pi / 180.0},
    "rate of torque": {"N m/s": 1.0, "N mm/s": 1e-3},
    "flexural rigidity": {"N m^2": 1.0, "N cm^2": 1e-4, "N mm^2": 1e-6},
    "mass per length": {"kg/m": 1.0, "g/m": 1e-3, "g/mm": 1.0, "g/cm": 0.1},
    "inertia per length": {"kg m": 1.0, "g m": 1e-3, "kg mm": 1e-3, "g mm": 1e-6},
}  # fmt: skip


ANY = "any unit"  # of a number whose unit is not known yet

NUMBER = re.compile(r"\s*[-+]?(?:inf|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w.]*\d|[eE])")
_LETTERS = str.maketrans("%/1^2()", "aaaaaaa")  # signs that units are made of, too
_SIGNS = str.maketrans({"²": "^2", "°": "deg", "µ": "u", "μ": "u"})
# Units that are meant where a number of the SI would be far too large.
_SMALLER = {"1": "%", "kg": "g", "m": "mm", "s": "ms", "rad": "deg", "1/s": "%/s"}


def is_like_a_number(text: str) -> bool:
    """Whether a text begins as a number does, with a unit behind it or not."""
    return NUMBER.match(text) is not None or text.strip().casefold() == "nan"


def is_bare(text: str) -> bool:
    """Whether a text is a number without a unit."""
    with contextlib.suppress(ValueError):
        return not math.isnan(float(text))
    return False


def number(name: str, text: str, unit: str) -> float:
    """The number that a text such as "0.06", "60ms" or "40 %" spells, in some unit.

    Without a unit of its own the text is in that unit, or those such as "N or N m"; with one, it is
    converted. The unit is "1" for a share, or `ANY`. Raises OctarmError if the text is no number,
    or its unit is another quantity's.
    """
    return _read(name, text, unit)[0]


def _read(name: str, text: str, unit: str) -> tuple[float, str, float]:
    """The number that a text spells, its unit, empty if it has none, and the size of this unit."""
    try:
        return float(text), "", 1.0
    except ValueError:
        pass
    match = NUMBER.match(text)
    typed = text[match.end() :] if match is not None else ""
    if match is None or not closed_up(typed).translate(_LETTERS).isalpha():
        raise OctarmError(f"{name} is {quoted(text)}; it must be a number")
    known = _sizes(unit)
    sizes = {closed_up(word): size for word, size in known.items()}
    if closed_up(typed) not in sizes:
        *others, last = known or (f"that of {unit}",)
        words = f"{', '.join(others)} or {last}" if others else last
        raise OctarmError(f"{name} is {quoted(text)}; its unit must be {words}")
    size = sizes[closed_up(typed)]
    return float(match[0]) * size, typed.rstrip(), size


def _sizes(unit: str) -> dict[str, float]:
    """The sizes of all units in which a number may be that is in some unit of the program."""
    parts = unit.split(" or ")
    tables = [units for units in UNITS.values() if unit == ANY or next(iter(units)) in parts]
    known = {word: size for units in tables for word, size in units.items()}
    known |= {part: 1.0 for part in parts if part not in (ANY, "")}  # nobody spells it otherwise
    known.pop("1", None)
    return known


def closed_up(unit: str) -> str:
    """A unit without what people write differently: `N m`, `N*m` and `Nm` are one."""
    return re.sub(r"^/", "1/", re.sub(r"[\s·*]", "", unit.translate(_SIGNS)))


@dataclasses.dataclass(frozen=True)
class Range:
    """What a number may be: at least, above, at most or below others, in a unit; "1" for a ratio.

    Attributes:
        plausible: size beyond which a number is taken for one in another unit where it is typed
            without its unit; with its unit, as in `100kg`, it is meant.
    """

    unit: str
    at_least: float = -math.inf
    above: float = -math.inf
    at_most: float = math.inf
    below: float = math.inf
    plausible: float = math.inf

    def parse(self, name: str, text: str) -> float:
        """The number that a text spells, see `number`; `name` is for errors.

        Raises OctarmError if it is none, is not plausible, or has a unit and is not allowed.
        """
        value, typed, size = _read(name, text, self.unit)
        if typed:
            self.check_bounds(name, value, text.strip(), typed, size)
        else:
            self.check_plausible(name, value)
        return value

    def check_plausible(self, name: str, value: float) -> None:
        """Raises OctarmError for a number without a unit that is allowed, but not plausible."""
        if not self.plausible < abs(value) < math.inf or not self.allows(value):
            return
        unit, si = self._with_space(), closed_up(self.unit.partition(" or ")[0]).removeprefix("1")
        most = f"at most {self.plausible:g}" if value > 0.0 else f"at least {-self.plausible:g}"
        exact = f"{value:g}{si}" if si else f"{100.0 * value:g}%"
        raise OctarmError(
            f"{name} is {value:g}{unit}; it must be {most}{unit} unless it is spelt {exact}"
            f"{self.meant(value)}"
        )

    def allows(self, value: Any) -> Any:
        """Whether a number, or each of an array, is within the bounds; a bool, or of its shape."""
        good = (value >= self.at_least) & (value > self.above) & (value <= self.at_most)
        return good & ((value < self.below) | (self.below == math.inf))

    def check_bounds(
        self, name: str, value: float, text: str = "", unit: str = "", size: float = 1.0
    ) -> None:
        """Raises OctarmError for a number that is not allowed, spelt as it was typed.

        That is a text with a unit of some size, both empty for a number of the program.
        """
        si, meant = self._with_space(), "" if text else self.meant(value)
        for bound, words, good in (
            (self.at_least, "at least", value >= self.at_least),
            (self.above, "above", value > self.above),
            (self.at_most, "at most", value <= self.at_most),
            (self.below, "below", value < self.below or self.below == math.inf),
        ):
            if not good and abs(bound) < math.inf:
                limit = f"{bound / size:g}{unit}" if text and bound else f"{bound:g}{si}"
                typed = text or f"{value:g}{si}"
                raise OctarmError(f"{name} is {typed}; it must be {words} {limit}{meant}")

    def meant(self, value: float) -> str:
        """The end of a sentence: the same number in a smaller unit, if it is allowed in that."""
        smaller = _SMALLER.get(self.unit, "")
        converted = value * _sizes(self.unit).get(smaller, math.inf)
        if not self.allows(converted) or abs(converted) > min(self.plausible, 1e300):
            return ""
        if self.unit == "rad":
            return f"; in degrees it is spelt {value:g}deg"
        return f", did you mean {value:g}{smaller}?"

    def _with_space(self) -> str:
        return "" if self.unit == "1" else f" {self.unit}"


# What the command line and specs take as well as Python: the error of a model in all parameters,
# a share, and a control period.
MISMATCH = Range("1", above=-1.0, at_most=1e6, plausible=10.0)
SHARE = Range("1", above=0.0, at_most=1.0)
PERIOD = Range("s", at_most=10.0, plausible=0.5)
