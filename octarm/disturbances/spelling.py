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
from octarm.errors import OctarmError, closest, quoted
from octarm.fields import (
    Quantity,
    field_defaults,
    field_keys,
    field_kinds,
    help_entry,
    parsed_fields,
    spelt_value,
    usage_of,
)


def parse_disturbance(text: str) -> Disturbance:
    """A disturbance from its spelling on the command line.

    VALUE is that of the first field; a field that may differ between coordinates takes one number
    for each of them as well, separated by `/`, as in `loss:0/0/0.5/0/0/0`. A number may have a
    unit, as in `payload:100g,at=500ms`.
    """
    word, rest = DISTURBANCES.split(text)
    cls = DISTURBANCES[word]
    values: dict[str, Any] = parsed_fields(cls.name, text, rest, field_kinds(cls), _usage(cls))
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
        f"{key}={spelt_value(value)}"
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
        sections.setdefault(cls.family, [cls.family]).append(help_entry(_usage(cls), cls))
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
    return usage_of(cls.name, field_kinds(cls), field_defaults(cls))
