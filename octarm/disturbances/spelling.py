"""All disturbances by name, and how files and the command line spell them.

On the command line a disturbance is NAME:VALUE[,KEY=VALUE]*, such as `payload:0.2,at=3`. One of
your own needs no line here: it is given as MODULE:NAME or FILE.py:NAME, see `octarm.declared`.
Commands, specs, `run.json`, the ledger and the recordings then know it by its name and its fields.
"""

from __future__ import annotations

import dataclasses
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from octarm.arrays import plain
from octarm.declared import BUILT_IN, Code, Declared, lacking, word_of
from octarm.disturbances import actuators, forces, plant, sensors
from octarm.disturbances.episode import ActuatorFault, Disturbance, Force, PlantChange, SensorFault
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

_FAMILIES = (Force, PlantChange, ActuatorFault, SensorFault)
_NAME = re.compile(r"(?!.*-\d+$)[a-z][a-z0-9-]*")  # -2 is put behind the second one's


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
    declared = len(kinds) == len(dataclasses.fields(cast(Any, thing)))
    if not declared or not kinds or not isinstance(kinds[0], Quantity):
        return "needs fields annotated with Quantity or Words, and a Quantity first"
    return ""


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


def parse_disturbance(text: str, **given: Any) -> Disturbance:
    """A disturbance from its spelling on the command line.

    VALUE is that of the first field; a field that may differ between coordinates takes one number
    for each of them as well, separated by `/`, as in `loss:0/0/0.5/0/0/0`. A number may have a
    unit, as in `payload:100g,at=500ms`. Further fields may be `given` by name.
    """
    word, rest = DISTURBANCES.split(text)
    cls = DISTURBANCES[word]
    fields = parsed_fields(cls.name, text, rest, field_kinds(cls), _usage(cls))
    values: dict[str, Any] = {**fields, **given}
    if not values or not field_kinds(cls).keys() <= values.keys() | field_defaults(cls).keys():
        raise OctarmError(f"{quoted(text)} is incomplete; it must read {_usage(cls)}")
    return cls(**values)


def made_of(listed: Sequence[str | Disturbance]) -> list[Disturbance]:
    """Disturbances, of which some are spelt as in `parse_disturbance`."""
    return [parse_disturbance(each) if isinstance(each, str) else each for each in listed]


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
