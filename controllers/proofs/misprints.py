"""The misprints of the adaptive law, (59)-(78), each made from what the right controller does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from controllers.proofs.adaptive_ledger import (
    AdaptiveTrial,
    adaptive_trial,
    etas,
    membership,
    membership_along,
)
from controllers.proofs.lyapunov import as_claimed, noticed
from octarm.arm.lagrange import coriolis_matrix
from octarm.arm.parameters import ArmParameters
from octarm.tolerances import Check


def misprints(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """The rows of the paper's wrong variants, on an arm whose dampers do not hide them."""
    bare = p.scaled(damping=0.0)
    t = adaptive_trial("afsmc", bare, states, rng)
    yield noticed("C_j as printed, d/d alpha", printed_C(t).rate, t.claim)
    yield noticed("d/d delta moves sigma", delta_gradient(t).rate, t.claim)
    yield noticed("+ F^ + F_cp in (63)", added_estimate(t).rate, t.claim)
    if p.modules > 1:  # a single module has no Coriolis force
        yield noticed("C laid out as in (4)", paper_coriolis(t).rate, t.claim)
    yield as_claimed("afsmc, B_j, C_j laid out as in (72)", printed_layout(t).rate, t.claim)
    t = adaptive_trial("afsmc", bare, states, rng, normalised=True)
    yield noticed("the same, normalised", printed_layout(t).rate, t.claim)
    yield noticed("normalised as if sum mu = 1", as_if_sum_is_one(t).rate, t.claim)


def printed_C(t: AdaptiveTrial) -> AdaptiveTrial:
    """C_j as printed in (72): d/d alpha where d/d sigma is meant."""
    eta = etas(t.law)
    return _moving(t, sigma=eta.sigma / eta.alpha * t.rates.alpha)


def delta_gradient(t: AdaptiveTrial) -> AdaptiveTrial:
    """Sigma moved by the gradient in the delta of (59): d/d delta = -sigma^2 d/d sigma."""
    return _moving(t, sigma=-np.square(t.now.sigma) * t.rates.sigma)


def added_estimate(t: AdaptiveTrial) -> AdaptiveTrial:
    """(63) with + F^ + F_cp."""
    s = t.surface.s
    estimate = np.sum(t.now.theta * membership(t.law, s, t.now), axis=-1)  # eq (67)
    return t._replace(force=t.force + 2.0 * (estimate + t.now.E * np.sign(s)))


def paper_coriolis(t: AdaptiveTrial) -> AdaptiveTrial:
    """C laid out as in (4) in the law: for it, D' - 2C is not skew."""
    nominal, (_, q, v) = t.at.nominal, t.at.measurement
    change = layout_of_the_paper(nominal, q, v) - coriolis_matrix(nominal, q, v)
    return t._replace(force=t.force + np.einsum("...ij,...j->...i", change, t.surface.v_r))


def layout_of_the_paper(p: ArmParameters, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A C with the right C q', and s_i' theta_j' whole in the column of s_i, (..., 2N, 2N)."""
    turning = v.copy()
    turning[..., : p.modules] = 0.0
    out = coriolis_matrix(p, q, turning)
    out[..., : p.modules] = 2.0 * coriolis_matrix(p, q, v)[..., : p.modules]
    return out


def printed_layout(t: AdaptiveTrial) -> AdaptiveTrial:
    """B_j and C_j laid out as in (72), the transpose: B theta in place of B^T theta."""
    eta, s, still = etas(t.law), t.surface.s, np.zeros_like(t.now.theta)
    B_theta = membership_along(t.law, s, t.now, t.now._replace(alpha=t.now.theta, sigma=still))
    C_theta = membership_along(t.law, s, t.now, t.now._replace(alpha=still, sigma=t.now.theta))
    s = s[..., None]
    return _moving(t, alpha=eta.alpha * s * B_theta, sigma=eta.sigma * s * C_theta)


def as_if_sum_is_one(t: AdaptiveTrial) -> AdaptiveTrial:
    """The gradients that (65) suggests: phi^l is divided by the sum, yet moves alone."""
    eta, s, (theta, alpha, sigma, _) = etas(t.law), t.surface.s[..., None], t.now
    away = s / np.asarray(t.law.scale)[..., None] - alpha
    slope = 2.0 * theta * membership(t.law, t.surface.s, t.now) * sigma * away
    return _moving(t, alpha=eta.alpha * s * slope * sigma, sigma=-eta.sigma * s * slope * away)


def _moving(t: AdaptiveTrial, **rates: np.ndarray) -> AdaptiveTrial:
    return t._replace(rates=t.rates._replace(**rates))
