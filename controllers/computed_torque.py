"""Computed torque: feedback linearisation with the nominal model."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from controllers.gains import Gain, GainField
from controllers.law import Law
from octarm.interfaces import Command, Knob, Measurement, Reference


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ComputedTorque(Law):
    """Q = D^ (q_d'' - K_d e' - K_p e) + (C^ + B^) q' + G^, with e = q - q_d.

    With an exact model the error obeys e'' + K_d e' + K_p e = 0.

    Signals: `equivalent` D^ q_d'' + (C^ + B^) q' + G^, and `feedback` -D^ (K_d e' + K_p e) =
    -D^ K_d s with s = e' + (K_p / K_d) e.
    """

    # Critical damping at 80 rad/s. A nominal model that is 15 % too stiff cancels too much of the
    # springs: the arm then needs K_p above 0.15 / 1.3 of its highest mode's (154 rad/s)^2.
    K_p: Annotated[Gain, GainField("position gain", "1/s^2", 6400.0, Knob("K_p", apart=True))]
    K_d: Annotated[Gain, GainField("velocity gain", "1/s", 160.0, Knob("K_d", apart=True))]

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        self.check(measurement, reference)
        q, v = measurement.q, measurement.v
        e, e_dot = q - reference.q, v - reference.v
        equivalent = self.nominal.inverse_dynamics(q, v, reference.a)
        a = reference.a - self.K_d * e_dot - self.K_p * e
        force = self.nominal.inverse_dynamics(q, v, a)
        s = e_dot + self.K_p / self.K_d * e
        signals = {"s": s, "equivalent": equivalent, "feedback": force - equivalent}
        return Command(force, signals), state
