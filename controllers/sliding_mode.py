"""Sliding-mode control, eqs (17)-(42) and (51)-(57), in the one consistent sign convention.

    e = q - q_d,   q_r' = q_d' - lambda e,   s = e' + lambda e = q' - q_r'

On s = 0 the error decays as exp(-lambda t). The equivalent part is the nominal model along the
reference velocity q_r', not along q': then D s' = -(C + B) s + F + (robust part), F being the model
error, and V = 1/2 s^T D s is the Lyapunov function, eqs (32)-(42). The robust part has a minus
sign; the paper prints a plus sign, which belongs to s of the opposite sign.

By (42) V falls when K_i >= |F_i| + eta_i. The gain K is given, or it is derived from the
`uncertainty` that the nominal model is declared to have: K_i = max |F_i| + eta_i at every instant.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.gains import Gain, as_gain, as_share, reaching_gain
from controllers.model_error import largest_model_error, reaching_time_bound
from controllers.shapes import check_shapes
from octarm.arm.lagrange import inverse_dynamics, kinetic_energy
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.interfaces import Command, Measurement, Reference


class Surface(NamedTuple):
    """The sliding variable and the reference velocity behind it, each of shape (..., 2N).

    Attributes:
        s: e' + lambda e [m/s], [rad/s].
        v_r: q_r' = q_d' - lambda e [m/s], [rad/s].
        a_r: q_r'' = q_d'' - lambda e' [m/s^2], [rad/s^2].
    """

    s: np.ndarray
    v_r: np.ndarray
    a_r: np.ndarray


def sliding_surface(lambda_: Gain, measurement: Measurement, reference: Reference) -> Surface:
    """Eqs (17) and (18), for a lambda [1/s] that broadcasts to (..., 2N)."""
    e, e_dot = measurement.q - reference.q, measurement.v - reference.v
    return Surface(
        s=e_dot + lambda_ * e,
        v_r=reference.v - lambda_ * e,
        a_r=reference.a - lambda_ * e_dot,
    )


def equivalent_force(
    nominal: ArmParameters, lambda_: Gain, measurement: Measurement, reference: Reference
) -> tuple[np.ndarray, np.ndarray]:
    """The sliding variable s and D^ q_r'' + (C^ + B^) q_r' + G^, each of shape (..., 2N).

    Raises:
        ValueError: if the measurement or the reference has a wrong shape.
    """
    check_shapes(nominal, measurement, reference)
    surface = sliding_surface(lambda_, measurement, reference)
    return surface.s, force_along(nominal, measurement, surface)


def force_along(nominal: ArmParameters, measurement: Measurement, surface: Surface) -> np.ndarray:
    """D^ q_r'' + (C^ + B^) q_r' + G^, eqs (28) and (55) corrected, shape (..., 2N) [N], [N m]."""
    return inverse_dynamics(nominal, measurement.q, measurement.v, surface.a_r, surface.v_r)


