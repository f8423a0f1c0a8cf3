"""All disturbances by name, and how files and the command line spell them.

On the command line a disturbance is NAME:VALUE[,KEY=VALUE]*, such as `payload:0.2,at=3`. One of
your own needs no line here: it is given as MODULE:NAME or FILE.py:NAME, see `octarm.declared`.
Commands, specs, `run.json`, the ledger and the recordings then know it by its name and its fields.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np

from octarm.arrays import plain
from octarm.declared import BUILT_IN, Code, Declared, lacking, word_of
from octarm.disturbances import actuators, forces, plant, sensors
from octarm.disturbances.episode import ActuatorFault, Disturbance, Force, PlantChange, SensorFault
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

_FAMILIES = (Force, PlantChange, ActuatorFault, SensorFault)
_NAME = re.compile(r"(?!.*-\d+$)[a-z][a-z0-9-]*")  # -2 is put behind the second one's
_SEPARATOR = re.compile(r"/(?=[-+.\di])")  # between numbers; units hold a / before a letter


def _lacks(thing: Any) -> str:
    """What a class of a user lacks of a disturbance; empty if nothing."""
    if not (isinstance(thing, type) and issubclass(thing, _FAMILIES)):
        return f"is no {', '.join(f.__name__ for f in _FAMILIES)} of octarm.disturbances.episode"
    if misses := lacking(thing, start=["episode"]):
        return misses
    name: Any = getattr(thing, "name", None)
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        return f"has the name {quoted(name)}; it must be lower-case letters, digits and hyphens"
    if name in _BUILT_IN:
        return f"has the name {name}, which is that of a built-in one"
    params = vars(thing).get("__dataclass_params__")
    if params is None or not params.frozen:
        return "is no frozen dataclass"
    try:
        kinds = [*field_kinds(thing).values()]
    except (AttributeError, NameError, TypeError):
        kinds = []
    if not kinds or not isinstance(kinds[0], Quantity) or not _are_kinds(kinds):
        return "needs fields annotated with Quantity or Words, and a Quantity first"
    return ""


def _are_kinds(kinds: list[Any]) -> bool:
    return all(isinstance(kind, Quantity | Words) for kind in kinds)


def _declares(thing: type[Disturbance]) -> dict[str, dict[str, Any]]:
    kinds = field_kinds(thing)
    return {
        key: {"field": name, "unit": kinds[name].unit, "number": isinstance(kinds[name], Quantity)}
        for key, name in field_keys(thing).items()
    }


# In the order in which those of one family act, whatever the order in which they are listed. Those
# that are not built in act after them, as listed.
_BUILT_IN: dict[str, type[Disturbance]] = {
    cls.name: cls
    for cls in (
        forces.BandLimitedNoise,
        forces.SineForce,
        forces.PulseForce,
        forces.StepForce,
        plant.Mismatch,  # parameters of the bare arm, before it is loaded
        plant.RandomMismatch,
        plant.Drift,
        plant.CyclicDrift,
        plant.Payload,
        plant.GravityTilt,
        actuators.ActuationDelay,  # from the controller to the plate: a line, a valve, a column
        actuators.DeadZone,
        actuators.Saturation,
        actuators.SlewLimit,
        actuators.Lag,
        actuators.LossOfEffectiveness,
        sensors.MeasurementDelay,  # reads the true motion
        sensors.MeasurementNoise,
        sensors.Quantisation,
    )
}
DISTURBANCES: Declared[type[Disturbance]] = Declared("disturbance", _BUILT_IN, _lacks, _declares)


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
