"""The gains that several laws share, and the values that all laws start from.

A gain has one meaning in all laws. The values are hand-set for the nominal arm at 2 kHz; those of
arms with another number of modules scale with mass and size.
"""

from __future__ import annotations

import numpy as np

from controllers.gains import GainField
from octarm.interfaces import Knob, NominalModel


def by_unit(nominal: NominalModel, m: float, rad: float) -> np.ndarray:
    """One value for each slide and another one for each bend, shape (2N,) [m], [rad]."""
    return np.array([{"m": m, "rad": rad}[unit] for unit in nominal.units])


def hand_set(nominal: NominalModel, *values: float) -> np.ndarray | None:
    """The values, shape (2N,), for an arm of as many coordinates; None for another one."""
    return np.array(values) if len(values) == nominal.coordinates else None


def apparent_mass(nominal: NominalModel) -> np.ndarray:
    """What each coordinate feels when the others are free: 1 / [D^-1]_jj, shape (..., 2N)."""
    inverse = np.linalg.inv(nominal.mass_matrix(nominal.equilibrium()))
    return 1.0 / np.diagonal(inverse, axis1=-2, axis2=-1)


def boundary_width(nominal: NominalModel) -> np.ndarray:
    """Boundary layer phi, 0.05 m/s on slides and 0.8 rad/s on bends, shape (2N,)."""
    return by_unit(nominal, 0.05, 0.8)


def switching_gain(nominal: NominalModel) -> np.ndarray:
    """Switching gain K, shape (..., 2N) [N], [N m].

    For three modules hand-set values, above the largest model error along the default sine when
    the nominal model is at -30 % or +30 %: (1.15, 0.71, 0.33) N and (0.28, 0.15, 0.001) N m. For
    other arms K = 300 1/s phi_j / [D^-1]_jj at the equilibrium, the bandwidth that the hand-set
    value of theta2 has; it scales with mass and size.
    """
    values = hand_set(nominal, 1.6, 1.0, 0.8, 0.4, 0.25, 0.03)
    if values is not None:
        return values
    return 300.0 * boundary_width(nominal) * apparent_mass(nominal)


def reaching_gain(nominal: NominalModel) -> np.ndarray:
    """Reaching gain eta, shape (..., 2N) [N], [N m]: a quarter of the recommended K."""
    return 0.25 * switching_gain(nominal)


def linear_gain(nominal: NominalModel) -> np.ndarray:
    """Gain K_v of the linear term, shape (..., 2N) [N s/m], [N m s/rad]; see `switching_gain`."""
    values = hand_set(nominal, 10.0, 10.0, 10.0, 0.15, 0.05, 0.01)
    return 30.0 * apparent_mass(nominal) if values is None else values


def layer_slope(nominal: NominalModel) -> np.ndarray:
    """K_v + K / phi, the slope of the recommended layer, shape (..., 2N) [N s/m], [N m s/rad]."""
    return linear_gain(nominal) + switching_gain(nominal) / boundary_width(nominal)


# All that says how large an |s| is: the hand-set values are multiples of one width.
WIDTH = Knob("width", apart=True)

# About the arm's lowest mode.
DECAY_RATE = GainField(
    "decay rate of the error on the surface", "1/s", 15.0, Knob("lambda", low=0.25, high=4.0)
)
SWITCHING_GAIN = GainField(
    "switching gain", "N, N m", switching_gain, Knob("K", apart=True), zero=True
)
LINEAR_GAIN = GainField(
    "gain of the linear term", "N s/m, N m s/rad", linear_gain, Knob("K_v"), zero=True
)
LAYER_WIDTH = GainField(
    "half width of the boundary layer", "m/s, rad/s", boundary_width, WIDTH, zero=True
)
