"""The Lyapunov functions of the paper along sampled runs of the arm.

For the sliding modes V = 1/2 s^T D s, eq (32), with the true arm's D. For the adaptive law V is all
of eq (80). Its optima may be any that the proof can do with, and are set when the run is over:

    theta* = 0,  alpha* = alpha0,  sigma* = sigma0,  E*_j = sup |eps_j|,
    eps_j = F_j + (alpha_j - alpha0)^T B_j theta_j + (sigma_j - sigma0)^T C_j theta_j

F_j is the error of the model. Then V' = sum_j s_j eps_j - E*_j |s_j| - s^T (B + K_v) s <= 0 in
continuous time, with sgn(s), and without safeguards. What is counted is how often V is larger at a
control instant than at the one before.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from octarm.interfaces import Rows
from octarm.lagrange import inverse_dynamics, kinetic_energy
from paper.studies import SETTLED
from paper.variants import ARM

if TYPE_CHECKING:
    from paper.runs import Request

FIELDS = ("q", "v", "v_d", "wanted_a", "s", "E", "theta", "alpha", "sigma", "lost")


class Outcome(NamedTuple):
    """How V went on one arm."""

    label: str  # of the variant
    reference: str  # name
    rate: float  # of control [Hz]
    mismatch: float  # of the nominal model [1]
    # Whether the switching gain covers the model error, K_j >= |F_j|, at all times; for the
    # adaptive law, whether E_max covers eps.
    covered: bool
    outside: int  # periods that begin outside the boundary layer: |s_j| > phi_j for a j
    grown_outside: int  # of them, those over which V grew
    late: int  # those outside that begin in the steady regime, where start-up is over
    inside: int  # periods that begin within it
    grown_inside: int  # of them, those over which V grew
    start: float  # V at the start [J]
    bound: float  # largest 1/2 s^T D s in the steady regime [J]
    diverged: bool  # whether the arm left its limits


def outcomes(request: Request, arrays: Mapping[str, np.ndarray]) -> list[Outcome]:
    """What `counts` gave, arm by arm."""
    place = request.variant.label, request.reference, request.rate
    arms = zip(*(arrays[name].tolist() for name in Outcome._fields[len(place) :]), strict=True)
    return [Outcome(*place, *arm) for arm in arms]


def counts(request: Request, rows: Rows) -> dict[str, np.ndarray]:
    """The fields of `Outcome` that differ from arm to arm, each of shape (n,)."""
    gains, s = request.variant.gains, rows["s"]
    kinetic = kinetic_energy(ARM, rows["q"], s)
    F = _model_error(request, rows)
    if "E" in rows:
        learnt, covered = _learnt(gains, rows, F)
    else:
        learnt, covered = 0.0, np.all(_largest(F) <= np.asarray(gains.get("K", 0.0)), axis=-1)
    V = kinetic + learnt
    grown = V[1:] > V[:-1]
    outside = np.any(np.abs(s[:-1]) > np.asarray(gains.get("phi", 0.0)), axis=-1)
    steady = round(SETTLED * request.rate)
    return {
        "mismatch": request.mismatch,
        "covered": covered,
        "outside": np.sum(outside, axis=0),
        "grown_outside": np.sum(outside & grown, axis=0),
        "late": np.sum(outside[steady:], axis=0),
        "inside": np.sum(~outside, axis=0),
        "grown_inside": np.sum(~outside & grown, axis=0),
        "start": V[0],
        "bound": np.max(kinetic[steady:], axis=0, initial=0.0),
        "diverged": rows["lost"][-1],
    }


def _model_error(request: Request, rows: Rows) -> np.ndarray:
    """F = (D^ - D) q_r'' + .. + G^ - G, shape (T, n, 2N) [N], [N m]."""
    q, v, lambda_ = rows["q"], rows["v"], np.asarray(request.variant.gains["lambda"])
    v_r, a_r = v - rows["s"], rows["wanted_a"] - lambda_ * (v - rows["v_d"])
    nominal, true = (inverse_dynamics(p, q, v, a_r, v_r) for p in (request.nominal, ARM))
    return nominal - true


def _learnt(gains: Mapping[str, Any], rows: Rows, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """V of eq (80) beyond the first term, shape (T, n) [J]; whether E_max covers eps, (n,)."""
    theta, alpha, sigma, E = (rows[name] for name in ("theta", "alpha", "sigma", "E"))
    z = (rows["s"] / np.asarray(gains["scale"]))[..., None]
    alpha0, sigma0 = np.asarray(gains["alpha0"]), np.asarray(gains["sigma0"])
    phi = np.exp(-np.square(sigma * (z - alpha)))
    by_alpha, by_sigma = 2.0 * sigma**2 * (z - alpha) * phi, -2.0 * sigma * (z - alpha) ** 2 * phi
    moved = (alpha - alpha0) * by_alpha + (sigma - sigma0) * by_sigma
    needed = _largest(F + np.sum(moved * theta, axis=-1))
    rules = sum(
        np.sum(np.square(x), axis=-1) / np.maximum(np.asarray(gains[eta]), 1e-300)
        for x, eta in ((theta, "eta2"), (alpha - alpha0, "eta3"), (sigma - sigma0, "eta4"))
    )
    energy = np.square(needed - E) / np.asarray(gains["eta1"]) + rules
    return 0.5 * np.sum(energy, axis=-1), np.all(needed <= np.asarray(gains["E_max"]), axis=-1)


def _largest(x: np.ndarray) -> np.ndarray:
    """Over all instants, shape (T, n, 2N) to (n, 2N)."""
    return np.max(np.abs(x), axis=0)
