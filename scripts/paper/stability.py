"""The Lyapunov functions of the paper along sampled runs of the arm.

For the sliding modes V = 1/2 s^T D s, eq (32), with the true arm's D. For the adaptive law V is all
of eq (80). Its optima may be any that the proof can do with, and are chosen when the run is over:

    theta* = 0,  alpha* = alpha0,  sigma* = sigma0,  E*_j = sup |eps_j|,
    eps_j = F_j + (alpha_j - alpha0)^T B_j theta_j + (sigma_j - sigma0)^T C_j theta_j

F_j is the error of the model. Then V' = sum_j s_j eps_j - E*_j |s_j| - s^T (B + K_v) s <= 0 in
continuous time, with sgn(s), and without safeguards. What is counted is how often V is larger at a
control instant than at the one before.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from octarm.arm.lagrange import inverse_dynamics, kinetic_energy
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Instant, Measurement, Reference
from octarm.metrics.table import SETTLED_AFTER
from octarm.simulation.environment import load
from octarm.simulation.rollout import simulate
from paper.effort import Effort
from paper.studies import BENDS, MODELS, RATE
from paper.variants import PROPOSED, SIGN, SMC, Cast, Factory, Variant, by_hand


class Request(NamedTuple):
    """Arms of one variant without noise, one for each of `MODELS`, at one control rate.

    Attributes:
        variant: what controls them.
        rate: of control [Hz].
        duration: [s].
    """

    variant: Variant
    rate: float
    duration: float

    @property
    def seconds(self) -> float:
        """What is simulated, all arms counted [s]."""
        return len(MODELS) * self.duration


class Outcome(NamedTuple):
    """How V went on one arm.

    Attributes:
        label: of the variant.
        rate: of control [Hz].
        mismatch: of the nominal model [1].
        covered: whether the switching gain covers the model error, K_j >= |F_j|, at all times; of
            the adaptive law whether E_max covers eps.
        outside: periods that begin outside the boundary layer: |s_j| > phi_j for a j.
        grown_outside: of them, those over which V grew.
        inside: periods that begin within it.
        grown_inside: of them, those over which V grew.
        start: V at the start [J].
        bound: largest 1/2 s^T D s in the steady regime [J].
        diverged: whether the arm left its limits.
    """

    label: str
    rate: float
    mismatch: float
    covered: bool
    outside: int
    grown_outside: int
    inside: int
    grown_inside: int
    start: float
    bound: float
    diverged: bool


def requests(cast: Cast, effort: Effort) -> list[Request]:
    """The sliding modes with hand-set gains, which are above the model error; `afsmc` with both."""
    labels = [by_hand(SIGN), by_hand(SMC), by_hand(PROPOSED)]
    labels += [PROPOSED] if effort.complete else []
    rates = sorted({*effort.rates, RATE})
    return [Request(cast[label], rate, effort.short) for label in labels for rate in rates]


def run(request: Request, factory: Factory) -> list[Outcome]:
    """Runs the arms."""
    true = nominal_parameters()
    period = 1.0 / request.rate
    environment = load(
        BENDS,
        batch=len(MODELS),
        control_period=period,
        timestep=min(period, 1.0 / RATE),
    )
    nominal = true.mismatched(np.array(MODELS))
    variant = request.variant
    controller = factory(variant.controller, nominal, variant.gains)
    keeper = _Keeper(true, nominal, np.asarray(variant.gains["lambda"]))
    simulate(environment, controller, request.duration, keeper)
    history = {name: np.stack(rows) for name, rows in keeper.rows.items()}
    lost = ~environment.physics.intact()
    with np.errstate(all="ignore"):
        return [
            _outcome(request, mismatch, {k: x[:, i] for k, x in history.items()}, bool(lost[i]))
            for i, mismatch in enumerate(MODELS)
        ]


class _Keeper:
    """Keeps what V is made of."""

    def __init__(self, true: ArmParameters, nominal: ArmParameters, lambda_: np.ndarray) -> None:
        self.rows: dict[str, list[np.ndarray]] = {}
        self._true, self._nominal, self._lambda = true, nominal, lambda_

    def __call__(self, instant: Instant) -> None:
        signals = instant.command.signals
        s = signals["s"]
        row = {
            "s": s,
            "V": kinetic_energy(self._true, instant.q, s),
            "F": self._model_error(instant.measurement, instant.reference, s),
            **{name: signals[name] for name in ("E", "theta", "alpha", "sigma") if name in signals},
        }
        for name, values in row.items():
            self.rows.setdefault(name, []).append(np.array(values))

    def _model_error(self, at: Measurement, wanted: Reference, s: np.ndarray) -> np.ndarray:
        """F = (D^ - D) q_r'' + .. + G^ - G, shape (n, 2N) [N], [N m]."""
        v_r, a_r = at.v - s, wanted.a - self._lambda * (at.v - wanted.v)
        nominal, true = (
            inverse_dynamics(p, at.q, at.v, a_r, v_r) for p in (self._nominal, self._true)
        )
        return nominal - true


def _outcome(
    request: Request, mismatch: float, history: Mapping[str, np.ndarray], diverged: bool
) -> Outcome:
    gains, s = request.variant.gains, history["s"]
    more, covered = 0.0, _covers(gains.get("K", 0.0), history["F"])
    if "E" in history:
        more, covered = _adapted(gains, history)
    V = history["V"] + more
    grown = V[1:] > V[:-1]
    outside = np.any(np.abs(s[:-1]) > np.asarray(gains["phi"] if "phi" in gains else 0.0), axis=-1)
    steady = round(SETTLED_AFTER * request.rate)
    return Outcome(
        label=request.variant.label,
        rate=request.rate,
        mismatch=mismatch,
        covered=covered,
        outside=int(outside.sum()),
        grown_outside=int((outside & grown).sum()),
        inside=int((~outside).sum()),
        grown_inside=int((~outside & grown).sum()),
        start=float(V[0]),
        bound=float(np.max(history["V"][steady:], initial=0.0)),
        diverged=diverged,
    )


def _adapted(
    gains: Mapping[str, Any], history: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, bool]:
    """The part of V, eq (80), beyond the first term, shape (T,) [J]; whether E_max covers eps."""
    theta, alpha, sigma, E = (history[name] for name in ("theta", "alpha", "sigma", "E"))
    z = (history["s"] / np.asarray(gains["scale"]))[..., None]
    alpha0, sigma0 = np.asarray(gains["alpha0"]), np.asarray(gains["sigma0"])
    phi = np.exp(-np.square(sigma * (z - alpha)))
    by_alpha, by_sigma = 2.0 * sigma**2 * (z - alpha) * phi, -2.0 * sigma * (z - alpha) ** 2 * phi
    moved = (alpha - alpha0) * by_alpha + (sigma - sigma0) * by_sigma
    eps = history["F"] + np.sum(moved * theta, axis=-1)
    needed = np.max(np.abs(eps), axis=0)
    rules = sum(
        np.sum(np.square(x), axis=-1) / np.maximum(np.asarray(gains[eta]), 1e-300)
        for x, eta in ((theta, "eta2"), (alpha - alpha0, "eta3"), (sigma - sigma0, "eta4"))
    )
    energy = np.square(needed - E) / np.asarray(gains["eta1"]) + rules
    return 0.5 * np.sum(energy, axis=-1), bool(np.all(needed <= np.asarray(gains["E_max"])))


def _covers(K: Any, F: np.ndarray) -> bool:
    return bool(np.all(np.max(np.abs(F), axis=0) <= np.asarray(K)))
