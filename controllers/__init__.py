"""The controllers, by the names that the command line uses.

To add one, write its file, import its class here, and add its line to `CONTROLLERS`. The class is a
frozen dataclass with the field `nominal`, the model that the controller believes, and a field for
each gain; `octarm.interfaces` says what it does. Where nothing else is asked for, a gain has

- the value of the class's own `recommended` table (gain to function of the nominal model),
- else that of `controllers.gains.RECOMMENDED`, the one shared by all controllers,
- else the field's default.

A gain that the class's `derived` table derives from another one is left out when that one is given.

Tuned gains take the place of recommended ones where `controllers/gains/` holds some for the
controller and for arms of as many modules. `octarm tune` finds gains.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy.typing as npt

from controllers.adaptive_fuzzy import AdaptiveConsequents as AdaptiveConsequents
from controllers.adaptive_fuzzy import AdaptiveFuzzy as AdaptiveFuzzy
from controllers.computed_torque import ComputedTorque as ComputedTorque
from controllers.fuzzy_sliding_mode import FuzzySlidingMode as FuzzySlidingMode
from controllers.gain_sets import starting_gains
from controllers.gains import RECOMMENDED
from controllers.integral_sliding_mode import IntegralSlidingMode as IntegralSlidingMode
from controllers.model_free_fuzzy import FuzzyController as FuzzyController
from controllers.pd import ProportionalDerivative as ProportionalDerivative
from controllers.sliding_mode import BoundaryLayer as BoundaryLayer
from controllers.sliding_mode import SlidingMode as SlidingMode
from controllers.super_twisting import SuperTwisting as SuperTwisting
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError, closest
from octarm.interfaces import Controller

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
    nominal: ArmParameters,
    gains: Mapping[str, npt.ArrayLike] | None = None,
    *,
    gain_set: str | Path | None = None,
) -> Controller:
    """A controller by name, with the nominal model it believes.

    Args:
        name: one of `CONTROLLERS`.
        nominal: the model of the arm that the controller is given.
        gains: gains by the names of the controller's fields, each a number or an array that
            broadcasts to (..., 2N), unless the field says otherwise; those of the gain set where
            not given.
            `lambda` stands for `lambda_`, as Python keeps the former word for itself.
        gain_set: `tuned`, `recommended`, or a file NAME.toml of `octarm tune`; tuned gains where
            there are any for such an arm, else recommended ones, when not given.

    Raises:
        ValueError: for an unknown name or gain set, or a gain that is unknown or invalid.
    """
    if name not in CONTROLLERS:
        raise OctarmError(f"unknown controller {name!r}{closest(name, CONTROLLERS)}")
    kind = CONTROLLERS[name]
    fields = [field.name for field in dataclasses.fields(kind) if field.name != "nominal"]
    spoken = {field.rstrip("_"): field for field in fields}
    recommended = RECOMMENDED | getattr(kind, "recommended", {})
    given = gains or {}
    replaced = {gain for gain, source in getattr(kind, "derived", {}).items() if source in given}
    starting = [field for field in fields if field in recommended and field not in replaced]
    chosen = {field: recommended[field](nominal) for field in starting}
    tuned = starting_gains(name, nominal.modules, gain_set)
    for gain, value in [*((k, x) for k, x in tuned.items() if k not in replaced), *given.items()]:
        if gain not in spoken:
            raise OctarmError(f"{name} has no gain {gain!r}{closest(gain, spoken)}")
        chosen[spoken[gain]] = value
    return kind(nominal=nominal, **chosen)
