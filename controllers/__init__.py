"""The controllers, by the names that the command line uses.

A controller of your own needs no line here: `make_controller("./my_law.py:MyLaw", ...)`, and see
`octarm.declared`. Best it is a `controllers.law.Law` with a field for each gain, which declares its
units, what is allowed, its recommended value and its tuning; any frozen dataclass will do that does
what `octarm.interfaces.Controller` says. Its fields but `nominal` are its gains.

Tuned gains take the place of recommended ones where `controllers/gains/` holds some for the
controller. Both are scaled by the nominal model, see `controllers.scaling`. `octarm tune` finds
gains.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from controllers.adaptive_fuzzy import AdaptiveConsequents as AdaptiveConsequents
from controllers.adaptive_fuzzy import AdaptiveFuzzy as AdaptiveFuzzy
from controllers.feedback import ComputedTorque as ComputedTorque
from controllers.feedback import ProportionalDerivative as ProportionalDerivative
from controllers.fuzzy_rules import FuzzyController as FuzzyController
from controllers.fuzzy_rules import FuzzySlidingMode as FuzzySlidingMode
from controllers.gain_sets import gain_set_of
from controllers.integral_sliding_mode import IntegralSlidingMode as IntegralSlidingMode
from controllers.law import GainField, Law, gain_fields, spelled
from controllers.sliding_mode import BoundaryLayer as BoundaryLayer
from controllers.sliding_mode import SlidingMode as SlidingMode
from controllers.super_twisting import SuperTwisting as SuperTwisting
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.arrays import read_only
from octarm.declared import Declared, lacking, short_name
from octarm.errors import OctarmError, closest, quoted
from octarm.interfaces import NominalModel, Tunable
from octarm.roll_off import RolledOff
from octarm.units import ANY

_MISSING = dataclasses.MISSING
_ANY_GAIN = GainField("what a law does not declare", ANY)
_ROLL_OFF = GainField("corner of the roll-off of the force", "Hz")


def _lacks(thing: Any) -> str:
    """What a class of a user lacks of a controller; empty if nothing."""
    if not (isinstance(thing, type) and dataclasses.is_dataclass(thing)):
        return "is no dataclass; octarm.interfaces.Controller says what a controller is"
    if not vars(thing)["__dataclass_params__"].frozen:
        return "is no frozen dataclass, although a controller keeps nothing between calls"
    call = ("state", "measurement", "reference")
    return lacking(thing, initial_state=["batch_shape"], __call__=call)


_BUILT_IN: dict[str, type] = {
    "pd": ProportionalDerivative,
    "computed-torque": ComputedTorque,
    "smc": SlidingMode,
    "smc-boundary": BoundaryLayer,
    "smc-integral": IntegralSlidingMode,
    "super-twisting": SuperTwisting,
    "fuzzy": FuzzyController,
    "fsmc": FuzzySlidingMode,
    "afsmc-consequent": AdaptiveConsequents,
    "afsmc": AdaptiveFuzzy,
}
CONTROLLERS = Declared("controller", _BUILT_IN, _lacks)


def limits_text() -> str:
    """For help pages: the laws that do not bear what all others do, a line each; may be empty."""
    limits = {name: law.bears.limits() for name, law in CONTROLLERS.items() if issubclass(law, Law)}
    return "\n".join(f"  {name}: up to {text}" for name, text in limits.items() if text)


def gains_in_si(controller: str, gains: Mapping[str, Any]) -> dict[str, Any]:
    """Gains with numbers [SI] in place of texts such as "15/s".

    Raises OctarmError for an unknown controller, a gain that it does not have, or a text that is
    no number in the unit of the gain.
    """
    law = CONTROLLERS[controller]
    fields, declared = _gain_names(law), _declared(law)
    for gain in gains:
        if gain not in fields:
            label = short_name(controller)
            raise OctarmError(f"{label} has no gain {quoted(gain)}{closest(gain, fields)}")
    return {
        gain: declared.get(fields[gain], _ANY_GAIN).in_si(gain, value)
        for gain, value in gains.items()
    }


def _declared(law: Any) -> dict[str, GainField]:
    return {"roll_off": _ROLL_OFF, **gain_fields(law)}


def _gain_names(law: Any) -> dict[str, str]:
    """The fields of a controller that are gains, by how users spell them, and `roll_off`."""
    names = [*(field.name for field in dataclasses.fields(law) if field.init), "roll_off"]
    return {spelled(name): name for name in names if name != "nominal"}


def make_controller(
    name: str,
    nominal: ArmParameters | NominalModel,
    gains: Mapping[str, Any] | None = None,
    *,
    gain_set: str | Path | Mapping[str, Any] | None = None,
) -> Tunable:
    """A controller by name, with the nominal model it believes.

    Args:
        name: of a built-in controller or of an installed package's, MODULE:NAME, or FILE.py:NAME.
        nominal: the model of the arm; parameters stand for the analytic model with them.
        gains: by name in SI, each a number or an array that broadcasts to (..., 2N), unless its
            field says otherwise, or texts such as "15/s"; those of the gain set where not given.
            `lambda` stands for `lambda_`. Every law takes `roll_off`, a corner [Hz] beyond which
            its force is rolled off, see `octarm.roll_off`.
        gain_set: `tuned`, `recommended`, or a file NAME.toml of `octarm tune`, or what such a file
            holds; tuned gains where there are any, else recommended ones, when not given. They are
            scaled by the nominal model.

    Raises:
        OctarmError: for an unknown name or gain set, or a gain that is unknown or invalid.
    """
    law: Any = CONTROLLERS[name]
    word = name
    if name not in CONTROLLERS:  # no gains are shipped for it
        name = short_name(name)
        if gain_set == "tuned":
            raise OctarmError(f"{name} comes without tuned gains; `octarm tune` finds some")
        gain_set = "recommended" if gain_set is None else gain_set
    model = LagrangeModel(nominal) if isinstance(nominal, ArmParameters) else nominal
    given, declared = dict(gains or {}), _declared(law)
    fields = _gain_names(law)
    known = {field.name for field in dataclasses.fields(law) if field.init}
    starting: dict[str, Any] = {
        gain: declared[field].start(model)
        for gain, field in fields.items()
        if field in declared and declared[field].recommended is not None
    }
    _, tuned = gain_set_of(name, gain_set)
    for gain, value in ({} if tuned is None else tuned.gains).items():
        scaled_by = declared.get(fields.get(gain, ""))
        starting[gain] = value if scaled_by is None else scaled_by.scaled(value, model)
    for gain, field in fields.items():
        if field in declared and declared[field].replaced_by in given:
            starting.pop(gain, None)
    wanted = gains_in_si(word, {**starting, **given})
    values: dict[str, Any] = {fields[gain]: value for gain, value in wanted.items()}
    corner = None if "roll_off" in known else values.pop("roll_off", None)
    if not issubclass(law, Law):  # which checks its gains itself
        for each in dataclasses.fields(law):
            if each.name in values:
                of = declared.get(each.name)
                values[each.name] = _checked(of, each, values[each.name], model)
    needed = [f.name for f in dataclasses.fields(law) if f.init and _default(f) is _MISSING]
    if missing := [spelled(f) for f in needed if f not in values and f != "nominal"]:
        raise OctarmError(f"{name} needs the gain {missing[0]}; it recommends no value")
    made: Any = law(**values, **({"nominal": model} if "nominal" in known else {}))
    if corner is None:
        return made
    corner = _ROLL_OFF.checked("roll_off", corner, model)
    return RolledOff(law=made, roll_off=corner, scale=np.asarray(_ROLL_OFF.scaled(1.0, model)))


def _checked(
    gain: GainField | None, field: dataclasses.Field[Any], value: Any, model: NominalModel
) -> Any:
    name = spelled(field.name)
    if gain is not None:
        return gain.checked(name, value, model)
    if isinstance(value, str | bool | int):
        return value
    array = read_only(name, value)
    default = _default(field)
    like = () if default is _MISSING else np.shape(default)
    if array.ndim and array.shape[-1] not in (1, model.coordinates) and array.shape != like:
        raise OctarmError(
            f"{name} has {array.shape[-1]} values; it needs 1 or {model.coordinates}, one for each "
            "coordinate"
        )
    return array if array.ndim else array.item()


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not _MISSING:
        return field.default_factory()
    return field.default
