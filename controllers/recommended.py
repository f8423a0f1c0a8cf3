"""The gains that several laws share, and the values that all laws start from.

A gain has one meaning in all laws. The values were set by hand for the nominal arm at 2 kHz and are
written down in SI, as they are for that arm. What is meant by them is their numbers in the scales
of that arm, `SET_FOR`: another arm has the same numbers in its own scales.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from controllers.law import GainField
from controllers.scaling import GainScales, along, unit
from octarm.interfaces import Knob, NominalModel

SET_FOR = GainScales(  # the arm of models/octarm.xml
    scale=np.array([0.12, 0.12, 0.12, 1.0, 1.0, 1.0]),  # [m], [rad]
    time_scale=np.array(0.006505611964237445),  # [s]
    force_scale=np.array(  # [N], [N m]
        [
            *(850.6015885678722, 386.63708571266943, 315.0376253955085),
            *(112.65520144398702, 23.21994558532032, 8.019102622156883),
        ]
    ),
)


def by_hand(nominal: NominalModel, units: str, first: float, *others: float) -> np.ndarray:
    """Values set by hand for the arm `SET_FOR` [SI], scaled to a nominal model [SI].

    They broadcast to (..., 2N). One value is for all coordinates, two are for slides and bends,
    others for one coordinate each; the units are those of a `GainField`.
    """
    listed = np.array([first, *others] if others else first)
    numbers = along(listed, len(SET_FOR.scale) // 2, len(SET_FOR.scale)) / unit(units, SET_FOR)
    return along(numbers, nominal.modules, nominal.coordinates) * unit(units, nominal)


@dataclasses.dataclass(frozen=True, init=False)
class HandSet:
    """Values set by hand, see `by_hand`, as what a `GainField` recommends.

    Attributes:
        units: those of a `GainField`.
        values: one for all coordinates, two for slides and bends, or one for each.
    """

    units: str
    values: tuple[float, ...]

    def __init__(self, units: str, *values: float) -> None:
        """Values in these units."""
        object.__setattr__(self, "units", units)
        object.__setattr__(self, "values", values)

    def __call__(self, nominal: NominalModel) -> np.ndarray:
        """What they are for a nominal model, broadcasts to (..., 2N), in their units."""
        return by_hand(nominal, self.units, *self.values)


def by_unit(nominal: NominalModel, m: float, rad: float) -> np.ndarray:
    """One value for each slide and another one for each bend, shape (2N,) [m], [rad]."""
    return np.array([{"m": m, "rad": rad}[unit] for unit in nominal.units])


def apparent_mass(nominal: NominalModel) -> np.ndarray:
    """What each coordinate feels when the others are free: 1 / [D^-1]_jj, shape (..., 2N)."""
    return nominal.force_scale * nominal.time_scale * nominal.time_scale / nominal.scale


# Of a nominal model, broadcast to (..., 2N), in the units that are named.
boundary_width = HandSet("m/s, rad/s", 0.05, 0.8)  # phi
decay_rate = HandSet("1/s", 15.0)  # lambda: about the nominal arm's lowest mode
# K is above the largest model error of the nominal arm along the default sine when the nominal
# model is at -30 % or +30 %: (1.15, 0.71, 0.33) N and (0.28, 0.15, 0.001) N m.
switching_gain = HandSet("N, N m", 1.6, 1.0, 0.8, 0.4, 0.25, 0.03)
linear_gain = HandSet("N s/m, N m s/rad", 10.0, 10.0, 10.0, 0.15, 0.05, 0.01)  # K_v


def layer_slope(nominal: NominalModel) -> np.ndarray:
    """K_v + K / phi, the slope of the recommended layer, shape (..., 2N) [N s/m], [N m s/rad]."""
    return linear_gain(nominal) + switching_gain(nominal) / boundary_width(nominal)


# All that says how large an |s| is: the hand-set values are multiples of one width.
WIDTH = Knob("width", apart=True)

DECAY_RATE = GainField("decay rate of the error on the surface", "1/s", decay_rate, Knob("lambda"))
SWITCHING_GAIN = GainField(
    "switching gain", "N, N m", switching_gain, Knob("K", apart=True), zero=True
)
LINEAR_GAIN = GainField(
    "gain of the linear term", "N s/m, N m s/rad", linear_gain, Knob("K_v"), zero=True
)
LAYER_WIDTH = GainField(
    "half width of the boundary layer", "m/s, rad/s", boundary_width, WIDTH, zero=True
)
