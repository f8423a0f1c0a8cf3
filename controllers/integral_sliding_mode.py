"""Sliding mode with an integral surface, eqs (10), (24) and (25), in its stable form.

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

from controllers.gains import Gain, GainField
from controllers.law import elapsed
from controllers.recommended import LAYER_WIDTH, WIDTH, boundary_width
from controllers.sliding_mode import Surface, SwitchingLaw, saturation
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
class IntegralSlidingMode(SwitchingLaw):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sat(s / phi) - K_v s with the integral surface.

    The integral starts where s = 0, so that there is no reaching phase: the initial error decays
    with the double pole from the start, and leaves no integral behind that an overshoot has to
    undo. It gives way where |s| would exceed s_max, for instance while an actuator is at its
    limit: |s| is then s_max, and nothing winds up.

    Here lambda is a double pole. The signals hold the `integral` as well.
    """

    phi: Annotated[Gain, LAYER_WIDTH]
    s_max: Annotated[
        Gain,
        GainField(
            "largest |s| that the integral leaves standing",
            "m/s, rad/s",
            lambda nominal: 5.0 * boundary_width(nominal),
            WIDTH,
        ),
    ]

    def __call__(
        self, state: IntegralState | None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, IntegralState]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        self.check(measurement, reference)
        e, e_dot = measurement.q - reference.q, measurement.v - reference.v
        s, integral = self._sliding_variable(state, e, e_dot)
        surface = Surface(
            s=s,
            v_r=measurement.v - s,
            a_r=reference.a - 2.0 * self.lambda_ * e_dot - self.lambda_ * self.lambda_ * e,
        )
        switch = saturation(s, self.phi)
        command = self.switched(measurement, surface, switch, layer=self.phi, integral=integral)
        dt = 0.0 if state is None else elapsed(state.t, measurement.t)
        return command, IntegralState(measurement.t, integral + e * dt)

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
