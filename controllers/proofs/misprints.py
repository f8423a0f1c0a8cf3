"""The misprints of the adaptive law, (59)-(78), each made from what the right controller does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from controllers.proofs.adaptive_ledger import AdaptiveTrial, Answer, adaptive_trial, each_rule
from controllers.proofs.lyapunov import (
    as_claimed,
    estimate,
    membership,
    membership_along,
    noticed,
    rates_of,
)
from octarm.arm.lagrange import coriolis_matrix
from octarm.arm.parameters import ArmParameters
from octarm.checks.report import Check


def misprints(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """The paper's wrong variants, each made from what the right controller does."""
    bare = p.scaled(damping=0.0)
    t = adaptive_trial("afsmc", bare, states, rng)
    yield noticed("C_j as printed, d/d alpha", t.rate(printed_C(t)), t.claim)
    yield noticed("d/d delta moves sigma", t.rate(delta_gradient(t)), t.claim)
    yield noticed("+ F^ + F_cp in (63)", t.rate(added_estimate(t)), t.claim)
    if p.modules > 1:  # a single module has no Coriolis force
        yield noticed("C laid out as in (4)", t.rate(paper_coriolis(t)), t.claim)
    yield as_claimed("afsmc, B_j, C_j laid out as in (72)", t.rate(printed_layout(t)), t.claim)
    t = adaptive_trial("afsmc", bare, states, rng, normalised=True)
    yield noticed("the same, normalised", t.rate(printed_layout(t)), t.claim)
    yield noticed("normalised as if sum mu = 1", t.rate(as_if_sum_is_one(t)), t.claim)


def printed_C(t: AdaptiveTrial) -> Answer:
    """C_j as printed in (72): d/d alpha where d/d sigma is meant."""
    _, _, eta3, eta4 = rates_of(t.law)
    rates = t.answer.rates
    return t.answer._replace(rates=rates._replace(sigma=each_rule(eta4 / eta3) * rates.alpha))


def delta_gradient(t: AdaptiveTrial) -> Answer:
    """Sigma moved by the gradient in the delta of (59): d/d delta = -sigma^2 d/d sigma."""
    rates = t.answer.rates
    return t.answer._replace(rates=rates._replace(sigma=-np.square(t.now.sigma) * rates.sigma))


def added_estimate(t: AdaptiveTrial) -> Answer:
    """(63) with + F^ + F_cp."""
    s = t.surface.s
    learnt = estimate(t.law, s, t.now) + t.now.E * np.sign(s)
    return t.answer._replace(force=t.answer.force + 2.0 * learnt)


def paper_coriolis(t: AdaptiveTrial) -> Answer:
    """C laid out as in (4) in the law: for it, D' - 2C is not skew."""
    nominal, (_, q, v) = t.at.nominal, t.at.measurement
    change = layout_of_the_paper(nominal, q, v) - coriolis_matrix(nominal, q, v)
    force = t.answer.force + np.einsum("...ij,...j->...i", change, t.surface.v_r)
    return t.answer._replace(force=force)


def layout_of_the_paper(p: ArmParameters, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A C with the right C q', and s_i' theta_j' whole in the column of s_i, (..., 2N, 2N)."""
    turning = v.copy()
    turning[..., : p.modules] = 0.0
    out = coriolis_matrix(p, q, turning)
    out[..., : p.modules] = 2.0 * coriolis_matrix(p, q, v)[..., : p.modules]
    return out


def printed_layout(t: AdaptiveTrial) -> Answer:
    """B_j and C_j laid out as in (72), the transpose: B theta in place of B^T theta."""
    _, _, eta3, eta4 = rates_of(t.law)
    s, still = t.surface.s, np.zeros_like(t.now.theta)
    along_alpha = t.now._replace(alpha=t.now.theta, sigma=still)
    along_sigma = t.now._replace(alpha=still, sigma=t.now.theta)
    rates = t.answer.rates._replace(
        alpha=each_rule(eta3 * s) * membership_along(t.law, s, t.now, along_alpha),
        sigma=each_rule(eta4 * s) * membership_along(t.law, s, t.now, along_sigma),
    )
    return t.answer._replace(rates=rates)


def as_if_sum_is_one(t: AdaptiveTrial) -> Answer:
    """The gradients that (65) suggests: phi^l is divided by the sum, yet moves alone."""
    _, _, eta3, eta4 = rates_of(t.law)
    s, (theta, alpha, sigma, _) = t.surface.s, t.now
    away = each_rule(s / t.law.scale) - alpha
    slope = 2.0 * theta * membership(t.law, s, t.now) * sigma * away
    rates = t.answer.rates._replace(
        alpha=each_rule(eta3 * s) * slope * sigma, sigma=-each_rule(eta4 * s) * slope * away
    )
    return t.answer._replace(rates=rates)
