"""What the fields of a disturbance may be: numbers with units, and words."""

from __future__ import annotations

import dataclasses
import re
from typing import Any, ClassVar

import numpy as np

from octarm.arrays import entry, read_only
from octarm.errors import OctarmError, closest

Amount = float | np.ndarray


@dataclasses.dataclass(frozen=True)
class Quantity:
    """What a field of a disturbance may be; used as `Annotated[Amount, Quantity(...)]`.

    Attributes:
        unit: for people; "1" for a ratio.
        at_least: smallest value allowed.
        above: a value below all that are allowed.
        at_most: largest value allowed.
        below: a value above all that are allowed.
        each: whether coordinates may have values of their own, on the last axis; otherwise only
            arms may.
        unbounded: whether infinity is allowed.
        key: how the command line spells the field; as the code does, when empty.
        usual: the values from which and to which it is varied when nothing else is said.
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
        """A float, or a read-only array of the shape of the value.

        Raises:
            ValueError: if it is not made of finite numbers in the range; `name` says whose it is.
        """
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
                raise OctarmError(f"{name} is {worst:g}{unit}; it must be {words} {bound:g}{unit}")
        return entry(array)


@dataclasses.dataclass(frozen=True)
class Words:
    """What a field of words may be: one of `alone`, or several of `joined`, joined by `+`.

    Attributes:
        joined: the words, or examples of them.
        alone: words that stand alone.
        pattern: regular expression of the words that may be joined; those of `joined` when empty.
    """

    joined: tuple[str, ...]
    alone: tuple[str, ...] = ()
    pattern: str = ""
    unit: ClassVar[str] = ""
    key: ClassVar[str] = ""

    def check(self, name: str, value: Any) -> str:
        """The words as they are.

        Raises:
            ValueError: if one of them is unknown; `name` says whose they are.
        """
        allowed = self.pattern or "|".join(map(re.escape, self.joined))
        words = str(value).split("+")
        for word in words if value not in self.alone else []:
            if not re.fullmatch(allowed, word):
                known = closest(word, (*self.joined, *self.alone))
                raise OctarmError(f"{name} is {value!r}{known}")
            if words.count(word) > 1:
                raise OctarmError(f"{name} is {value!r}; it must name {word} once")
        return str(value)
