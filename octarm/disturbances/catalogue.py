"""All disturbances, by the names that users give them.

One of your own needs no line here: it is given as MODULE:NAME or FILE.py:NAME, and see
`octarm.declared`. Commands, specs, `run.json`, the ledger and the recordings then know it by its
name and its fields.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any, cast

from octarm.declared import Declared, lacking
from octarm.disturbances import actuators, forces, plant, sensors
from octarm.disturbances.episode import (
    ActuatorFault,
    Disturbance,
    Force,
    PlantChange,
    SensorFault,
)
from octarm.errors import quoted
from octarm.fields import Quantity, field_keys, field_kinds

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
    if (
        len(kinds) < len(dataclasses.fields(cast(Any, thing)))
        or not kinds
        or not isinstance(kinds[0], Quantity)
    ):
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
