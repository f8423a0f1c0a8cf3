"""Sliding-mode control, eqs (17)-(42) and (51)-(57), in the one consistent sign convention.

    e = q - q_d,   q_r' = q_d' - lambda e,   s = e' + lambda e = q' - q_r'

On s = 0 the error decays as exp(-lambda t). The equivalent part is the nominal model along the
reference velocity q_r', not along q': then D s' = -(C + B) s + F + (robust part), F being the model
error, and V = 1/2 s^T D s is the Lyapunov function, eqs (32)-(42). The robust part has a minus
sign; the paper prints a plus sign, which belongs to s of the opposite sign.

By (42) V falls when K_i >= |F_i| + eta_i. The gain K is given, or it is derived from the
`uncertainty` that the nominal model is declared to have: K_i = max |F_i| + eta_i at every instant.

The integral surface, eqs (10), (24) and (25), in its stable form, holds the integral of the error:

    s = (d/dt + lambda)^2 int e dt = e' + 2 lambda e + lambda^2 int e dt = q' - q_r'
    q_r' = q_d' - 2 lambda e - lambda^2 int e dt,   q_r'' = q_d'' - 2 lambda e' - lambda^2 e

On s = 0 the error has the double pole -lambda; the surface as printed in (24) has an unstable one.
Inside the boundary layer a constant error of the model or a constant load moves s, but the
integral, not the error, makes up for it: s' = 0 holds for e = 0 alone.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, NamedTuple

import numpy as np

from controllers import recommended
from controllers.law import Gain, GainField, Law, ShareField, elapsed
from octarm.errors import OctarmError
from octarm.interfaces import Command, Measurement, NominalModel, Reference


class Surface(NamedTuple):
    """The sliding variable and the reference velocity behind it, each of shape (..., 2N).

    Attributes:
        s: e' + lambda e = q' - q_r' [m/s], [rad/s].
        v_r: q_r' = q_d' - lambda e [m/s], [rad/s].
        a_r: q_r'' = q_d'' - lambda e' [m/s^2], [rad/s^2].
    """

    s: np.ndarray
    v_r: np.ndarray
    a_r: np.ndarray


def saturation(s: np.ndarray, phi: Gain) -> np.ndarray:
    """sat(s / phi), eq (53), shape (..., 2N) [1]; where phi is 0 it is sgn(s), eq (22)."""
    share = s / np.maximum(phi, 1e-150)  # a smaller s than that is no motion
    return np.minimum(np.maximum(share, -1.0), 1.0)  # np.clip takes twice as long for one arm


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SlidingLaw(Law):
    """A law with a sliding surface: the model along q_r', and a robust part."""

    lambda_: Annotated[Gain, recommended.DECAY_RATE]

    def surface(self, measurement: Measurement, reference: Reference) -> Surface:
        """Eqs (17) and (18)."""
        e, e_dot = self.errors(measurement, reference)
        decay = self.lambda_ * e
        return Surface(
            s=e_dot + decay, v_r=reference.v - decay, a_r=reference.a - self.lambda_ * e_dot
        )

    def command(
        self,
        measurement: Measurement,
        surface: Surface,
        switching: np.ndarray,
        *,
        layer: Gain | None = None,
        **signals: np.ndarray,
    ) -> Command:
        """D^ q_r'' + (C^ + B^) q_r' + G^, eqs (28) and (55) corrected, and the robust part.

        The robust part `switching` has the shape (..., 2N) [N], [N m]; `layer`, the half width of
        the boundary layer, broadcasts to that [m/s], [rad/s]. The signals are s, the parts
        `equivalent` and `switching`, V = 1/2 s^T D^ s of shape (..., 1) [J], and those given.
        """
        s, (_, q, v) = surface.s, measurement
        equivalent = self.nominal.inverse_dynamics(q, v, surface.a_r, surface.v_r)
        V = self.nominal.kinetic_energy(q, s)[..., None]
        parts = {"s": s, "equivalent": equivalent, "switching": switching, "V": V}
        width = None if layer is None else np.asarray(layer)
        return Command(equivalent + switching, {**parts, **signals}, width)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SwitchingLaw(SlidingLaw):
    """A sliding mode whose switching gain is given, or else derived from an uncertainty."""

    K: Annotated[
        Gain | None, dataclasses.replace(recommended.SWITCHING_GAIN, replaced_by="uncertainty")
    ] = None
    K_v: Annotated[Gain, recommended.LINEAR_GAIN]
    uncertainty: Annotated[
        Gain | None,
        ShareField("share of the nominal model, see `largest_error`, from which K is derived", "1"),
    ] = None
    eta: Annotated[
        Gain | None, GainField("what a derived K has above the model error", "N, N m")
    ] = None

    def __post_init__(self) -> None:
        given = (self.K is not None) + (self.uncertainty is not None)
        if given != 1:
            raise OctarmError(
                f"{('neither', '', 'both')[given]} of K and uncertainty are given; the gain is "
                "either set, or derived from the uncertainty"
            )
        if self.eta is not None and self.uncertainty is None:
            raise OctarmError("eta is given without uncertainty; only a derived K has that part")
        if self.eta is None and self.uncertainty is not None:
            object.__setattr__(self, "eta", 0.25 * recommended.switching_gain(self.nominal))
        super().__post_init__()

    def switched(
        self,
        measurement: Measurement,
        surface: Surface,
        switch: np.ndarray,
        *,
        layer: Gain | None = None,
        **signals: np.ndarray,
    ) -> Command:
        """The command with the robust part -K switch - K_v s; K is a signal when it is derived.

        The switch, shape (..., 2N) [1], is sgn(s) or what takes its place. A derived K is
        max |F| + eta by eq (40).
        """
        gain = np.asarray(self.K)
        if self.uncertainty is not None:
            u, (_, q, v) = np.asarray(self.uncertainty), measurement
            F = self.nominal.largest_error(u, q, v, surface.a_r, surface.v_r)
            gain = np.asarray(self.eta) + F
            signals = {"K": gain, **signals}
        switching = -gain * switch - self.K_v * surface.s
        return self.command(measurement, surface, switching, layer=layer, **signals)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SlidingMode(SwitchingLaw):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sgn(s) - K_v s, eqs (22), (31), (37) corrected.

    When K is derived, the signals hold K and `reaching_bound`, the time within which s = 0 is
    reached [s], eqs (14) and (15).
    """

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        surface = self.surface(measurement, reference)
        command = self.switched(measurement, surface, np.sign(surface.s))
        if self.uncertainty is None:
            return command, state
        u, eta, V = np.asarray(self.uncertainty), np.asarray(self.eta), command.signals["V"]
        bound = reaching_time_bound(self.nominal, u, eta, measurement.q, V)
        return command._replace(signals={**command.signals, "reaching_bound": bound}), state


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class BoundaryLayer(SwitchingLaw):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sat(s / phi) - K_v s, eqs (51)-(57) corrected.

    Inside the layer |s| <= phi the switching is a linear term: no chattering, at the price of an
    error that only stays bounded. Eq (42) becomes V' <= -sum eta_i |s_i| + sum K_i phi_i / 4, and
    no time to reach s = 0 can be promised. With phi = 0 this is `SlidingMode`.
    """

    phi: Annotated[Gain, recommended.LAYER_WIDTH]

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        surface = self.surface(measurement, reference)
        switch = saturation(surface.s, self.phi)
        return self.switched(measurement, surface, switch, layer=self.phi), state


