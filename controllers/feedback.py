"""Linear feedback of the error with the nominal model: PD control, and computed torque."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np

from controllers.law import Gain, GainField, Law
from controllers.recommended import HandSet, decay_rate, layer_slope
from octarm.interfaces import Command, Knob, Measurement, Reference


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ProportionalDerivative(Law):
    """Q = G^(q_d) - K_p e - K_d e', with e = q - q_d.

    G of eq (5) holds the arm against its weight and its springs. It is taken where the arm shall
    be: the springs of the arm then go on pulling towards q_d, and add to K_p. Taken where the arm
    is, G^(q) would cancel the springs, and a model that is too stiff would cancel more than there
    is.

    Signals: `equivalent` G^(q_d), and `feedback` -K_p e - K_d e' = -K_d s with
    s = e' + (K_p / K_d) e.
    """

    # lambda times the slope of a layer.
    K_p: Annotated[
        Gain,
        GainField(
            "position gain",
            "N/m, N m/rad",
            lambda nominal: decay_rate(nominal) * layer_slope(nominal),
            Knob("K_p", apart=True),
        ),
    ]
    K_d: Annotated[
        Gain, GainField("velocity gain", "N s/m, N m s/rad", layer_slope, Knob("K_d", apart=True))
    ]

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        e, e_dot = self.errors(measurement, reference)
        rest = np.zeros_like(e)
        equivalent = self.nominal.inverse_dynamics(reference.q, rest, rest)
        feedback = -self.K_p * e - self.K_d * e_dot
        s = e_dot + self.K_p / self.K_d * e
        signals = {"s": s, "equivalent": equivalent, "feedback": feedback}
        return Command(equivalent + feedback, signals), state


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ComputedTorque(Law):
    """Q = D^ (q_d'' - K_d e' - K_p e) + (C^ + B^) q' + G^, with e = q - q_d.

    With an exact model the error obeys e'' + K_d e' + K_p e = 0.

    Signals: `equivalent` D^ q_d'' + (C^ + B^) q' + G^, and `feedback` -D^ (K_d e' + K_p e) =
    -D^ K_d s with s = e' + (K_p / K_d) e.
    """

    # Critical damping at 80 rad/s. A nominal model that is 15 % too stiff cancels too much of the
    # springs: the arm then needs K_p above 0.15 / 1.3 of its highest mode's (154 rad/s)^2.
    K_p: Annotated[
        Gain,
        GainField("position gain", "1/s^2", HandSet("1/s^2", 6400.0), Knob("K_p", apart=True)),
    ]
    K_d: Annotated[
        Gain, GainField("velocity gain", "1/s", HandSet("1/s", 160.0), Knob("K_d", apart=True))
    ]

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        e, e_dot = self.errors(measurement, reference)
        q, v = measurement.q, measurement.v
        equivalent = self.nominal.inverse_dynamics(q, v, reference.a)
        a = reference.a - self.K_d * e_dot - self.K_p * e
        force = self.nominal.inverse_dynamics(q, v, a)
        s = e_dot + self.K_p / self.K_d * e
        signals = {"s": s, "equivalent": equivalent, "feedback": force - equivalent}
        return Command(force, signals), state
