"""Sliding mode with an integral surface, eqs (10), (24) and (25), in its stable form.

    s = (d/dt + lambda)^2 int e dt = e' + 2 lambda e + lambda^2 int e dt = q' - q_r'
    q_r' = q_d' - 2 lambda e - lambda^2 int e dt,   q_r'' = q_d'' - 2 lambda e' - lambda^2 e

On s = 0 the error has the double pole -lambda; the surface as printed in (24) has an unstable one.
Inside the boundary layer a constant error of the model or a constant load moves s, but the
integral, not the error, makes up for it: s' = 0 holds for e = 0 alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from controllers.gains import Gain, as_gain, boundary_width
from controllers.shapes import check_shapes, elapsed
from controllers.sliding_mode import SlidingGains, Surface, saturation
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Command, Measurement, Reference


class IntegralState(NamedTuple):
    """What the controller remembers.

    Attributes:
        t: time of the last call [s].
        integral: int e dt, shape (..., 2N) [m s], [rad s].
    """

    t: float
    integral: np.ndarray


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class IntegralSlidingMode(SlidingGains):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sat(s / phi) - K_v s with the integral surface.

    The integral starts where s = 0, so that there is no reaching phase: the initial error decays
    with the double pole from the start, and leaves no integral behind that an overshoot has to
    undo. It gives way where |s| would exceed s_max, for instance while an actuator is at its
    limit: |s| is then s_max, and nothing winds up.

    For the other gains see `SlidingGains`; lambda is a double pole. Signals: s, the parts
    `equivalent` and `switching`, `integral`, V = 1/2 s^T D^ s [J], and K when it is derived.

    Attributes:
        phi: half width of the boundary layer, 0 for sgn(s), broadcasts to (..., 2N) [m/s], [rad/s].
        s_max: largest |s| that the integral leaves standing, broadcasts to (..., 2N) [m/s],
            [rad/s].
    """

    recommended: ClassVar[Mapping[str, Callable[[ArmParameters], npt.ArrayLike]]] = {
        "s_max": lambda nominal: 5.0 * boundary_width(nominal),
    }

    phi: Gain
    s_max: Gain

    def __post_init__(self) -> None:
        super().__post_init__()
        phi = as_gain("phi", self.phi, self.nominal, zero_allowed=True)
        object.__setattr__(self, "phi", phi)
        object.__setattr__(self, "s_max", as_gain("s_max", self.s_max, self.nominal))

    def __call__(
        self, state: IntegralState | None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, IntegralState]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        check_shapes(self.nominal, measurement, reference)
        e, e_dot = measurement.q - reference.q, measurement.v - reference.v
        s, integral = self._sliding_variable(state, e, e_dot)
        surface = Surface(
            s=s,
            v_r=measurement.v - s,
            a_r=reference.a - 2.0 * self.lambda_ * e_dot - self.lambda_ * self.lambda_ * e,
        )
        force, signals, _ = self._command(measurement, surface, saturation(s, self.phi))
        dt = 0.0 if state is None else elapsed(state.t, measurement.t)
        advanced = IntegralState(measurement.t, integral + e * dt)
        return Command(force, {**signals, "integral": integral}), advanced

    def _sliding_variable(
        self, state: IntegralState | None, e: np.ndarray, e_dot: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Eq (24) with + lambda^2, within s_max, and the integral that belongs to it."""
        lambda_squared = self.lambda_ * self.lambda_
        proportional = e_dot + 2.0 * self.lambda_ * e
        if state is None:
            return np.zeros_like(proportional), -proportional / lambda_squared
        s = proportional + lambda_squared * state.integral
        held = np.clip(s, -self.s_max, self.s_max)
        return held, state.integral + (held - s) / lambda_squared
