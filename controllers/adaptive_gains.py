"""The gains of the adaptive fuzzy controllers: their checks and the values they start from."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from controllers.gains import Gain, as_gain, boundary_width, switching_gain
from octarm.arm.parameters import ArmParameters
from octarm.arrays import read_only
from octarm.errors import OctarmError


def force_scale(nominal: ArmParameters) -> np.ndarray:
    """F, about what theta may have to be, shape (..., 2N) [N], [N m]: the unit it adapts in.

    1 N and 0.1 N m for three modules. For other arms half the switching gain, which scales with
    mass and size.
    """
    if nominal.modules == 3:
        return np.repeat([1.0, 0.1], 3)
    return 0.5 * switching_gain(nominal)


def consequent_bound(nominal: ArmParameters) -> np.ndarray:
    """theta_max, shape (..., 2N) [N], [N m]: hand-set for three modules, else `switching_gain`.

    It is what sampling allows. With all theta at their bounds and the premises as they start, the
    slope of f^ at s = 0 is 3.24 theta_max / scale. With a control period dt, the product
    dt [D^-1]_jj (K_v + E_max / phi + 3.24 theta_max / scale) should stay below about 0.6.
    """
    if nominal.modules == 3:
        return np.array([1.0, 1.0, 1.0, 0.6, 0.25, 0.04])
    return switching_gain(nominal)


def compensation_bound(nominal: ArmParameters) -> np.ndarray:
    """E_max, shape (..., 2N) [N], [N m]: about 0.6 `consequent_bound`; see there."""
    if nominal.modules == 3:
        return np.array([0.6, 0.6, 0.6, 0.3, 0.15, 0.02])
    return 0.6 * switching_gain(nominal)


def compensation_rate(nominal: ArmParameters) -> np.ndarray:
    """eta1, shape (..., 2N) [N/m], [N m/rad], from (E / F)' = 5 |z| with z = s / scale."""
    return 5.0 * force_scale(nominal) / boundary_width(nominal)


def consequent_rate(nominal: ArmParameters) -> np.ndarray:
    """eta2, shape (..., 2N) [N/m], [N m/rad], from (theta / F)' = 200 z phi."""
    return 200.0 * force_scale(nominal) / boundary_width(nominal)


