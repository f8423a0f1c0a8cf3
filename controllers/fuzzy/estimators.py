"""Fuzzy function estimators, eqs (58)-(62) and (65)-(72): a value and its gradient.

M rules, each with one Gaussian membership function an input and the product as AND:

    mu^l = prod_i exp(-(sigma_i^l (x_i - alpha_i^l))^2)              eqs (59), (66), (88)
    f = sum_l theta^l phi^l                                          eqs (58), (60), (67)

The strengths phi of the rules are mu divided by its sum over the rules, as in (58), (59) and (62),
or mu itself, as the proof of the adaptation laws has it, (65). The paper divides by a width delta
in (59) and multiplies by sigma in (66) and (88); here it is sigma = 1 / delta throughout.

First type: the premises alpha, sigma are given, and f is linear in the consequents theta. Second
type: all three are adjusted. The laws need df/dtheta = phi, df/dalpha = B^T theta and
df/dsigma = C^T theta with B[r, l] = d phi^r / d alpha^l and C[r, l] = d phi^r / d sigma^l; (72)
prints their transposes, and B once more in place of C.

Shapes: theta (..., M), x (..., I) for I inputs, alpha and sigma (..., I, M). Sums over inputs and
rules are taken term by term, so that a result does not depend on the batch it is in. Results for a
batch lie rule by rule in memory, the batch contiguous.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class EstimatorValue(NamedTuple):
    """The value of an estimator of the second type, and its gradient.

    Attributes:
        value: f, shape (...).
        d_theta: df/dtheta = phi, shape (..., M).
        d_alpha: df/dalpha = B^T theta, shape (..., I, M).
        d_sigma: df/dsigma = C^T theta, shape (..., I, M).
    """

    value: np.ndarray
    d_theta: np.ndarray
    d_alpha: np.ndarray
    d_sigma: np.ndarray


def strengths(
    x: np.ndarray, alpha: np.ndarray, sigma: np.ndarray, *, normalised: bool
) -> np.ndarray:
    """The strengths phi of the rules at the input x, shape (..., M)."""
    return _strengths(sigma * _differences(alpha, x), normalised)


def first_type(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """f = sum_l theta^l phi^l, eqs (58), (60), (62), shape (...); df/dtheta is phi."""
    return _sum_over_rules(theta * phi)


def second_type(
    theta: np.ndarray, alpha: np.ndarray, sigma: np.ndarray, x: np.ndarray, *, normalised: bool
) -> EstimatorValue:
    """f = sum_l theta^l phi^l, eqs (59), (67), and its gradient in theta, alpha and sigma.

    A rule's mu depends on its own premises alone. Not normalised, B and C are therefore diagonal
    and B^T theta = theta^l dmu^l/dalpha^l. Normalised, every phi^r changes with alpha^l, and the
    sum over r is B^T theta = (theta^l - f) / (sum mu) dmu^l/dalpha^l.
    """
    d = _differences(alpha, x)
    scaled = sigma * d
    phi = _strengths(scaled, normalised)
    weight = theta * phi
    value = _sum_over_rules(weight)
    if normalised:
        weight -= value[..., None] * phi
    # With d = alpha - x: dmu/dalpha = -2 sigma^2 d mu and dmu/dsigma = -2 sigma d^2 mu.
    weight *= -2.0
    common = weight[..., None, :] * scaled
    d_alpha = common * sigma
    common *= d
    return EstimatorValue(value, phi, d_alpha, d_sigma=common)


def _differences(alpha: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The array alpha - x, shape (..., I, M), its axes in reverse order in memory."""
    return np.subtract(alpha, x[..., None], order="F")


def _strengths(scaled: np.ndarray, normalised: bool) -> np.ndarray:
    squares = scaled * scaled
    exponent = squares[..., 0, :]
    for i in range(1, squares.shape[-2]):
        exponent += squares[..., i, :]
    np.negative(exponent, out=exponent)
    if not normalised:
        return np.exp(exponent, out=exponent)
    # The largest mu is made 1: far from all rules they would all be 0 in floating point.
    mu = np.exp(exponent - np.max(exponent, axis=-1, keepdims=True))
    return mu / _sum_over_rules(mu)[..., None]


def _sum_over_rules(terms: np.ndarray) -> np.ndarray:
    total = terms[..., 0].copy("K")
    for rule in range(1, terms.shape[-1]):
        total += terms[..., rule]
    return total
