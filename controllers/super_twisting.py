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
from collections.abc import Callable, Mapping
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from controllers.gains import Gain, apparent_mass, as_gain, switching_gain
from controllers.shapes import elapsed
from controllers.sliding_mode import equivalent_force
from octarm.arm.lagrange import kinetic_energy
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Command, Measurement, Reference


class SuperTwistingState(NamedTuple):
    """What the controller remembers.

    Attributes:
        t: time of the last call [s].
        w: the integrated part, shape (..., 2N) [N], [N m].
    """

    t: float
    w: np.ndarray


def rate_gain(nominal: ArmParameters) -> np.ndarray:
    """Gain k_2, shape (..., 2N) [N/s], [N m/s]: 1.1 times the rate of the model error allowed for.

    That rate is 10 1/s times the recommended K, which is above the model error itself.
    """
    return 1.1 * 10.0 * switching_gain(nominal)


def root_gain(nominal: ArmParameters) -> np.ndarray:
    """Gain k_1 = 1.5 sqrt(m L), shape (..., 2N) [N/sqrt(m/s)], [N m/sqrt(rad/s)]."""
    return 1.5 * np.sqrt(apparent_mass(nominal) * rate_gain(nominal) / 1.1)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SuperTwisting:
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - k_1 sqrt|s| sgn(s) - K_v s + w, w' = -k_2 sgn(s).

    w is kept within K: as the other switching gains it need not exceed the model error, and does
    not wind up while an actuator is at its limit.

    Signals: s, the parts `equivalent` and `switching`, the latter with w, and w alone;
    V = 1/2 s^T D^ s [J] as with the other sliding modes, although the proof needs another one.

    Attributes:
        nominal: the model that the controller believes.
        lambda_: decay rate of the error on the surface, broadcasts to (..., 2N) [1/s].
        k_1: gain of the root, broadcasts to (..., 2N) [N/sqrt(m/s)], [N m/sqrt(rad/s)].
        k_2: rate of w, broadcasts to (..., 2N) [N/s], [N m/s].
        K: largest |w|, broadcasts to (..., 2N) [N], [N m].
        K_v: linear gain, broadcasts to (..., 2N) [N s/m], [N m s/rad].

    Raises:
        ValueError: for a gain that is negative, not finite, or has a wrong shape.
    """

    recommended: ClassVar[Mapping[str, Callable[[ArmParameters], npt.ArrayLike]]] = {
        "k_1": root_gain,
        "k_2": rate_gain,
    }

    nominal: ArmParameters
    lambda_: Gain
    k_1: Gain
    k_2: Gain
    K: Gain
    K_v: Gain

    def __post_init__(self) -> None:
        object.__setattr__(self, "lambda_", as_gain("lambda", self.lambda_, self.nominal))
        for name in ("k_1", "k_2", "K", "K_v"):
            gain = as_gain(name, getattr(self, name), self.nominal, zero_allowed=True)
            object.__setattr__(self, name, gain)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        """Nothing is integrated before the first call."""
        del batch_shape

    def __call__(
        self, state: SuperTwistingState | None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, SuperTwistingState]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        s, equivalent = equivalent_force(self.nominal, self.lambda_, measurement, reference)
        sign = np.sign(s)
        if state is None:
            state = SuperTwistingState(measurement.t, np.zeros_like(s))
        w, dt = state.w, elapsed(state.t, measurement.t)
        switching = -self.k_1 * np.sqrt(np.abs(s)) * sign - self.K_v * s + w
        V = kinetic_energy(self.nominal, measurement.q, s)[..., None]
        signals = {"s": s, "equivalent": equivalent, "switching": switching, "w": w, "V": V}
        advanced = np.clip(w - self.k_2 * sign * dt, -self.K, self.K)
        state = SuperTwistingState(measurement.t, advanced)
        return Command(equivalent + switching, signals), state
