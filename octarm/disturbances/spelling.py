"""Disturbances by name, as the command line and `run.json` spell them.

On the command line a disturbance is NAME:VALUE[,KEY=VALUE]*, such as `payload:0.2,at=3`.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np

from octarm.arrays import plain
from octarm.declared import BUILT_IN, Code, word_of
from octarm.disturbances.catalogue import DISTURBANCES as DISTURBANCES
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.fields import (
    Amount,
    Quantity,
    Words,
    field_defaults,
    field_keys,
    field_kinds,
)
from octarm.errors import OctarmError, closest, quoted
from octarm.units import number

_SEPARATOR = re.compile(r"/(?=[-+.\di])")  # between numbers; units hold a / before a letter


def parse_disturbance(text: str) -> Disturbance:
    """A disturbance from its spelling on the command line.

    VALUE is that of the first field; a field that may differ between coordinates takes one number
    for each of them as well, separated by `/`, as in `loss:0/0/0.5/0/0/0`. A number may have a
    unit, as in `payload:100g,at=500ms`.
    """
    word, rest = DISTURBANCES.split(text)
    cls = DISTURBANCES[word]
    name, keys = cls.name, field_keys(cls)
    values: dict[str, Any] = {}
    for i, item in enumerate(rest.split(",") if rest else []):
        key, equals, value = item.partition("=")
        if not equals and i > 0:
            raise OctarmError(f"{quoted(text)} has {quoted(item)}; it must read {_usage(cls)}")
        key, value = (key, value) if equals else (next(iter(keys)), item)
        if key not in keys:
            raise OctarmError(f"{name} has no key {quoted(key)}{closest(key, keys)}")
        if keys[key] in values:
            raise OctarmError(f"{quoted(text)} gives {key} twice")
        values[keys[key]] = _value(text, key, value, field_kinds(cls)[keys[key]])
    if not values or not field_kinds(cls).keys() <= values.keys() | field_defaults(cls).keys():
        raise OctarmError(f"{quoted(text)} is incomplete; it must read {_usage(cls)}")
    return cls(**values)


def spelling(disturbance: Disturbance) -> str:
    """The inverse of `parse_disturbance`, for one arm; without the fields that have their defaults.

    Numbers have 6 digits.
    """
    main, *_ = keys = field_keys(type(disturbance))
    defaults = field_defaults(type(disturbance))
    values = {key: getattr(disturbance, field) for key, field in keys.items()}
    parts = [
        f"{key}={_format(value)}"
        for key, value in values.items()
        if value is not None and (key == main or np.ndim(value) > 0 or value != defaults[keys[key]])
    ]
    return f"{disturbance.name}:{','.join(parts).removeprefix(f'{main}=')}"


def to_dict(disturbance: Disturbance) -> dict[str, Any]:
    """Name and fields as words, numbers and lists, ready for JSON; infinity as a word."""
    fields = {field: plain(getattr(disturbance, field)) for field in field_kinds(type(disturbance))}
    return {"name": disturbance.name, **fields}


def from_dict(description: Mapping[str, Any], code: Mapping[str, Code] = BUILT_IN) -> Disturbance:
    """The inverse of `to_dict`; `code` has those that are not built in, by name."""
    cls = DISTURBANCES[word_of(str(description.get("name")), code)]
    fields = {key: value for key, value in description.items() if key != "name"}
    known = field_kinds(cls)
    for key in fields:
        if key not in known:
            raise OctarmError(f"{cls.name} has no field {quoted(key)}{closest(key, known)}")
    for key in known:
        if key not in fields and key not in field_defaults(cls):
            raise OctarmError(f"{cls.name} needs the field {quoted(key)}")
    return cls(**fields)


def from_entry(entry: Mapping[str, Any], code: Mapping[str, Code] = BUILT_IN) -> Disturbance:
    """The disturbance of an entry of `run.json`, `{"name": "noise-2", "asked": {...}}`."""
    name = re.sub(r"-\d+$", "", str(entry["name"]))  # noise-2 is the second noise
    return from_dict({"name": name, **entry["asked"]}, code)


def help_text() -> str:
    """All disturbances by family: spelling, meaning and units, in lines of at most 80 columns."""
    sections: dict[str, list[str]] = {}
    for cls in map(DISTURBANCES.__getitem__, DISTURBANCES.names()):
        keys = zip(field_keys(cls), field_kinds(cls).values(), strict=True)
        units = [f"{key} [{kind.unit}]" for key, kind in keys if kind.unit not in ("", "1")]
        meaning = (cls.__doc__ or "").partition("\n")[0].rstrip(".:")
        text = f"{meaning}; {', '.join(units)}" if units else meaning
        lines = [f"  {_usage(cls)}", textwrap.indent(textwrap.fill(text, 74), " " * 6)]
        sections.setdefault(cls.family, [cls.family]).extend(lines)
    blocks = ["\n".join(lines) for lines in sections.values()]
    several = ", ".join(cls.name for cls in DISTURBANCES.values() if first_field(cls)[1].each)
    each = f"{several} take a number for each coordinate or column as well: 0/0/0.5/0/0/0"
    return "\n\n".join([*blocks, textwrap.fill(each, 80)])


def first_field(cls: type[Disturbance]) -> tuple[str, Quantity]:
    """The field of numbers that stands without a key, and varies when nothing else is said."""
    field, kind = next(iter(field_kinds(cls).items()))
    if not isinstance(kind, Quantity):
        raise OctarmError(f"{cls.name} begins with {field}, which is no number")
    return field, kind


def _usage(cls: type[Disturbance]) -> str:
    """The spelling with all keys that have a value: NAME:VALUE,KEY=default and so on."""
    main, *others = keys = field_keys(cls)
    parts = [f"{cls.name}:{main.upper()}"]
    for key in others:
        default = field_defaults(cls).get(keys[key], key.upper())
        parts += [f"{key}={_format(default)}"] if default is not None else []
    return ",".join(parts)


def _value(text: str, key: str, value: str, kind: Quantity | Words) -> Amount | str:
    if not isinstance(kind, Quantity):
        return value
    of = f"{key} of {quoted(text)}"
    numbers = [number(of, part, kind.unit) for part in _SEPARATOR.split(value)]
    if len(numbers) > 1 and not kind.each:
        raise OctarmError(f"{quoted(text)} gives {key} {len(numbers)} numbers; it takes one")
    return numbers[0] if len(numbers) == 1 else np.array(numbers)


def _format(value: Any) -> str:
    numbers = value.tolist() if isinstance(value, np.ndarray) else [value]
    return "/".join(x if isinstance(x, str) else f"{x:g}" for x in numbers)
