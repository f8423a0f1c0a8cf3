"""Adaptive fuzzy estimator sliding mode, law (63) with memberships (88) and adaptation (75)-(79).

A fuzzy function of s_j estimates the error of the model joint by joint, and a switching gain E_j
grows until it covers what the estimate misses:

    Q = D^ q_r'' + (C^ + B^) q_r' + G^ - f^(z) - E sat(s / phi) - K_v s,      z_j = s_j / scale_j
    f^_j = sum_l theta_j^l phi_j^l,    phi_j^l = exp(-(sigma_j^l (z_j - alpha_j^l))^2)

    theta' = eta2 s phi          (75)          alpha' = eta3 s B^T theta      (76)
    E' = eta1 |s|          (78), (79)          sigma' = eta4 s C^T theta      (77)

with s = q' - q_r' as in `controllers.sliding_mode`, B = d phi / d alpha and C = d phi / d sigma.
The error of the model, F = (D^ - D) q_r'' + .., then drives D s' = -(C + B) s + F - f^ - .. , and
with sgn(s) in place of sat(s / phi) the Lyapunov function (80),

    V = 1/2 s^T D s
        + 1/2 sum_j (E~^2 / eta1 + |theta~|^2 / eta2 + |alpha~|^2 / eta3 + |sigma~|^2 / eta4)_j,

has V' = sum_j (s_j eps_j - E*_j |s_j|) - s^T (B + K_v) s. Here E~ = E* - E and so on, and eps_j is
what f_j - f^_j holds beyond first order in the errors of theta, alpha and sigma. These optima are
not known to a controller: the signal V is the first term with D^, all that can be computed.

The law as printed drifts. E never falls. A rule with alpha > 0 sees s > 0 alone, so theta only
moves outwards, and the centres gather about s = 0: f^ becomes an ever steeper gain that no sampled
loop can hold. The safeguards stop E while |s| is small and project all that adapts onto bounds,
theta about 0, each centre about its first place, so that no two of them meet. Nor does anything
adapt where it would only ask for more force than the actuators have, see `Law.without_windup`.

A state is not overwritten: what adapts is written to new memory, and the signals theta, alpha,
sigma and E of an instant are the arrays of the state that was passed in.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Annotated, NamedTuple

import numpy as np

from controllers.fuzzy.estimators import first_type, second_type, strengths
from controllers.law import Gain, GainField, RuleField, Switch, elapsed
from controllers.recommended import (
    LAYER_WIDTH,
    LINEAR_GAIN,
    WIDTH,
    HandSet,
    boundary_width,
    by_hand,
)
from controllers.sliding_mode import SlidingLaw, Surface, saturation
from octarm.errors import OctarmError
from octarm.interfaces import Command, Knob, Measurement, NominalModel, Reference


class ConsequentState(NamedTuple):
    """What `AdaptiveConsequents` has learnt.

    Attributes:
        t: time of the last call [s]; None before the first.
        theta: consequents, shape (..., 2N, M) [N], [N m].
        E: gain of the compensation, shape (..., 2N) [N], [N m].
    """

    t: float | None
    theta: np.ndarray
    E: np.ndarray


class FuzzyState(NamedTuple):
    """What `AdaptiveFuzzy` has learnt.

    Attributes:
        t: time of the last call [s]; None before the first.
        theta: consequents, shape (..., 2N, M) [N], [N m].
        alpha: centres of the membership functions, shape (..., 2N, M) [1].
        sigma: their inverse widths, shape (..., 2N, M) [1].
        E: gain of the compensation, shape (..., 2N) [N], [N m].
    """

    t: float | None
    theta: np.ndarray
    alpha: np.ndarray
    sigma: np.ndarray
    E: np.ndarray


force_scale = HandSet("N, N m", 1.0, 0.1)  # F, about what theta may have to be: its unit
# theta_max is what sampling allows. With all theta at their bounds and the premises as they start,
# the slope of f^ at s = 0 is 3.24 theta_max / scale. With a control period dt, the product
# dt [D^-1]_jj (K_v + E_max / phi + 3.24 theta_max / scale) should stay below about 0.6.
consequent_bound = HandSet("N, N m", 1.0, 1.0, 1.0, 0.6, 0.25, 0.04)
compensation_bound = HandSet("N, N m", 0.6, 0.6, 0.6, 0.3, 0.15, 0.02)  # E_max


def rate(times: float, nominal: NominalModel) -> np.ndarray:
    """eta1 or eta2, shape (..., 2N) [N/m], [N m/rad], for x' = eta s with (x / F)' = times z."""
    pace = by_hand(nominal, "1/s", times)
    return pace * force_scale(nominal) / boundary_width(nominal)


def premise_rate(nominal: NominalModel) -> np.ndarray:
    """eta3, eta4, shape (..., 2N) [1/(N m)], [1/(N m rad)], from alpha' = 0.1 z B^T (theta / F)."""
    return by_hand(nominal, "1/s", 0.1) / (force_scale(nominal) * boundary_width(nominal))