def saturation(s: np.ndarray, phi: Gain) -> np.ndarray:
    """sat(s / phi), eq (53), shape (..., 2N) [1]; where phi is 0 it is sgn(s), eq (22)."""
    return np.clip(s / np.maximum(phi, 1e-150), -1.0, 1.0)  # a smaller s than that is no motion


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SlidingGains:
    """The gains that all sliding modes with a switching gain have.

    Attributes:
        nominal: the model that the controller believes.
        lambda_: decay rate of the error on the surface, broadcasts to (..., 2N) [1/s].
        K_v: linear gain, broadcasts to (..., 2N) [N s/m], [N m s/rad].
        K: switching gain, broadcasts to (..., 2N) [N], [N m]; None when it is derived.
        uncertainty: share u of the nominal model from which K is derived, below 1, shape () or
            (..., 1) [1]; see `controllers.model_error`. None when K is given.
        eta: what a derived K has above the model error, broadcasts to (..., 2N) [N], [N m]; the
            recommended one when not given.

    Raises:
        ValueError: for a gain that is negative, not finite, or has a wrong shape; unless one of K
            and uncertainty is given.
    """

    derived: ClassVar[Mapping[str, str]] = {"K": "uncertainty"}

    nominal: ArmParameters
    lambda_: Gain
    K_v: Gain
    K: Gain | None = None
    uncertainty: Gain | None = None
    eta: Gain | None = None

    def __post_init__(self) -> None:
        given = (self.K is not None) + (self.uncertainty is not None)
        if given != 1:
            raise OctarmError(
                f"{('neither', '', 'both')[given]} of K and uncertainty are given; the gain is "
                "either set, or derived from the uncertainty"
            )
        if self.eta is not None and self.uncertainty is None:
            raise OctarmError("eta is given without uncertainty; only a derived K has that part")
        gains = {
            "lambda_": as_gain("lambda", self.lambda_, self.nominal),
            "K_v": as_gain("K_v", self.K_v, self.nominal, zero_allowed=True),
        }
        if self.K is not None:
            gains["K"] = as_gain("K", self.K, self.nominal, zero_allowed=True)
        if self.uncertainty is not None:
            eta = reaching_gain(self.nominal) if self.eta is None else self.eta
            gains["eta"] = as_gain("eta", eta, self.nominal)
            gains["uncertainty"] = as_share("uncertainty", self.uncertainty)
        for name, gain in gains.items():
            object.__setattr__(self, name, gain)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        """Nothing is remembered from before the first call."""
        del batch_shape

    def _command(self, measurement: Measurement, surface: Surface, switch: np.ndarray) -> Command:
        """The force with the robust part -K switch - K_v s, and its signals.

        The switch, shape (..., 2N) [1], is sgn(s) or what takes its place.
        """
        s, equivalent = surface.s, force_along(self.nominal, measurement, surface)
        K = self._switching_gain(measurement, surface)
        switching = -K * switch - self.K_v * s
        V = kinetic_energy(self.nominal, measurement.q, s)[..., None]
        signals = {"s": s, "equivalent": equivalent, "switching": switching, "V": V}
        derived = {} if self.uncertainty is None else {"K": K}
        return Command(equivalent + switching, signals | derived)

    def _switching_gain(self, measurement: Measurement, surface: Surface) -> np.ndarray:
        """The given K, or max |F| + eta by eq (40), broadcasts to (..., 2N) [N], [N m]."""
        if self.uncertainty is None:
            return np.asarray(self.K)
        _, q, v = measurement
        u = np.asarray(self.uncertainty)
        F = largest_model_error(self.nominal, u, q, v, surface.a_r, surface.v_r)
        return np.asarray(self.eta) + F


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SlidingMode(SlidingGains):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sgn(s) - K_v s, eqs (22), (31), (37) corrected.

    For the gains see `SlidingGains`. Signals: s, the parts `equivalent` and `switching`, and
    V = 1/2 s^T D^ s [J]. When K is derived, also K and `reaching_bound`, the time within which
    s = 0 is reached [s], eqs (14) and (15).
    """

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        check_shapes(self.nominal, measurement, reference)
        surface = sliding_surface(self.lambda_, measurement, reference)
        command = self._command(measurement, surface, np.sign(surface.s))
        if self.uncertainty is None:
            return command, state
        u, eta, V = np.asarray(self.uncertainty), np.asarray(self.eta), command.signals["V"]
        bound = reaching_time_bound(self.nominal, u, eta, measurement.q, V)
        return command._replace(signals={**command.signals, "reaching_bound": bound}), state


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class BoundaryLayer(SlidingGains):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sat(s / phi) - K_v s, eqs (51)-(57) corrected.

    Inside the layer |s| <= phi the switching is a linear term: no chattering, at the price of an
    error that only stays bounded. Eq (42) becomes V' <= -sum eta_i |s_i| + sum K_i phi_i / 4, and
    no time to reach s = 0 can be promised. With phi = 0 this is `SlidingMode`.

    For the other gains see `SlidingGains`. Signals: s, the parts `equivalent` and `switching`,
    V = 1/2 s^T D^ s [J], and K when it is derived.

    Attributes:
        phi: half width of the boundary layer, broadcasts to (..., 2N) [m/s], [rad/s].
    """

    phi: Gain

    def __post_init__(self) -> None:
        super().__post_init__()
        phi = as_gain("phi", self.phi, self.nominal, zero_allowed=True)
        object.__setattr__(self, "phi", phi)

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        check_shapes(self.nominal, measurement, reference)
        surface = sliding_surface(self.lambda_, measurement, reference)
        return self._command(measurement, surface, saturation(surface.s, self.phi)), state
