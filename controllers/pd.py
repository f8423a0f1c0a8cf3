"""Proportional-derivative control with compensation of gravity and springs."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np

from controllers.gains import Gain, GainField
from controllers.law import Law
from controllers.recommended import layer_slope
from octarm.interfaces import Command, Knob, Measurement, NominalModel, Reference


def position_gain(nominal: NominalModel) -> np.ndarray:
    """K_p, shape (..., 2N) [N/m], [N m/rad]: lambda = 15 1/s times the slope of a layer."""
    return 15.0 * layer_slope(nominal)


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

    K_p: Annotated[
        Gain, GainField("position gain", "N/m, N m/rad", position_gain, Knob("K_p", apart=True))
    ]
    K_d: Annotated[
        Gain, GainField("velocity gain", "N s/m, N m s/rad", layer_slope, Knob("K_d", apart=True))
    ]

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        self.check(measurement, reference)
        e, e_dot = measurement.q - reference.q, measurement.v - reference.v
        rest = np.zeros_like(e)
        equivalent = self.nominal.inverse_dynamics(reference.q, rest, rest)
        feedback = -self.K_p * e - self.K_d * e_dot
        s = e_dot + self.K_p / self.K_d * e
        signals = {"s": s, "equivalent": equivalent, "feedback": feedback}
        return Command(equivalent + feedback, signals), state
