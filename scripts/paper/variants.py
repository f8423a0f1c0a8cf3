"""Who is compared: every controller with tuned and with hand-set gains, and the ablations.

A variant is a controller of the command line with all its gains written out, so that the sweep it
stands in can be run by `octarm sweep` and `octarm verify` alone.
"""

import dataclasses
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import octarm
from controllers import make_controller
from octarm.runs.folder import gains_of

CONTROLLERS = (
    "pd", "computed-torque", "fuzzy",
    "smc", "smc-boundary", "smc-integral", "super-twisting",
    "fsmc", "afsmc-consequent", "afsmc",
)  # fmt: skip
SIGN, SMC, PROPOSED = "smc", "smc-boundary", "afsmc"  # the paper's two, SMC in both its forms
INTEGRAL, CONSEQUENT = "smc-integral", "afsmc-consequent"
FIXED_RULES = "afsmc, eta2 = 0"  # which leaves theta, hence the estimate, at 0
FIXED_PREMISES = "afsmc, eta3 = eta4 = 0"
AS_PRINTED = "afsmc, sgn as printed"
UNGUARDED = "afsmc, no safeguards"
MATCHED = "smc-boundary, matched slope"
ABLATIONS = {  # the law, and the gains that are replaced
    FIXED_RULES: (PROPOSED, {"eta2": 0.0}),
    FIXED_PREMISES: (PROPOSED, {"eta3": 0.0, "eta4": 0.0}),
    AS_PRINTED: (PROPOSED, {"phi": 0.0}),
    UNGUARDED: (PROPOSED, {"safeguards": 0.0}),
    MATCHED: (SMC, {}),  # by `matched_slope`
}
INSTEAD = (CONSEQUENT, SMC, INTEGRAL, *ABLATIONS)  # of `afsmc`, in the table of ablations
TUNED, BY_HAND = "tuned", "hand-set"  # the two gain sets of every controller
ARM = octarm.nominal_parameters()


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Variant:
    """A controller with its gains."""

    label: str  # under which it stands in tables and figures
    controller: str  # name on the command line
    # All that are numbers, as numbers or lists [SI], scaled to the nominal arm; they are the same
    # for every model that the controller believes.
    gains: Mapping[str, Any]

    def changed(self, label: str, **gains: Any) -> "Variant":
        """The same with some gains replaced."""
        return dataclasses.replace(self, label=label, gains={**self.gains, **gains})

    def controls(self, nominal: octarm.ArmParameters) -> octarm.Controller:
        """The controller with the nominal model that it believes."""
        return make_controller(self.controller, nominal, self.gains)


def with_gains(name: str, gains: str) -> str:
    """The label of a controller, or of an ablation, with one of the two gain sets."""
    return name if gains == TUNED else by_hand(name)


def by_hand(name: str) -> str:
    """The label of a controller with hand-set gains."""
    return f"{name}, {BY_HAND}"


def all_variants(folder: Path | None = None) -> dict[str, Variant]:
    """All variants by label: tuned ones, hand-set ones, ablations of `afsmc` with both gain sets.

    A folder has gain sets NAME.toml to take instead of those shipped; a controller without one has
    its hand-set gains. Raises OctarmError if a gain set cannot be read.
    """
    known: dict[str, Variant] = {}
    for gains, name in itertools.product((TUNED, BY_HAND), CONTROLLERS):
        file, gain_set = (folder or Path()) / f"{name}.toml", "recommended"
        if gains == TUNED and (folder is None or file.is_file()):
            gain_set = str(file) if folder else None
        label = with_gains(name, gains)
        fields = gains_of(make_controller(name, ARM, gain_set=gain_set))
        numbers = {
            field.rstrip("_"): _number_or_list(np.asarray(value))
            for field, value in fields.items() if isinstance(value, float | list)
        }  # fmt: skip
        known[label] = Variant(label=label, controller=name, gains=numbers)
    for gains, (name, (law, changes)) in itertools.product((TUNED, BY_HAND), ABLATIONS.items()):
        label = with_gains(name, gains)
        if name == MATCHED:
            changes = matched_slope(known[with_gains(PROPOSED, gains)].gains)
        known[label] = known[with_gains(law, gains)].changed(label, **changes)
    return known


def matched_slope(gains: Mapping[str, Any]) -> dict[str, Any]:
    """Gains of `smc-boundary` that give no less and no more than the bounds of `afsmc` allow.

    With E and all theta at their bounds, theta of each rule with the sign of its centre, and the
    premises as they start, the force of `afsmc` besides K_v s is

        E_max sat(s / phi) + theta_max f(s / scale),
        f(z) = sum_l sgn(alpha_l) exp(-(sigma_l (z - alpha_l))^2)

    K and phi are such that that of `smc-boundary` has the same slope at s = 0 and the same largest
    value; lambda and K_v are the same anyway. What then is left between the two is adaptation, not
    gain.
    """
    alpha, sigma = np.atleast_1d(gains["alpha0"]), np.atleast_1d(gains["sigma0"])
    phi, scale, E_max, theta_max = (
        np.atleast_1d(gains[name]) for name in ("phi", "scale", "E_max", "theta_max")
    )
    bells = np.sign(alpha) * np.exp(-np.square(sigma * alpha))
    steepness = np.sum(2.0 * sigma * sigma * alpha * bells)
    slope = E_max / phi + theta_max * steepness / scale
    z = np.linspace(0.0, 3.0, 3001)[:, None]
    f = np.sum(np.sign(alpha) * np.exp(-np.square(sigma * (z - alpha))), axis=-1, keepdims=True)
    K = np.max(E_max * np.minimum(z * scale / phi, 1.0) + theta_max * f, axis=0)
    same = {name: gains[name] for name in ("lambda", "K_v")}
    return {**same, "K": _number_or_list(K), "phi": _number_or_list(K / slope)}


def _number_or_list(gain: np.ndarray) -> Any:
    """A number where all are the same, else a list."""
    values = np.unique(gain)
    return values.item() if values.size == 1 else gain.tolist()
