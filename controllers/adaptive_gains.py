"""The gains of the adaptive fuzzy controllers, and the values they start from."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np

from controllers.gains import Gain, GainField, RuleField, Switch
from controllers.recommended import (
    LAYER_WIDTH,
    LINEAR_GAIN,
    WIDTH,
    boundary_width,
    by_unit,
    hand_set,
    switching_gain,
)
from controllers.sliding_mode import SlidingLaw
from octarm.errors import OctarmError
from octarm.interfaces import Knob, NominalModel


def force_scale(nominal: NominalModel) -> np.ndarray:
    """F, about what theta may have to be, shape (..., 2N) [N], [N m]: the unit it adapts in.

    1 N and 0.1 N m for three modules. For other arms half the switching gain, which scales with
    mass and size.
    """
    if nominal.modules == 3:
        return by_unit(nominal, 1.0, 0.1)
    return 0.5 * switching_gain(nominal)


def consequent_bound(nominal: NominalModel) -> np.ndarray:
    """theta_max, shape (..., 2N) [N], [N m]: hand-set for three modules, else `switching_gain`.

    It is what sampling allows. With all theta at their bounds and the premises as they start, the
    slope of f^ at s = 0 is 3.24 theta_max / scale. With a control period dt, the product
    dt [D^-1]_jj (K_v + E_max / phi + 3.24 theta_max / scale) should stay below about 0.6.
    """
    values = hand_set(nominal, 1.0, 1.0, 1.0, 0.6, 0.25, 0.04)
    return switching_gain(nominal) if values is None else values


def compensation_bound(nominal: NominalModel) -> np.ndarray:
    """E_max, shape (..., 2N) [N], [N m]: about 0.6 `consequent_bound`; see there."""
    values = hand_set(nominal, 0.6, 0.6, 0.6, 0.3, 0.15, 0.02)
    return 0.6 * switching_gain(nominal) if values is None else values


def compensation_rate(nominal: NominalModel) -> np.ndarray:
    """eta1, shape (..., 2N) [N/m], [N m/rad], from (E / F)' = 5 |z| with z = s / scale."""
    return 5.0 * force_scale(nominal) / boundary_width(nominal)


def consequent_rate(nominal: NominalModel) -> np.ndarray:
    """eta2, shape (..., 2N) [N/m], [N m/rad], from (theta / F)' = 200 z phi."""
    return 200.0 * force_scale(nominal) / boundary_width(nominal)


def premise_rate(nominal: NominalModel) -> np.ndarray:
    """eta3, eta4, shape (..., 2N) [1/(N m)], [1/(N m rad)], from alpha' = 0.1 z B^T (theta / F)."""
    return 0.1 / (force_scale(nominal) * boundary_width(nominal))


LEARNING, BOUND, PREMISES = Knob("learning"), Knob("bound", apart=True), Knob("premises")

CONSEQUENT_BOUND = GainField(
    "bound on |theta|", "N, N m", consequent_bound, BOUND, zero=True, infinite=True
)
COMPENSATION_BOUND = dataclasses.replace(
    CONSEQUENT_BOUND, meaning="bound on E", recommended=compensation_bound
)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AdaptiveLaw(SlidingLaw):
    """The gains of law (63) with given premises.

    Raises:
        OctarmError: if alpha0 and sigma0 are for different numbers of rules.
    """

    K_v: Annotated[Gain, LINEAR_GAIN]
    phi: Annotated[  # 0 gives sgn(s), as the proof has it
        Gain,
        dataclasses.replace(LAYER_WIDTH, meaning="half width of the layer of the compensation"),
    ]
    scale: Annotated[
        Gain,
        GainField(
            "the membership functions see z = s / scale", "m/s, rad/s", boundary_width, WIDTH
        ),
    ]
    dead_zone: Annotated[
        Gain,
        GainField(
            "E rests while |s| is below this",
            "m/s, rad/s",
            lambda nominal: 0.05 * boundary_width(nominal),
            WIDTH,
            zero=True,
        ),
    ]
    eta1: Annotated[
        Gain,
        GainField("adaptation rate of E", "N/m, N m/rad", compensation_rate, LEARNING, zero=True),
    ]
    eta2: Annotated[
        Gain,
        GainField("adaptation rate of theta", "N/m, N m/rad", consequent_rate, LEARNING, zero=True),
    ]
    alpha0: Annotated[
        np.ndarray,
        RuleField(
            "centres of the membership functions at the start, in units of z",
            "1",
            [-1.0, -0.5, 0.0, 0.5, 1.0],
            zero=True,
        ),
    ]
    sigma0: Annotated[  # a function is at exp(-1) on its neighbours' centres
        np.ndarray, RuleField("their inverse widths at the start", "1", 2.0)
    ]
    safeguards: Annotated[
        bool, Switch("whether bounds and dead zone act; else the law is as printed", "1")
    ] = True
    normalised: Annotated[
        bool, Switch("whether the strengths of a joint's rules are divided by their sum", "1")
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        widths, centres = self.sigma0.shape[-1], self.alpha0.shape[-1]
        if widths not in (1, centres) and centres != 1:
            raise OctarmError(
                f"sigma0 is for {widths} rules and alpha0 for {centres}; they must fit"
            )

    def rule_table(self, value: np.ndarray, batch_shape: tuple[int, ...]) -> np.ndarray:
        """A new array with one value a rule, shape (..., 2N, M), the batch contiguous."""
        rules = np.broadcast_shapes(self.alpha0.shape, self.sigma0.shape)[-1]
        shape = np.broadcast_shapes((*batch_shape, self.nominal.coordinates, rules), value.shape)
        table = np.empty_like(value, shape=shape[::-1]).T
        table[...] = value
        return table
