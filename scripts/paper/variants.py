"""Who is compared: every controller with tuned and with hand-set gains, and the ablations.

A variant is a controller of the command line with all its gains written out, so that the sweep it
stands in can be run by `octarm sweep` and `octarm verify` alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Controller
from octarm.sweeps.tune import gains_of

CONTROLLERS = (
    "pd", "computed-torque", "fuzzy",
    "smc", "smc-boundary", "smc-integral", "super-twisting",
    "fsmc", "afsmc-consequent", "afsmc",
)  # fmt: skip
SIGN, SMC, PROPOSED = "smc", "smc-boundary", "afsmc"  # the paper's two, SMC in both its forms
INTEGRAL, CONSEQUENT, TWISTING = "smc-integral", "afsmc-consequent", "super-twisting"
FIXED_PREMISES = "afsmc, eta3 = eta4 = 0"
AS_PRINTED = "afsmc, sgn as printed"
MATCHED = "smc-boundary, matched slope"
UNGUARDED = "afsmc, no safeguards"


class Factory(Protocol):
    """`controllers.make_controller`, whose gains broadcast to (..., 2N)."""

    def __call__(
        self,
        name: str,
        nominal: ArmParameters,
        gains: Mapping[str, npt.ArrayLike] | None = None,
        *,
        gain_set: str | Path | None = None,
    ) -> Controller:
        """A controller by name, with the model it believes; gains broadcast to (..., 2N)."""
        ...


@dataclasses.dataclass(frozen=True, kw_only=True)
class Variant:
    """A controller with its gains.

    Attributes:
        label: under which it stands in tables and figures.
        controller: name on the command line.
        gains: all that are numbers, as numbers or lists.
    """

    label: str
    controller: str
    gains: Mapping[str, Any]

    def changed(self, label: str, **gains: Any) -> Variant:
        """The same with some gains replaced."""
        return dataclasses.replace(self, label=label, gains={**self.gains, **gains})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cast:
    """All variants by label.

    Attributes:
        tuned: each controller of `CONTROLLERS` with the gains it is shipped with.
        by_hand: likewise with hand-set gains; labels end in `, hand-set`.
        ablations: what takes something away from `afsmc`, or gives its slope to another one.
        shipped: the controllers that come with tuned gains.
    """

    tuned: Mapping[str, Variant]
    by_hand: Mapping[str, Variant]
    ablations: Mapping[str, Variant]
    shipped: tuple[str, ...]

    def __getitem__(self, label: str) -> Variant:
        return {**self.tuned, **self.by_hand, **self.ablations}[label]

    def labels(self) -> list[str]:
        """Of all variants."""
        return [*self.tuned, *self.by_hand, *self.ablations]


def by_hand(name: str) -> str:
    """The label of a controller with hand-set gains."""
    return f"{name}, hand-set"


def cast(factory: Factory, folder: Path | None = None) -> Cast:
    """All variants.

    Args:
        factory: `controllers.make_controller`.
        folder: of gain sets NAME.toml to take instead of those shipped; a controller without one
            has its hand-set gains.

    Raises:
        ValueError: if a gain set cannot be read.
    """
    nominal = nominal_parameters()

    def gains(name: str, gain_set: str | Path | None) -> dict[str, Any]:
        made = factory(name, nominal, gain_set=gain_set)
        return {gain: _plain(value) for gain, value in gains_of(made).items()}

    def choice(name: str) -> str | Path | None:
        if folder is None:
            return None
        return folder / f"{name}.toml" if (folder / f"{name}.toml").is_file() else "recommended"

    tuned = {n: Variant(label=n, controller=n, gains=gains(n, choice(n))) for n in CONTROLLERS}
    hand = {
        by_hand(n): Variant(label=by_hand(n), controller=n, gains=gains(n, "recommended"))
        for n in CONTROLLERS
    }
    proposed = tuned[PROPOSED]
    ablations = (
        proposed.changed(FIXED_PREMISES, eta3=0.0, eta4=0.0),
        proposed.changed(AS_PRINTED, phi=0.0),
        proposed.changed(UNGUARDED, safeguards=0.0),
        tuned[SMC].changed(MATCHED, **matched_slope(proposed.gains)),
    )
    own = [n for n in CONTROLLERS if tuned[n].gains != hand[by_hand(n)].gains]
    return Cast(
        tuned=tuned,
        by_hand=hand,
        ablations={variant.label: variant for variant in ablations},
        shipped=tuple(own),
    )


def matched_slope(gains: Mapping[str, Any]) -> dict[str, Any]:
    """Gains of `smc-boundary` that give no less and no more than the bounds of `afsmc` allow.

    With E and all theta at their bounds, theta of each rule with the sign of its centre, and the
    premises as they start, the force of `afsmc` beside K_v s is

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
    return {
        "lambda": gains["lambda"],
        "K_v": gains["K_v"],
        "K": _plain(K),
        "phi": _plain(K / slope),
    }


def _plain(gain: np.ndarray) -> Any:
    """A number where all are the same, else a list."""
    values = np.unique(gain)
    return values.item() if values.size == 1 else np.asarray(gain).tolist()
