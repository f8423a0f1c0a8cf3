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
from controllers.law import GainField, Law, Undeclared, gain_fields, spelled
from controllers.sliding_mode import BoundaryLayer as BoundaryLayer
from controllers.sliding_mode import IntegralSlidingMode as IntegralSlidingMode
from controllers.sliding_mode import SlidingMode as SlidingMode
from controllers.super_twisting import SuperTwisting as SuperTwisting
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.declared import Declared, lacking, short_name
from octarm.errors import OctarmError, closest, quoted
from octarm.interfaces import NominalModel, Tunable
from octarm.roll_off import RolledOff
from octarm.units import ANY

_MISSING = dataclasses.MISSING
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


def gains_in_si(controller: str, gains: Mapping[str, Any]) -> dict[str, Any]:
    """Gains with numbers [SI] in place of texts such as "15/s".

    Raises OctarmError for an unknown controller, a gain that it does not have, or a text that is
    no number in the unit of the gain.
    """
    known = _gains_of(CONTROLLERS[controller])
    for gain in gains:
        if gain not in known:
            label = short_name(controller)
            raise OctarmError(f"{label} has no gain {quoted(gain)}{closest(gain, known)}")
    return {gain: known[gain].in_si(gain, value) for gain, value in gains.items()}


def _gains_of(law: Any) -> dict[str, GainField]:
    """The gains of a controller by how users spell them, and what is declared of each."""
    declared, gains = gain_fields(law), dict[str, GainField]()
    for field in dataclasses.fields(law):
        if field.init and field.name != "nominal":
            gains[spelled(field.name)] = declared.get(field.name) or Undeclared(
                "what a law does not declare", ANY, default=_default(field)
            )
    return {**gains, "roll_off": declared.get("roll_off", _ROLL_OFF)}


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
    if name not in CONTROLLERS:  # no gains are shipped for it
        if gain_set == "tuned":
            lacks = "comes without tuned gains; `octarm tune` finds some"
            raise OctarmError(f"{short_name(name)} {lacks}")
        gain_set = "recommended" if gain_set is None else gain_set
    model = LagrangeModel(nominal) if isinstance(nominal, ArmParameters) else nominal
    given, known = dict(gains or {}), _gains_of(law)
    starting: dict[str, Any] = {
        gain: kind.start(model) for gain, kind in known.items() if kind.recommended is not None
    }
    _, tuned = gain_set_of(short_name(name), gain_set)
    for gain, value in ({} if tuned is None else tuned.gains).items():
        starting[gain] = known[gain].scaled(value, model) if gain in known else value
    for gain, kind in known.items():
        if kind.replaced_by in given:
            starting.pop(gain, None)
    wanted = gains_in_si(name, {**starting, **given})
    values: dict[str, Any] = {}
    for field in dataclasses.fields(law):
        gain = spelled(field.name)
        if field.name == "nominal":
            values["nominal"] = model
        elif gain in wanted:
            value = wanted.pop(gain)
            own = issubclass(law, Law)  # which checks its gains itself
            values[field.name] = value if own else known[gain].checked(gain, value, model)
        elif field.init and _default(field) is _MISSING:
            raise OctarmError(f"{short_name(name)} needs the gain {gain}; it recommends no value")
    made: Any = law(**values)
    if "roll_off" not in wanted:  # or the law has one of its own
        return made
    corner = _ROLL_OFF.checked("roll_off", wanted["roll_off"], model)
    return RolledOff(law=made, roll_off=corner, scale=np.asarray(_ROLL_OFF.scaled(1.0, model)))


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not _MISSING:
        return field.default_factory()
    return field.default
