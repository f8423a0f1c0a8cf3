"""The controllers, by the names that the command line uses.

To add one, write its file, import its class here, and add its line to `CONTROLLERS`. The class is a
`controllers.law.Law` with a field for each gain, which declares its units, what is allowed, its
recommended value and its tuning; see `controllers.gains`. `octarm.interfaces` says what a
controller does.

Tuned gains take the place of recommended ones where `controllers/gains/` holds some for the
controller and for arms of as many modules. `octarm tune` finds gains.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt

from controllers.adaptive_fuzzy import AdaptiveConsequents as AdaptiveConsequents
from controllers.adaptive_fuzzy import AdaptiveFuzzy as AdaptiveFuzzy
from controllers.computed_torque import ComputedTorque as ComputedTorque
from controllers.fuzzy_sliding_mode import FuzzySlidingMode as FuzzySlidingMode
from controllers.gain_sets import starting_gains
from controllers.gains import gain_fields, spelled
from controllers.integral_sliding_mode import IntegralSlidingMode as IntegralSlidingMode
from controllers.model_free_fuzzy import FuzzyController as FuzzyController
from controllers.pd import ProportionalDerivative as ProportionalDerivative
from controllers.sliding_mode import BoundaryLayer as BoundaryLayer
from controllers.sliding_mode import SlidingMode as SlidingMode
from controllers.super_twisting import SuperTwisting as SuperTwisting
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError, closest
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


def make_controller(
    name: str,
    nominal: ArmParameters | NominalModel,
    gains: Mapping[str, npt.ArrayLike] | None = None,
    *,
    gain_set: str | Path | None = None,
) -> Tunable:
    """A controller by name, with the nominal model it believes.

    Args:
        name: one of `CONTROLLERS`.
        nominal: the model of the arm that the controller is given; parameters stand for the
            analytic model with them.
        gains: gains by name, each a number or an array that broadcasts to (..., 2N), unless the
            gain's field says otherwise; those of the gain set where not given. `lambda` stands for
            the field `lambda_`, as Python keeps the former word for itself.
        gain_set: `tuned`, `recommended`, or a file NAME.toml of `octarm tune`; tuned gains where
            there are any for such an arm, else recommended ones, when not given.

    Raises:
        OctarmError: for an unknown name or gain set, or a gain that is unknown or invalid.
    """
    if name not in CONTROLLERS:
        raise OctarmError(f"unknown controller {name!r}{closest(name, CONTROLLERS)}")
    law = CONTROLLERS[name]
    model = LagrangeModel(nominal) if isinstance(nominal, ArmParameters) else nominal
    given = dict(gains or {})
    declared = gain_fields(law)
    fields = {spelled(field): field for field in declared}
    starting = {n: f for n, f in declared.items() if f.replaced_by not in given}
    values: dict[str, Any] = {
        n: f.start(model) for n, f in starting.items() if f.recommended is not None
    }
    tuned = starting_gains(name, model.modules, gain_set)
    wanted = {n: x for n, x in tuned.items() if fields.get(n) not in declared.keys() - starting}
    for gain, value in {**wanted, **given}.items():
        if gain not in fields:
            raise OctarmError(f"{name} has no gain {gain!r}{closest(gain, fields)}")
        values[fields[gain]] = value
    return law(nominal=model, **values)