LEARNING, BOUND, PREMISES = Knob("learning"), Knob("bound", apart=True), Knob("premises")

CONSEQUENT_BOUND = GainField(
    "bound on |theta|", "N, N m", consequent_bound, BOUND, zero=True, infinite=True
)
COMPENSATION_BOUND = dataclasses.replace(
    CONSEQUENT_BOUND, meaning="bound on E", recommended=compensation_bound
)
# (E / F)' = 5 |z| and (theta / F)' = 200 z phi, with z = s / scale.
COMPENSATION_RATE = GainField(
    "adaptation rate of E", "N/m, N m/rad", functools.partial(rate, 5.0), LEARNING, zero=True
)
CONSEQUENT_RATE = dataclasses.replace(
    COMPENSATION_RATE,
    meaning="adaptation rate of theta",
    recommended=functools.partial(rate, 200.0),
)
PREMISE_RATE = GainField(
    "adaptation rate of alpha", "1/(N m), 1/(N m rad)", premise_rate, PREMISES, zero=True
)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AdaptiveLaw(SlidingLaw):
    """Law (63) with an estimate f^ that a subclass adapts.

    Raises OctarmError if alpha0 and sigma0 are for different numbers of rules.
    """

    K_v: Annotated[Gain, LINEAR_GAIN]
    phi: Annotated[  # 0 gives sgn(s), as the proof has it
        Gain,
        dataclasses.replace(LAYER_WIDTH, meaning="half width of the layer of the compensation"),
    ]
    scale: Annotated[
        Gain,
        dataclasses.replace(
            LAYER_WIDTH, meaning="the membership functions see z = s / scale", zero=False
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
    eta1: Annotated[Gain, COMPENSATION_RATE]
    eta2: Annotated[Gain, CONSEQUENT_RATE]
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
        bool,
        Switch("whether bounds, dead zone and anti-windup act; else the law is as printed", "1"),
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
        table = np.empty(shape[::-1]).T
        table[...] = value
        return table

    def near(self, centre: Gain, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tables of centre - reach and of centre + reach, shapes (..., 2N, M)."""
        low, high = centre - reach[..., None], centre + reach[..., None]
        return self.rule_table(low, ()), self.rule_table(high, ())

    def compensated(
        self,
        measurement: Measurement,
        surface: Surface,
        f_hat: np.ndarray,
        E: np.ndarray,
        **rules: np.ndarray,
    ) -> Command:
        """Eqs (63) and (78): Q and its signals, from f^ and E of shape (..., 2N) [N], [N m]."""
        s = surface.s
        switching = -(f_hat + E * saturation(s, self.phi)) - self.K_v * s
        signals = {"f_hat": f_hat, "E": E, **rules}
        return self.command(measurement, surface, switching, layer=self.phi, **signals)

    def grown(self, E: np.ndarray, s: np.ndarray, dt: float, E_max: np.ndarray) -> np.ndarray:
        """E after dt [s], eq (79), shape (..., 2N) [N], [N m]."""
        size = np.abs(s)
        if not self.safeguards:
            return E + dt * self.eta1 * size
        size = size * (size >= self.dead_zone)
        return np.minimum(E + dt * self.eta1 * size, E_max)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AdaptiveConsequents(AdaptiveLaw):
    """Law (63) with the first type of estimator: theta and E adapt, alpha and sigma are given.

    It is `AdaptiveFuzzy` with eta3 = eta4 = 0, for less. The signals hold f_hat and E of shape
    (..., 2N), and theta of shape (..., 2N, M).
    """

    theta_max: Annotated[np.ndarray, CONSEQUENT_BOUND]
    E_max: Annotated[np.ndarray, COMPENSATION_BOUND]

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> ConsequentState:
        """Nothing learnt: theta = 0 and E = 0."""
        theta = self.rule_table(np.zeros_like(self.alpha0), batch_shape)
        return ConsequentState(None, theta, theta[..., 0].copy("K"))

    def __call__(
        self, state: ConsequentState, measurement: Measurement, reference: Reference
    ) -> tuple[Command, ConsequentState]:
        before, theta, E = state
        surface = self.surface(measurement, reference)
        s = surface.s
        z = (s / self.scale)[..., None]
        alpha, sigma = self.alpha0[..., None, :], self.sigma0[..., None, :]
        phi = strengths(z, alpha, sigma, normalised=self.normalised)
        f_hat = first_type(theta, phi)
        command = self.compensated(measurement, surface, f_hat, E, theta=theta)

        if self.safeguards:
            s = self.without_windup(measurement, command, s)
        dt = elapsed(before, measurement.t)
        theta = theta + (dt * self.eta2 * s)[..., None] * phi
        if self.safeguards:
            _keep_between(self._bounds, theta)
        return command, ConsequentState(measurement.t, theta, self.grown(E, s, dt, self.E_max))

    @functools.cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.near(0.0, self.theta_max)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AdaptiveFuzzy(AdaptiveLaw):
    """Law (63) with the second type of estimator: theta, alpha, sigma and E adapt.

    The signals are those of `AdaptiveConsequents`, and alpha and sigma of shape (..., 2N, M).
    Raises OctarmError if sigma_min exceeds sigma_max.
    """

    eta3: Annotated[Gain, PREMISE_RATE]
    eta4: Annotated[Gain, dataclasses.replace(PREMISE_RATE, meaning="adaptation rate of sigma")]
    theta_max: Annotated[np.ndarray, CONSEQUENT_BOUND]
    E_max: Annotated[np.ndarray, COMPENSATION_BOUND]
    alpha_max: Annotated[  # half the distance to the neighbour
        np.ndarray, GainField("bound on |alpha - alpha0|", "1", 0.25, zero=True, infinite=True)
    ]
    sigma_min: Annotated[np.ndarray, GainField("smallest sigma; 0 for none", "1", 1.0, zero=True)]
    sigma_max: Annotated[np.ndarray, GainField("largest sigma", "1", 3.0, zero=True, infinite=True)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.any(self.sigma_min > self.sigma_max):
            raise OctarmError(
                f"sigma_min holds {np.max(self.sigma_min):g}; it must not exceed sigma_max, which "
                f"holds {np.min(self.sigma_max):g}"
            )

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> FuzzyState:
        """Nothing learnt: theta = 0, E = 0, alpha and sigma as they start."""
        alpha = self.rule_table(self.alpha0, batch_shape)
        sigma = self.rule_table(self.sigma0, batch_shape)
        theta = np.zeros_like(alpha)
        return FuzzyState(None, theta, alpha, sigma, theta[..., 0].copy("K"))

    def __call__(
        self, state: FuzzyState, measurement: Measurement, reference: Reference
    ) -> tuple[Command, FuzzyState]:
        before, theta, alpha, sigma, E = state
        surface = self.surface(measurement, reference)
        s = surface.s
        z = (s / self.scale)[..., None]
        f_hat, phi, B_theta, C_theta = second_type(
            theta, alpha[..., None, :], sigma[..., None, :], z, normalised=self.normalised
        )
        rules = {"theta": theta, "alpha": alpha, "sigma": sigma}
        command = self.compensated(measurement, surface, f_hat, E, **rules)

        if self.safeguards:
            s = self.without_windup(measurement, command, s)
        dt = elapsed(before, measurement.t)
        theta = theta + (dt * self.eta2 * s)[..., None] * phi
        alpha = alpha + (dt * self.eta3 * s)[..., None] * B_theta[..., 0, :]
        sigma = sigma + (dt * self.eta4 * s)[..., None] * C_theta[..., 0, :]
        if self.safeguards:
            for table, bounds in zip((theta, alpha, sigma), self._bounds, strict=True):
                _keep_between(bounds, table)
        return command, FuzzyState(
            measurement.t, theta, alpha, sigma, self.grown(E, s, dt, self.E_max)
        )

    @functools.cached_property
    def _bounds(self) -> list[tuple[np.ndarray, np.ndarray]]:
        # A sigma projected onto 0 would stay there, as sigma' ~ sigma. One that passes 0 does not
        # matter: exp(-(sigma ..)^2) is even.
        least = np.where(np.equal(self.sigma_min, 0.0), -np.inf, self.sigma_min)
        return [
            self.near(0.0, self.theta_max),
            self.near(self.alpha0, self.alpha_max),
            (self.rule_table(least[..., None], ()), self.rule_table(self.sigma_max[..., None], ())),
        ]


def _keep_between(bounds: tuple[np.ndarray, np.ndarray], x: np.ndarray) -> None:
    """Projects x, shape (..., 2N, M), onto what lies between a lowest and a highest table."""
    np.maximum(x, bounds[0], out=x)
    np.minimum(x, bounds[1], out=x)
