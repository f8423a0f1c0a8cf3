"""Sliding-mode control, eqs (17)-(31) and (51)-(57), in the one consistent sign convention.

    e = q - q_d,   q_r' = q_d' - lambda e,   s = e' + lambda e = q' - q_r'

On s = 0 the error decays as exp(-lambda t). The equivalent part is the nominal model along the
reference velocity q_r', not along q': then D s' = -C s - B s + (model error) - (robust part), and
V = 1/2 s^T D s is the Lyapunov function, eqs (32)-(42). The robust part has a minus sign; the paper
prints a plus sign, which belongs to s of the opposite sign.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from controllers.gains import Gain, as_gain
from octarm.interfaces import Command, Measurement, Reference
from octarm.lagrange import inverse_dynamics
from octarm.parameters import ArmParameters


class Surface(NamedTuple):
    """The sliding variable and the reference velocity behind it, each of shape (..., 2N).

    Attributes:
        s: e' + lambda e [m/s], [rad/s].
        v_r: q_r' = q_d' - lambda e [m/s], [rad/s].
        a_r: q_r'' = q_d'' - lambda e' [m/s^2], [rad/s^2].
    """

    s: np.ndarray
    v_r: np.ndarray
    a_r: np.ndarray


def sliding_surface(lambda_: Gain, measurement: Measurement, reference: Reference) -> Surface:
    """Eqs (17) and (18)."""
    e, e_dot = measurement.q - reference.q, measurement.v - reference.v
    return Surface(
        s=e_dot + lambda_ * e,
        v_r=reference.v - lambda_ * e,
        a_r=reference.a - lambda_ * e_dot,
    )


def equivalent_force(
    nominal: ArmParameters, lambda_: Gain, measurement: Measurement, reference: Reference
) -> tuple[np.ndarray, np.ndarray]:
    """The sliding variable s and D^ q_r'' + (C^ + B^) q_r' + G^, each of shape (..., 2N)."""
    s, v_r, a_r = sliding_surface(lambda_, measurement, reference)
    return s, inverse_dynamics(nominal, measurement.q, measurement.v, a_r, v_r)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SlidingMode:
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sgn(s) - K_v s, eqs (22), (31), (37) corrected.

    Attributes:
        nominal: the model that the controller believes.
        lambda_: decay rate of the error on the surface, broadcasts to (..., 2N) [1/s].
        K: switching gain, above the model error by eq (40), broadcasts to (..., 2N) [N], [N m].
        K_v: linear gain, broadcasts to (..., 2N) [N s/m], [N m s/rad].

    Raises:
        ValueError: for a gain that is negative, not finite, or has a wrong shape.
    """

    nominal: ArmParameters
    lambda_: Gain
    K: Gain
    K_v: Gain

    def __post_init__(self) -> None:
        _check_gains(self)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        """There is nothing to remember."""
        del batch_shape

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        s, equivalent = equivalent_force(self.nominal, self.lambda_, measurement, reference)
        switching = -self.K * np.sign(s) - self.K_v * s
        return _command(s, equivalent, switching), state


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class BoundaryLayer:
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K sat(s / phi) - K_v s, eqs (51)-(57) corrected.

    Inside the layer |s| <= phi the switching is a linear term: no chattering, at the price of an
    error that only stays bounded.

    Attributes:
        nominal: the model that the controller believes.
        lambda_: decay rate of the error on the surface, broadcasts to (..., 2N) [1/s].
        K: switching gain, above the model error by eq (40), broadcasts to (..., 2N) [N], [N m].
        K_v: linear gain, broadcasts to (..., 2N) [N s/m], [N m s/rad].
        phi: half width of the boundary layer, broadcasts to (..., 2N) [m/s], [rad/s].

    Raises:
        ValueError: for a gain that is negative, not finite, or has a wrong shape.
    """

    nominal: ArmParameters
    lambda_: Gain
    K: Gain
    K_v: Gain
    phi: Gain

    def __post_init__(self) -> None:
        _check_gains(self)
        object.__setattr__(self, "phi", as_gain("phi", self.phi, self.nominal))

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        """There is nothing to remember."""
        del batch_shape

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        s, equivalent = equivalent_force(self.nominal, self.lambda_, measurement, reference)
        switching = -self.K * np.clip(s / self.phi, -1.0, 1.0) - self.K_v * s
        return _command(s, equivalent, switching), state


def _check_gains(controller: SlidingMode | BoundaryLayer) -> None:
    """Makes the gains read-only arrays; raises ValueError for an invalid one."""
    nominal = controller.nominal
    gains = {
        "lambda_": as_gain("lambda", controller.lambda_, nominal),
        "K": as_gain("K", controller.K, nominal, zero_allowed=True),
        "K_v": as_gain("K_v", controller.K_v, nominal, zero_allowed=True),
    }
    for name, gain in gains.items():
        object.__setattr__(controller, name, gain)


def _command(s: np.ndarray, equivalent: np.ndarray, switching: np.ndarray) -> Command:
    return Command(
        equivalent + switching, {"s": s, "equivalent": equivalent, "switching": switching}
    )
