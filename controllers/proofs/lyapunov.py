"""V' of the closed loop, twice: by the chain rule through the true arm, and as the theory claims.

Sliding mode, eqs (32)-(42), with M s' = F - C s - B s - (robust part) on the true arm:

    V = 1/2 s^T D s,    F = (D^ - D) q_r'' + (C^ - C + B^ - B) q_r' + G^ - G

Adaptive fuzzy sliding mode, eqs (80)-(87), with x~ = x* - x for each adapted x:

    V = 1/2 s^T D s + 1/2 sum_j E~_j^2 / eta1 + |theta~_j|^2 / eta2 + |alpha~_j|^2 / eta3
        + |sigma~_j|^2 / eta4

By the chain rule, V' takes what a controller really does, its force and its rates, and the answer
of the true arm: q'' from `forward_dynamics`, D' as a derivative along q'. The claims take matrices
and the theory's own formulas, and nothing from the controller. The two share no code, so a wrong
sign, gradient or matrix on either side shows as a difference at a random state. A V that falls
along one run shows little: it does so with wrong gradients as well.

Shapes: (...) for the batch, 2N coordinates, M fuzzy rules a coordinate. Energies in J, rates in W.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from controllers.law import Gain
from controllers.recommended import boundary_width, linear_gain
from controllers.sliding_mode import Surface
from octarm.arm.lagrange import (
    coriolis_matrix,
    damping_matrix,
    forward_dynamics,
    mass_matrix,
    potential_force,
)
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Measurement, Reference
from octarm.tolerances import Check

COMPLEX_STEP = 1e-30  # f(x + i h d) = f(x) + i h (derivative of f along d) + O(h^2): no rounding
EXACT = 1e-10  # what rounding may do to V', as a share of its rms
NOTICED = 1e-4  # the least that a wrong law must do to V', as a share of its rms
LAMBDA = 15.0  # of all trials [1/s]


class Instants(NamedTuple):
    """States of the arm, what is wanted there, and what a controller believes.

    Attributes:
        true: the arm that moves.
        nominal: the model that the controller is given, one for each instant or one for all.
        measurement: exact q and q', of shape (..., 2N).
        reference: q_d, q_d', q_d'', of shape (..., 2N).
        integral: integral of e = q - q_d, for the integral surface, (..., 2N) [m s], [rad s].
    """

    true: ArmParameters
    nominal: ArmParameters
    measurement: Measurement
    reference: Reference
    integral: np.ndarray

    @property
    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """e and e', each of shape (..., 2N)."""
        return self.measurement.q - self.reference.q, self.measurement.v - self.reference.v


def random_instants(true: ArmParameters, states: int, rng: np.random.Generator) -> Instants:
    """Uniform states far beyond what the arm does under control, with a nominal model for each.

    Modules are 0.4 to 2 times their rest length and bent by up to 1.5 rad. |s| goes up to 2.5
    boundary layers, where the fuzzy rules are, and is inside the layer in a third of the states.
    """
    nominal, n = _random_nominal(true, states, rng), true.modules

    def within(slide: float, bend: float) -> np.ndarray:
        return rng.uniform(-1.0, 1.0, (states, 2 * n)) * np.repeat([slide, bend], n)

    q = within(0.0, 1.5)
    q[:, :n] = true.rest_length * rng.uniform(0.4, 2.0, (states, n))
    v, e, a_d = within(1.0, 6.0), within(0.05, 0.5), within(20.0, 200.0)
    layer = layer_of(true)
    s = within(2.5, 2.5) * layer * rng.uniform(0.0, 1.0, (states, 1))
    reference = Reference(q - e, v - (s - LAMBDA * e), a_d)
    # The integral surface then differs from the plain one by less than a layer.
    integral = (within(1.0, 1.0) * layer - LAMBDA * e) / LAMBDA**2
    return Instants(true, nominal, Measurement(1.0, q, v), reference, integral)


