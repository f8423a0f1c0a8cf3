"""What the fields of a disturbance may be: numbers with units, and words."""

from __future__ import annotations

import dataclasses
import functools
import re
from typing import Any, ClassVar, get_type_hints

import numpy as np

from octarm.arrays import entry, read_only
from octarm.errors import OctarmError, closest, quoted

Amount = float | np.ndarray


@dataclasses.dataclass(frozen=True)
class Quantity:
    """What a field of numbers may be; used as `Annotated[Amount, Quantity(...)]`.

    Attributes:
        unit: for people; "1" for a ratio.
        at_least: smallest value allowed.
        above: a value below all that are allowed.
        at_most: largest value allowed.
        below: a value above all that are allowed.
        each: whether coordinates may have values of their own, on the last axis; otherwise only
            arms may.
        unbounded: whether infinity is allowed.
        key: how the command line and files spell the field; as the code does, when empty.
        usual: the values from which and to which it is varied when nothing else is said; the first
            one should do no harm.
    """

    unit: str
    at_least: float = -np.inf
    above: float = -np.inf
    at_most: float = np.inf
    below: float = np.inf
    each: bool = False
    unbounded: bool = False
    key: str = ""
    usual: tuple[float, float] | None = None

    def check(self, name: str, value: Any) -> Amount:
        """A float, or a read-only array of the shape of the value; `name` is for errors."""
        array = read_only(name, value, unbounded=self.unbounded)
        for bound, words, good in (
            (self.at_least, "at least", array >= self.at_least),
            (self.above, "above", array > self.above),
            (self.at_most, "at most", array <= self.at_most),
            (self.below, "below", (array < self.below) | (self.below == np.inf)),
        ):
            if not np.all(good):
                unit = "" if self.unit == "1" else f" {self.unit}"
                worst = array[~good].flat[0]
                spelt = f"; in degrees it is spelt {worst:g}deg" if self.unit == "rad" else ""
                raise OctarmError(
                    f"{name} is {worst:g}{unit}; it must be {words} {bound:g}{unit}{spelt}"
                )
        return entry(array)


PHASE = Quantity("rad", at_least=-2.0 * np.pi, at_most=2.0 * np.pi)


@dataclasses.dataclass(frozen=True)
class Words:
    """What a field of words may be: one of `alone`, or several words joined by `+`.

    Attributes:
        joined: words that may be joined.
        alone: words that stand alone.
        coordinates: whether names of coordinates, such as `theta1`, may be joined as well. Which
            there are depends on the arm: `Episode.selected` checks them.
    """

    joined: tuple[str, ...] = ()
    alone: tuple[str, ...] = ()
    coordinates: bool = False
    unit: ClassVar[str] = ""
    key: ClassVar[str] = ""

    def check(self, name: str, value: Any) -> str:
        """The words as they are, if they are known and given once; `name` is for errors."""
        words = str(value).split("+")
        for word in words if value not in self.alone else []:
            coordinate = self.coordinates and re.fullmatch(r"[a-z_]+[1-9]\d*", word)
            if not (coordinate or word in self.joined):
                known = closest(word, (*self.joined, *self.alone))
                names = " and the names of coordinates" if self.coordinates else ""
                raise OctarmError(f"{name} is {quoted(value)}{known}{names}")
            if words.count(word) > 1:
                raise OctarmError(f"{name} is {quoted(value)}; it must name {word} once")
        return str(value)


@functools.cache
def field_kinds(cls: type) -> dict[str, Quantity | Words]:
    """What the fields of a disturbance may be, by name, in their order."""
    hints = get_type_hints(cls, include_extras=True)
    return {f.name: hints[f.name].__metadata__[0] for f in dataclasses.fields(cls)}  # pyright: ignore


@functools.cache
def field_defaults(cls: type) -> dict[str, Any]:
    """The defaults of the fields that need not be given, by name."""
    fields = dataclasses.fields(cls)  # pyright: ignore
    return {f.name: f.default for f in fields if f.default is not dataclasses.MISSING}


@functools.cache
def field_keys(cls: type) -> dict[str, str]:
    """The names of the fields, by how the command line and files spell them."""
    return {kind.key or name: name for name, kind in field_kinds(cls).items()}
