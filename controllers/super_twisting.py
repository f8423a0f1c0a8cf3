"""The super-twisting law: sliding mode with a continuous force.

    Q = D^ q_r'' + (C^ + B^) q_r' + G^ - k_1 sqrt|s| sgn(s) + w,   w' = -k_2 sgn(s)

The surface is that of eqs (17) and (18). What switches is the rate of w, not the force: w
integrates until it equals minus the model error, so that s = 0 and s' = 0 are held without
chattering. For one coordinate with the mass m, whose model error changes no faster than L, s and s'
reach zero in finite time with k_1 = 1.5 sqrt(m L) and k_2 = 1.1 L (Levant 1993; a strict Lyapunov
function: Moreno and Osorio 2012). Under sampling |s| stays of the order of the period squared,
where sgn(s) leaves the order of the period.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, NamedTuple

import numpy as np

from controllers import recommended
from controllers.law import Gain, GainField, elapsed
from controllers.sliding_mode import SlidingLaw
from octarm.interfaces import Command, Knob, Measurement, NominalModel, Reference


class SuperTwistingState(NamedTuple):
    """What the controller remembers.

    Attributes:
        t: time of the last call [s].
        w: the integrated part, shape (..., 2N) [N], [N m].
    """

    t: float
    w: np.ndarray


def rate_gain(nominal: NominalModel) -> np.ndarray:
    """Gain k_2, shape (..., 2N) [N/s], [N m/s]: 1.1 times the rate of the model error allowed for.

    That rate is 10 1/s, for the nominal arm, times the recommended K, which is above the model
    error itself.
    """
    return 1.1 * recommended.by_hand(nominal, "1/s", 10.0) * recommended.switching_gain(nominal)


def root_gain(nominal: NominalModel) -> np.ndarray:
    """Gain k_1 = 1.5 sqrt(m L), shape (..., 2N) [N/sqrt(m/s)], [N m/sqrt(rad/s)]."""
    return 1.5 * np.sqrt(recommended.apparent_mass(nominal) * rate_gain(nominal) / 1.1)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SuperTwisting(SlidingLaw):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - k_1 sqrt|s| sgn(s) - K_v s + w, w' = -k_2 sgn(s).

    w is kept within K: as the other switching gains it need not exceed the model error. It stops
    where it would only ask for more force than the actuators have, see `Law.without_windup`. It is
    part of the signal `switching`, and a signal of its own. V is that of the other sliding modes,
    although the proof needs another one.
    """

    K: Annotated[Gain, dataclasses.replace(recommended.SWITCHING_GAIN, meaning="largest |w|")]
    K_v: Annotated[Gain, recommended.LINEAR_GAIN]
    k_1: Annotated[
        Gain,
        GainField(
            "gain of the root",
            "N/sqrt(m/s), N m/sqrt(rad/s)",
            root_gain,
            Knob("k_1", apart=True),
            zero=True,
        ),
    ]
    k_2: Annotated[
        Gain, GainField("rate of w", "N/s, N m/s", rate_gain, Knob("k_2", apart=True), zero=True)
    ]

    def __call__(
        self, state: SuperTwistingState | None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, SuperTwistingState]:
        surface = self.surface(measurement, reference)
        s, sign = surface.s, np.sign(surface.s)
        if state is None:
            state = SuperTwistingState(measurement.t, np.zeros_like(s))
        w, dt = state.w, elapsed(state.t, measurement.t)
        switching = -self.k_1 * np.sqrt(np.abs(s)) * sign - self.K_v * s + w
        command = self.command(measurement, surface, switching, w=w)
        sign = self.without_windup(measurement, command, sign)
        advanced = np.clip(w - self.k_2 * sign * dt, -self.K, self.K)
        return command, SuperTwistingState(measurement.t, advanced)
