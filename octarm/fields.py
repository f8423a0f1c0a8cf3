"""The fields that disturbances and references declare: numbers with units, words, and files.

On the command line and in specs they stand behind a name, `payload:0.2,at=3` or
`sine:amplitude=20deg,frequency=1`; the first one may go without its key.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import textwrap
from collections.abc import Mapping
from typing import Any, ClassVar, get_type_hints

import numpy as np

from octarm.arrays import entry, read_only
from octarm.errors import OctarmError, closest, quoted
from octarm.units import Range

Amount = float | np.ndarray
_SEPARATOR = re.compile(r"/(?=[-+.\di])")  # between numbers; units hold a / before a letter
_NEXT_KEY = re.compile(r",(?=[a-z][a-z0-9-]*=)")  # behind a file, in whose name a comma may stand


@dataclasses.dataclass(frozen=True)
class Quantity(Range):
    """What a field of numbers may be; used as `Annotated[Amount, Quantity(...)]`.

    Attributes:
        each: whether coordinates may have values of their own, on the last axis; otherwise only
            arms may.
        unbounded: whether infinity is allowed.
        key: how the command line and files spell the field; as the code does, when empty.
        usual: the values from which and to which it is varied when nothing else is said; the first
            one should do no harm.
    """

    each: bool = False
    unbounded: bool = False
    key: str = ""
    usual: tuple[float, float] | None = None

    def check(self, name: str, value: Any) -> Amount:
        """A float, or a read-only array of the shape of the value; `name` is for errors."""
        array = read_only(name, value, unbounded=self.unbounded)
        if not np.all(good := self.allows(array)):
            self.check_bounds(name, array[~good].flat[0].item())
        return entry(array)


PHASE = Quantity("rad", at_least=-2.0 * np.pi, at_most=2.0 * np.pi)


@dataclasses.dataclass(frozen=True)
class Words:
    """What a field of words may be: one of `alone`, or several words joined by `+`.

    Attributes:
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


@dataclasses.dataclass(frozen=True)
class FileName:
    """What a field may be that names a file: its path, in which a comma may stand."""

    unit: ClassVar[str] = ""
    key: ClassVar[str] = ""

    def check(self, name: str, value: Any) -> str:
        """The path as it is, unless it is empty; `name` is for errors."""
        if not value:
            raise OctarmError(f"{name} is {quoted(value)}; it must be the name of a file")
        return str(value)


@functools.cache
def field_kinds(cls: type) -> dict[str, Any]:
    """What the fields of a dataclass may be, by name, in their order; those that declare it."""
    hints = get_type_hints(cls, include_extras=True)
    declared = {
        field.name: next(iter(getattr(hints[field.name], "__metadata__", ())), None)
        for field in dataclasses.fields(cls)  # pyright: ignore
    }
    kinds = Quantity | Words | FileName
    return {name: kind for name, kind in declared.items() if isinstance(kind, kinds)}


@functools.cache
def field_defaults(cls: type) -> dict[str, Any]:
    """The defaults of the fields that need not be given, by name."""
    fields = dataclasses.fields(cls)  # pyright: ignore
    return {f.name: f.default for f in fields if f.default is not dataclasses.MISSING}


@functools.cache
def field_keys(cls: type) -> dict[str, str]:
    """The names of the fields, by how the command line and files spell them."""
    return {kind.key or name: name for name, kind in field_kinds(cls).items()}


def parsed_fields(
    name: str, whole: str, text: str, kinds: Mapping[str, Any], usage: str
) -> dict[str, Amount | str]:
    """Fields by name from their spelling VALUE,KEY=VALUE.. behind the name of a thing.

    VALUE is that of the first field; a field that takes several numbers has them separated by `/`,
    as in `loss:0/0/0.5/0/0/0`, as an array of shape (k,). A number may have a unit, as in `100g`.

    The `whole` spelling has the name and the text, if there is any, behind it; `kinds` are those of
    the fields by name, and `usage` says in errors how all of it must read. Raises OctarmError for
    an unknown key, one that is given twice, or a value of another kind.
    """
    keys = {kind.key or field: field for field, kind in kinds.items()}
    whole = quoted(whole)
    first = next(iter(keys), "")
    in_file = isinstance(kinds.get(keys.get(first, "")), FileName)
    items = _NEXT_KEY.split(text) if in_file else text.split(",")
    values: dict[str, Amount | str] = {}
    for i, item in enumerate(items if text else []):
        key, equals, value = item.partition("=")
        key = key.strip() if equals else key
        if i == 0 and (in_file or not equals):
            key, value = first, item
        elif not equals:
            raise OctarmError(f"{whole} has {quoted(item)}; it must read {usage}")
        if not keys:
            raise OctarmError(f"{name} has no parameters; it is given {quoted(item)}")
        if key not in keys:
            raise OctarmError(f"{name} has no key {quoted(key)}{closest(key, keys)}")
        if keys[key] in values:
            raise OctarmError(f"{whole} gives {key} twice")
        values[keys[key]] = _value(whole, key, value, kinds[keys[key]])
    return values


def _value(whole: str, key: str, value: str, kind: Any) -> Amount | str:
    if not isinstance(kind, Quantity):
        return value
    numbers = [kind.parse(f"{key} of {whole}", part) for part in _SEPARATOR.split(value)]
    if len(numbers) > 1 and not kind.each:
        raise OctarmError(f"{whole} gives {key} {len(numbers)} numbers; it takes one")
    return numbers[0] if len(numbers) == 1 else np.array(numbers)


def usage_of(name: str, kinds: Mapping[str, Any], values: Mapping[str, Any]) -> str:
    """The spelling with all keys that have a value: NAME:VALUE,KEY=default and so on.

    The default of a field, by name, is None where it mostly stands without a value.
    """
    keys = [(kind.key or field, field) for field, kind in kinds.items()]
    parts = [keys[0][0].upper()] if keys else []
    for key, field in keys[1:]:
        default = values.get(field, key.upper())
        parts += [f"{key}={spelt_value(default)}"] if default is not None else []
    return ":".join([name, *([",".join(parts)] if parts else [])])


def spelt_value(value: Any) -> str:
    """A word, a number or an array of shape (k,), as the command line spells it, to 6 digits."""
    numbers = value.tolist() if isinstance(value, np.ndarray) else [value]
    return "/".join(x if isinstance(x, str) else f"{x:g}" for x in numbers)


def help_entry(usage: str, cls: type) -> str:
    """The lines of a help page on a dataclass of fields: its spelling, meaning and units."""
    kinds = field_kinds(cls).items()
    units = [f"{k.key or f} [{k.unit}]" for f, k in kinds if k.unit not in ("", "1")]
    meaning = (cls.__doc__ or "").partition("\n")[0].rstrip(".:")
    text = f"{meaning}; {', '.join(units)}" if units else meaning
    return f"  {usage}\n" + textwrap.indent(textwrap.fill(text, 74), " " * 6)
