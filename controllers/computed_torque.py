"""Computed torque: feedback linearisation with the nominal model."""

from __future__ import annotations

import dataclasses

from controllers.pd import ErrorFeedback
from controllers.shapes import check_shapes
from octarm.arm.lagrange import inverse_dynamics
from octarm.interfaces import Command, Measurement, Reference


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ComputedTorque(ErrorFeedback):
    """Q = D^ (q_d'' - K_d e' - K_p e) + (C^ + B^) q' + G^, with e = q - q_d.

    With an exact model the error obeys e'' + K_d e' + K_p e = 0.

    Signals: `equivalent` D^ q_d'' + (C^ + B^) q' + G^, and `feedback` -D^ (K_d e' + K_p e) =
    -D^ K_d s with s = e' + (K_p / K_d) e.

    Attributes:
        nominal: the model that the controller believes.
        K_p: position gain, broadcasts to (..., 2N) [1/s^2].
        K_d: velocity gain, broadcasts to (..., 2N) [1/s].

    Raises:
        ValueError: for a gain that is not positive or has a wrong shape.
    """

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        check_shapes(self.nominal, measurement, reference)
        q, v = measurement.q, measurement.v
        e, e_dot = q - reference.q, v - reference.v
        equivalent = inverse_dynamics(self.nominal, q, v, reference.a)
        a = reference.a - self.K_d * e_dot - self.K_p * e
        force = inverse_dynamics(self.nominal, q, v, a)
        s = e_dot + self.K_p / self.K_d * e
        signals = {"s": s, "equivalent": equivalent, "feedback": force - equivalent}
        return Command(force, signals), state