def premise_rate(nominal: ArmParameters) -> np.ndarray:
    """eta3, eta4, shape (..., 2N) [1/(N m)], [1/(N m rad)], from alpha' = 0.1 z B^T (theta / F)."""
    return 0.1 / (force_scale(nominal) * boundary_width(nominal))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AdaptiveGains:
    """The gains of law (63) with given premises; each broadcasts to (..., 2N) unless said.

    Attributes:
        nominal: the model that the controller believes.
        lambda_: decay rate of the error on the surface [1/s].
        K_v: linear gain [N s/m], [N m s/rad].
        phi: half width of the saturation in the compensation [m/s], [rad/s]; 0 gives sgn(s), as
            the proof has it.
        eta1: adaptation rate of E [N/m], [N m/rad].
        eta2: adaptation rate of theta [N/m], [N m/rad].
        scale: z = s / scale is what the membership functions see [m/s], [rad/s].
        alpha0: centres of the membership functions at the start, in units of z, shape (M,) or
            (..., 2N, M) [1].
        sigma0: their inverse widths at the start, broadcasts against alpha0 [1].
        theta_max: bound on |theta| [N], [N m]; inf for none.
        E_max: bound on E [N], [N m]; inf for none.
        dead_zone: E rests while |s| is below this [m/s], [rad/s]; 0 for none.
        safeguards: whether bounds and dead zone act; False (or 0) leaves the law as printed.
        normalised: whether the strengths phi of a joint's rules are divided by their sum.

    Raises:
        ValueError: for a gain that is negative, not finite where it must be, or has a wrong shape.
    """

    recommended: ClassVar[Mapping[str, Callable[[ArmParameters], npt.ArrayLike]]] = {
        "eta1": compensation_rate,
        "eta2": consequent_rate,
        "eta3": premise_rate,
        "eta4": premise_rate,
        "scale": boundary_width,
        "alpha0": lambda nominal: [-1.0, -0.5, 0.0, 0.5, 1.0],
        "sigma0": lambda nominal: 2.0,  # a function is at exp(-1) on its neighbours' centres
        "theta_max": consequent_bound,
        "E_max": compensation_bound,
        "dead_zone": lambda nominal: 0.05 * boundary_width(nominal),
        "alpha_max": lambda nominal: 0.25,  # half the distance to the neighbour
        "sigma_min": lambda nominal: 1.0,
        "sigma_max": lambda nominal: 3.0,
    }

    nominal: ArmParameters
    lambda_: Gain
    K_v: Gain
    phi: Gain
    eta1: Gain
    eta2: Gain
    scale: Gain
    alpha0: np.ndarray
    sigma0: np.ndarray
    theta_max: np.ndarray
    E_max: Gain
    dead_zone: Gain
    safeguards: bool = True
    normalised: bool = False

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if field.name != "nominal":
                check = _CHECKS.get(field.name, _as_rate)
                value = check(field.name.rstrip("_"), getattr(self, field.name), self.nominal)
                object.__setattr__(self, field.name, value)
        rules = self.sigma0.shape[-1], self.alpha0.shape[-1]
        if rules[0] not in (1, rules[1]) and rules[1] != 1:
            raise OctarmError(
                "sigma0 is for {} rules and alpha0 for {}; they must fit".format(*rules)
            )

    def rule_table(self, value: np.ndarray, batch_shape: tuple[int, ...]) -> np.ndarray:
        """A new array with one value a rule, shape (..., 2N, M), the batch contiguous."""
        rules = np.broadcast_shapes(self.alpha0.shape, self.sigma0.shape)[-1]
        shape = np.broadcast_shapes((*batch_shape, self.nominal.coordinates, rules), value.shape)
        table = np.empty_like(value, shape=shape[::-1]).T
        table[...] = value
        return table


def _as_rate(name: str, value: npt.ArrayLike, nominal: ArmParameters) -> np.ndarray:
    return as_gain(name, value, nominal, zero_allowed=True)


def _as_bound(name: str, value: npt.ArrayLike, nominal: ArmParameters) -> np.ndarray:
    return as_gain(name, value, nominal, zero_allowed=True, unbounded=True)


def _as_premise(name: str, value: npt.ArrayLike, nominal: ArmParameters) -> np.ndarray:
    """Values of shape (M,) or (..., 2N, M)."""
    premise = np.atleast_1d(read_only(name, value))
    if premise.ndim > 1 and premise.shape[-2] not in (1, nominal.coordinates):
        raise OctarmError(
            f"{name} has shape {premise.shape}; it must be (M,) or (..., {nominal.coordinates}, M) "
            "for M rules"
        )
    if name == "sigma0" and not np.all(premise > 0.0):
        raise OctarmError(f"sigma0 holds {premise[premise <= 0.0].flat[0]:g}; it must be above 0")
    return premise


def _as_switch(name: str, value: npt.ArrayLike, nominal: ArmParameters) -> bool:
    del nominal
    if np.ndim(value) > 0 or value not in (0, 1):
        raise OctarmError(f"{name} is {value!r}; it must be True or False, or 1 or 0")
    return bool(value)


_CHECKS: dict[str, Callable[[str, Any, ArmParameters], Any]] = {
    **dict.fromkeys(("lambda_", "scale"), as_gain),
    **dict.fromkeys(("theta_max", "E_max", "alpha_max", "sigma_max"), _as_bound),
    **dict.fromkeys(("alpha0", "sigma0"), _as_premise),
    **dict.fromkeys(("safeguards", "normalised"), _as_switch),
}
