"""The controllers, by the names that the command line uses.

To add one, write its file, import its class here, and add its line to `CONTROLLERS`. The class is a
`controllers.law.Law` with a field for each gain, which declares its units, what is allowed, its
recommended value and its tuning. `octarm.interfaces` says what a controller does.

Tuned gains take the place of recommended ones where `controllers/gains/` holds some for the
controller. Both are scaled by the nominal model, see `controllers.scaling`. `octarm tune` finds
gains.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt

from controllers.adaptive_fuzzy import AdaptiveConsequents as AdaptiveConsequents
from controllers.adaptive_fuzzy import AdaptiveFuzzy as AdaptiveFuzzy
from controllers.feedback import ComputedTorque as ComputedTorque
from controllers.feedback import ProportionalDerivative as ProportionalDerivative
from controllers.fuzzy_rules import FuzzyController as FuzzyController
from controllers.fuzzy_rules import FuzzySlidingMode as FuzzySlidingMode
from controllers.gain_sets import gain_set_of
from controllers.integral_sliding_mode import IntegralSlidingMode as IntegralSlidingMode
from controllers.law import Law, gain_fields, spelled
from controllers.sliding_mode import BoundaryLayer as BoundaryLayer
from controllers.sliding_mode import SlidingMode as SlidingMode
from controllers.super_twisting import SuperTwisting as SuperTwisting
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError, closest, quoted
from octarm.interfaces import NominalModel, Tunable

CONTROLLERS: dict[str, type] = {
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


def limits_text() -> str:
    """For help pages: the laws that do not bear what all others do, a line each; may be empty."""
    limits = {name: law.bears.limits() for name, law in CONTROLLERS.items() if issubclass(law, Law)}
    return "\n".join(f"  {name}: up to {text}" for name, text in limits.items() if text)


def make_controller(
    name: str,
    nominal: ArmParameters | NominalModel,
    gains: Mapping[str, npt.ArrayLike] | None = None,
    *,
    gain_set: str | Path | Mapping[str, Any] | None = None,
) -> Tunable:
    """A controller by name, with the nominal model it believes.

    Args:
        name: one of `CONTROLLERS`.
        nominal: the model of the arm that the controller is given; parameters stand for the
            analytic model with them.
        gains: gains by name in SI, each a number or an array that broadcasts to (..., 2N), unless
            the gain's field says otherwise; those of the gain set where not given. `lambda` stands
            for the field `lambda_`, as Python keeps the former word for itself.
        gain_set: `tuned`, `recommended`, or a file NAME.toml of `octarm tune`, or what such a file
            holds; tuned gains where there are any, else recommended ones, when not given. They are
            scaled by the nominal model.

    Raises:
        OctarmError: for an unknown name or gain set, or a gain that is unknown or invalid.
    """
    if name not in CONTROLLERS:
        raise OctarmError(f"unknown controller {quoted(name)}{closest(name, CONTROLLERS)}")
    law = CONTROLLERS[name]
    model = LagrangeModel(nominal) if isinstance(nominal, ArmParameters) else nominal
    given, declared = dict(gains or {}), gain_fields(law)
    fields = {spelled(field): field for field in declared}
    starting: dict[str, Any] = {
        gain: declared[field].start(model)
        for gain, field in fields.items()
        if declared[field].recommended is not None
    }
    _, tuned = gain_set_of(name, gain_set)
    for gain, value in ({} if tuned is None else tuned.gains).items():
        known = gain in fields
        starting[gain] = declared[fields[gain]].scaled(value, model) if known else value
    for gain, field in fields.items():
        if declared[field].replaced_by in given:
            starting.pop(gain, None)
    values: dict[str, Any] = {}
    for gain, value in {**starting, **given}.items():
        if gain not in fields:
            raise OctarmError(f"{name} has no gain {quoted(gain)}{closest(gain, fields)}")
        values[fields[gain]] = value
    return law(nominal=model, **values)
