"""A disturbance of which one number varies, as the margin of a controller is sought of it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import DISTURBANCES, first_field, parse_disturbance
from octarm.errors import OctarmError, closest, quoted
from octarm.units import MISMATCH

NOMINAL = "nominal-mismatch"  # of the controller's model, as --mismatch of octarm run
_NOMINAL_RANGE = (0.0, 3.0)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Varied:
    """What varies: a disturbance by its first field, or `nominal-mismatch`.

    Attributes:
        low: value at which the bound should be met; need not be the smaller one.
        high: value up to which it is tried.
        disturbance: the one whose first field varies; None for `nominal-mismatch`.
    """

    name: str
    low: float
    high: float
    unit: str = "1"
    disturbance: Disturbance | None = None

    def at(self, share: np.ndarray | float) -> np.ndarray:
        """The values at shares of the way from low to high, shape (...); infinity stays so."""
        way = np.asarray(share)
        return np.where(np.isfinite(way), self.low + way * (self.high - self.low), way)

    def of(self, values: np.ndarray) -> list[Disturbance]:
        """The disturbance with a value an arm, shape (n,), if it is one."""
        if self.disturbance is None:
            return []
        field, kind = first_field(type(self.disturbance))
        each = values[:, None] if kind.each else values
        return [dataclasses.replace(self.disturbance, **{field: each})]  # pyright: ignore


def is_varied(text: str) -> bool:
    """Whether a disturbance is spelt without its value, NAME or NAME:KEY=VALUE,.."""
    first = DISTURBANCES.split(text).rest.partition(",")[0]
    return not first or "=" in first


def parse_varied(text: str, low: float | str | None, high: float | str | None) -> Varied:
    """What varies, from NAME or NAME:KEY=VALUE,..; `low` and `high` are usual ones when None.

    Texts are numbers with a unit, such as "60ms". Raises OctarmError for what is unknown or not
    allowed.
    """
    name, _, rest = text.partition(":")
    if name != NOMINAL:
        name, rest = DISTURBANCES.split(text)
    if ":" not in name and name not in (NOMINAL, *(known := DISTURBANCES.names())):
        raise OctarmError(f"unknown disturbance {quoted(name)}{closest(name, (NOMINAL, *known))}")
    usual = usual_range(name)
    if usual is None and None in (low, high):
        raise OctarmError(f"{name} has no usual range; give --low, a value to bear, and --high")
    field, kind = ("", MISMATCH) if name == NOMINAL else first_field(DISTURBANCES[name])
    low, high = (
        kind.parse(end, given) if isinstance(given, str) else default if given is None else given
        for end, given, default in zip(
            ("low", "high"), (low, high), usual or (math.nan, math.nan), strict=True
        )
    )
    if not (math.isfinite(low) and math.isfinite(high) and low != high):
        raise OctarmError(f"low is {low:g} and high {high:g}; they must be two finite numbers")
    if name == NOMINAL:
        if rest:
            raise OctarmError(f"{NOMINAL} has no keys; {quoted(rest)} is given")
        for value in (low, high):
            MISMATCH.check_bounds("mismatch", value)
        return Varied(name=name, low=low, high=high)
    at_low, _ = (parse_disturbance(text, **{field: value}) for value in (low, high))
    return Varied(name=at_low.name, low=low, high=high, unit=kind.unit, disturbance=at_low)


def usual_range(name: str) -> tuple[float, float] | None:
    """Where the search begins and ends when it is not said, in the unit of the values."""
    return _NOMINAL_RANGE if name == NOMINAL else first_field(DISTURBANCES[name])[1].usual