def _random_nominal(true: ArmParameters, count: int, rng: np.random.Generator) -> ArmParameters:
    """Models that are wrong by log-uniform factors, those of rest lengths nearer to 1.

    Their inputs have no limits, of which the proofs know nothing.
    """
    n = true.modules

    def factor(*shape: int, low: float = 0.6, high: float = 1.6) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), (count, *shape)))

    return dataclasses.replace(true, input_range=(-np.inf, np.inf)).scaled(
        mass=factor(n),
        inertia=factor(n),
        stiffness=factor(2, n),
        damping=factor(2, n),
        rest_length=factor(n, low=0.75, high=1.35),
    )


def layer_of(true: ArmParameters) -> np.ndarray:
    """The recommended boundary layer phi, shape (2N,) [m/s], [rad/s]."""
    return boundary_width(LagrangeModel(true))


def linear_gain_of(true: ArmParameters) -> np.ndarray:
    """K_v for a trial, (..., 2N): the recommended one, and none for an arm without dampers."""
    return linear_gain(LagrangeModel(true)) * np.any(true.damping > 0.0)


def sliding(at: Instants) -> Surface:
    """s = e' + lambda e and what follows from it, eqs (17), (18)."""
    e, e_dot = at.errors
    s = e_dot + LAMBDA * e
    return Surface(s, at.measurement.v - s, at.reference.a - LAMBDA * e_dot)


def integral_sliding(at: Instants) -> Surface:
    """s = e' + 2 lambda e + lambda^2 int e, eq (24) corrected."""
    e, e_dot = at.errors
    s = e_dot + 2.0 * LAMBDA * e + LAMBDA**2 * at.integral
    a_r = at.reference.a - 2.0 * LAMBDA * e_dot - LAMBDA**2 * e
    return Surface(s, at.measurement.v - s, a_r)


def energy_rate(at: Instants, surface: Surface, force: np.ndarray) -> np.ndarray:
    """d/dt (1/2 s^T D s) = s^T D s' + 1/2 s^T D' s of the true arm under `force`, (...) [W]."""
    _, q, v = at.measurement
    s, s_dot = surface.s, forward_dynamics(at.true, q, v, force) - surface.a_r
    D_dot = np.imag(mass_matrix(at.true, q + 1j * COMPLEX_STEP * v)) / COMPLEX_STEP
    return _product(s, mass_matrix(at.true, q), s_dot) + 0.5 * _product(s, D_dot, s)


def model_error(at: Instants, surface: Surface) -> np.ndarray:
    """F, what the nominal model gives too much along q_r', shape (..., 2N) [N], [N m]."""

    def force(p: ArmParameters) -> np.ndarray:
        _, q, v = at.measurement
        rates = coriolis_matrix(p, q, v) + damping_matrix(p)
        inertial = np.einsum("...ij,...j->...i", mass_matrix(p, q), surface.a_r)
        return inertial + np.einsum("...ij,...j->...i", rates, surface.v_r) + potential_force(p, q)

    return force(at.nominal) - force(at.true)


def damped(at: Instants, s: np.ndarray, K_v: Gain) -> np.ndarray:
    """s^T B s + s^T K_v s, what the true arm's dampers and the linear term take, (...) [W]."""
    return _product(s, damping_matrix(at.true), s) + np.sum(K_v * s * s, axis=-1)


def noticed(name: str, rate: np.ndarray, claim: np.ndarray) -> Check:
    """The row for the V' of a wrong law, which passes when it differs from the claim."""
    what = f"wrong, {name}: V' - claim (V' > 0 in {100.0 * np.mean(rate > 0.0):.1f} %)"
    return Check(what, _largest(rate - claim) / rms(claim), np.inf, NOTICED)


def proved(name: str, rate: np.ndarray, claim: np.ndarray, bound: np.ndarray) -> Iterator[Check]:
    """The rows for a right law: V' equals its claim, and never exceeds its bound."""
    yield Check(f"{name}: V' - claim", _largest(rate - claim) / rms(claim), EXACT)
    above = float(np.max(rate - bound)) / rms(claim)
    yield Check(f"{name}: largest V' - bound", above, EXACT)


def rms(x: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def _largest(x: np.ndarray) -> float:
    return float(np.max(np.abs(x)))


def _product(x: np.ndarray, matrix: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...ij,...j->...", x, matrix, y)