class IntegralState(NamedTuple):
    """What the controller remembers.

    Attributes:
        t: time of the last call [s].
        integral: int e dt, shape (..., 2N) [m s], [rad s].
    """

    t: float
    integral: np.ndarray


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class IntegralSlidingMode(SwitchingLaw):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sat(s / phi) - K_v s with the integral surface.

    The integral starts where s = 0, so that there is no reaching phase: the initial error decays
    with the double pole from the start, and leaves no integral behind that an overshoot has to
    undo. It gives way where |s| would exceed s_max, and stops where it would only ask for more
    force than the actuators have, see `Law.without_windup`.

    Here lambda is a double pole. The signals hold the `integral` as well.
    """

    phi: Annotated[Gain, recommended.LAYER_WIDTH]
    s_max: Annotated[
        Gain,
        GainField(
            "largest |s| that the integral leaves standing",
            "m/s, rad/s",
            lambda nominal: 5.0 * recommended.boundary_width(nominal),
            recommended.WIDTH,
        ),
    ]

    def __call__(
        self, state: IntegralState | None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, IntegralState]:
        e, e_dot = self.errors(measurement, reference)
        lambda_squared = self.lambda_ * self.lambda_
        proportional = e_dot + 2.0 * self.lambda_ * e
        if state is None:
            s, integral, dt = np.zeros_like(proportional), -proportional / lambda_squared, 0.0
        else:
            asked = proportional + lambda_squared * state.integral
            s = np.clip(asked, -self.s_max, self.s_max)
            integral = state.integral + (s - asked) / lambda_squared
            dt = elapsed(state.t, measurement.t)
        a_r = reference.a - 2.0 * self.lambda_ * e_dot - lambda_squared * e
        surface, switch = Surface(s, measurement.v - s, a_r), saturation(s, self.phi)
        command = self.switched(measurement, surface, switch, layer=self.phi, integral=integral)
        e = self.without_windup(measurement, command, e)
        return command, IntegralState(measurement.t, integral + e * dt)


def reaching_time_bound(
    nominal: NominalModel, uncertainty: np.ndarray, eta: np.ndarray, q: np.ndarray, V: np.ndarray
) -> np.ndarray:
    """Longest time until s = 0, eqs (14) and (15) for a vector, shape (..., 1) [s].

    By (42) V' <= -y with y = sum eta_i |s_i|. On the set of all s with the same y, the convex V =
    1/2 s^T D s is largest at a corner, where only one s_i differs from zero: V <= 1/2 L y^2 with L
    = max D_ii / eta_i^2. Hence V' <= -sqrt(2 V / L), and V is zero after sqrt(2 L V) at most; for
    one coordinate this is D |s| / eta.

    D is neither known nor constant. All its entries and V are sums over masses and inertias, hence
    at most 1 / (1 - u) times the nominal ones, u being the uncertainty. D_ii is the largest one for
    modules of these lengths. Only modules that lengthen on the way are not foreseen: the bound
    grows at most by the share by which they do. The bound is one of continuous time: under sampling
    the force is late, and s ends in the chattering about zero.
    """
    L = np.max(nominal.largest_inertia(q) / (eta * eta), axis=-1, keepdims=True)
    return np.sqrt(2.0 * L * V) / (1.0 - uncertainty)
