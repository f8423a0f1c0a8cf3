"""Checking gains, and the values that the controllers start from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from octarm.arm.lagrange import equilibrium, mass_matrix
from octarm.arm.parameters import ArmParameters
from octarm.arrays import read_only
from octarm.errors import OctarmError

Gain = np.ndarray | float


def as_gain(
    name: str,
    value: npt.ArrayLike,
    nominal: ArmParameters,
    *,
    zero_allowed: bool = False,
    unbounded: bool = False,
) -> np.ndarray:
    """A gain as a read-only float array that broadcasts to shape (..., 2N).

    Args:
        name: of the gain, for errors.
        value: a number, or an array of shape (..., 1) or (..., 2N).
        nominal: the arm that says what N is.
        zero_allowed: whether it may be 0.
        unbounded: whether it may be infinite.

    Raises:
        ValueError: if it is not finite, not positive, or has neither one value nor 2N of them.
    """
    gain = read_only(name, value, unbounded=unbounded)
    if gain.ndim and gain.shape[-1] not in (1, nominal.coordinates):
        raise OctarmError(
            f"{name} has {gain.shape[-1]} values; it needs 1 or {nominal.coordinates}, one for "
            "each coordinate"
        )
    good = gain >= 0.0 if zero_allowed else gain > 0.0
    if not np.all(good):
        allowed = "at least 0" if zero_allowed else "above 0"
        raise OctarmError(f"{name} holds {gain[~good].flat[0]:g}; it must be {allowed}")
    return gain


def as_share(name: str, value: npt.ArrayLike) -> np.ndarray:
    """A share below 1, one number an arm, as a read-only array of shape () or (..., 1).

    Raises:
        ValueError: if it is not in [0, 1), or there are several numbers an arm.
    """
    share = read_only(name, value)
    if share.ndim and share.shape[-1] != 1:
        raise OctarmError(f"{name} has {share.shape[-1]} values; it is one number an arm")
    good = (share >= 0.0) & (share < 1.0)
    if not np.all(good):
        raise OctarmError(f"{name} holds {share[~good].flat[0]:g}; it must be at least 0, below 1")
    return share


def boundary_width(nominal: ArmParameters) -> np.ndarray:
    """Boundary layer phi, 0.05 m/s on slides and 0.8 rad/s on bends, shape (2N,)."""
    return np.repeat([0.05, 0.8], nominal.modules)


def switching_gain(nominal: ArmParameters) -> np.ndarray:
    """Switching gain K, shape (..., 2N) [N], [N m].

    For three modules hand-set values, above the largest model error along the default sine when
    the nominal model is at -30 % or +30 %: (1.15, 0.71, 0.33) N and (0.28, 0.15, 0.001) N m. For
    other arms K = 300 1/s phi_j / [D^-1]_jj at the equilibrium, the bandwidth that the hand-set
    value of theta2 has; it scales with mass and size.
    """
    hand_set = np.array([1.6, 1.0, 0.8, 0.4, 0.25, 0.03])
    if hand_set.size == nominal.coordinates:
        return hand_set
    return 300.0 * boundary_width(nominal) * apparent_mass(nominal)


def reaching_gain(nominal: ArmParameters) -> np.ndarray:
    """Reaching gain eta, shape (..., 2N) [N], [N m]: a quarter of the recommended K."""
    return 0.25 * switching_gain(nominal)


def linear_gain(nominal: ArmParameters) -> np.ndarray:
    """Gain K_v of the linear term, shape (..., 2N) [N s/m], [N m s/rad]; see `switching_gain`."""
    hand_set = np.array([10.0, 10.0, 10.0, 0.15, 0.05, 0.01])
    if hand_set.size == nominal.coordinates:
        return hand_set
    return 30.0 * apparent_mass(nominal)


def layer_slope(nominal: ArmParameters) -> np.ndarray:
    """K_v + K / phi, the slope of the recommended boundary layer, shape (..., 2N).

    In the units of `linear_gain`.
    """
    return linear_gain(nominal) + switching_gain(nominal) / boundary_width(nominal)


def apparent_mass(nominal: ArmParameters) -> np.ndarray:
    """What each coordinate feels when the others are free: 1 / [D^-1]_jj, shape (..., 2N)."""
    inverse = np.linalg.inv(mass_matrix(nominal, equilibrium(nominal)))
    return 1.0 / np.diagonal(inverse, axis1=-2, axis2=-1)


# Gains have one meaning in all controllers; these are hand-set for the nominal arm at 2 kHz.
RECOMMENDED: dict[str, Callable[[ArmParameters], npt.ArrayLike]] = {
    "lambda_": lambda nominal: 15.0,  # [1/s], about the arm's lowest mode
    "K": switching_gain,
    "K_v": linear_gain,
    "phi": boundary_width,
    # Critical damping at 80 rad/s. A nominal model that is 15 % too stiff cancels too much of the
    # springs: the arm then needs K_p above 0.15 / 1.3 of its highest mode's (154 rad/s)^2.
    "K_p": lambda nominal: 6400.0,  # [1/s^2]
    "K_d": lambda nominal: 160.0,  # [1/s]
}
