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

from controllers.law import Gain, GainField, elapsed
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
    undo. It gives way where |s| would exceed s_max, and stops where it would only ask for more
    force than the actuators have, see `Law.without_windup`.

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
