"""How a chain of modules converges to the rod that it stands for: statics and modes."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from octarm.arm import lagrange
from octarm.arm.kinematics import tip_force
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError

_STAGES = 10  # in which a load is put on


def static_tip(p: ArmParameters, end_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Tip of a chain under dead loads: x, y and the angle there, shape (3,) [m], [m], [rad].

    By Newton's method on the stationary point of springs less loads; see `lagrange.newton` for
    errors. Loads are a force on the tip, shape (2,) [N], and an acceleration of the masses, shape
    (2,) [m/s^2]; the chain's own gravity does not count.
    """
    n = p.modules
    loads = np.concatenate([p.mass[:, None] * gravity, end_force[None, :]])
    q = np.concatenate([p.rest_length, np.zeros(n)])
    for share in np.arange(1, _STAGES + 1) / _STAGES:
        carried = (
            share * np.cumsum(loads[::-1], axis=0)[::-1]
        )  # by each segment, the tip piece last
        q = lagrange.newton(lambda q, f=carried: _static_balance(p, q, f), q, 1e-13)
    phi = np.concatenate([[0.0], np.cumsum(q[n:])])
    segments = np.append(q[:n], p.tip_length)
    return np.array([segments @ np.cos(phi), segments @ np.sin(phi), phi[-1]])


def _static_balance(
    p: ArmParameters, q: np.ndarray, carried: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Hessian of V = springs - loads, from what segments carry, shape (N + 1, 2)."""
    n = p.modules
    phi = np.concatenate([[0.0], np.cumsum(q[n:])])
    axes = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    normals = np.stack([-axes[:, 1], axes[:, 0]], axis=-1)
    segments = np.append(q[:n], p.tip_length)
    along, across = np.sum(carried * axes, axis=-1), np.sum(carried * normals, axis=-1)

    def beyond(x: np.ndarray) -> np.ndarray:
        """Sums over the segments that turn with each hinge, shape (N,)."""
        return np.cumsum(x[::-1])[::-1][1:]

    springs = lagrange.stiffness_matrix(p)
    rest = np.concatenate([p.rest_length, np.zeros(n)])
    gradient = springs @ (q - rest) - np.concatenate([along[:n], beyond(segments * across)])
    hessian = springs.copy()
    swing = np.tril(np.broadcast_to(across[:n, None], (n, n)), -1)  # slide j turns with hinge k < j
    hessian[:n, n:] -= swing
    hessian[n:, :n] -= swing.T
    later = np.maximum.outer(np.arange(n), np.arange(n))
    hessian[n:, n:] += beyond(segments * along)[later]
    return gradient, hessian


def frequencies(p: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Bending and axial frequencies of the straight chain without weight, of shape (N,) each [Hz].

    Raises OctarmError if the columns of a module differ, so that bending and stretching couple.
    """
    n = p.modules
    if not np.array_equal(p.stiffness[0], p.stiffness[1]):
        raise OctarmError("the modes of a rod need modules whose two columns have one stiffness")
    q = np.concatenate([p.rest_length, np.zeros(n)])
    inertia, stiffness = lagrange.mass_matrix(p, q), lagrange.stiffness_matrix(p)
    kinds = (slice(n, None), slice(n))
    squares = [eigh(stiffness[k, k], inertia[k, k], eigvals_only=True) for k in kinds]
    bending, axial = (np.sqrt(square) / (2.0 * np.pi) for square in squares)
    return bending, axial


def tip_compliance(p: ArmParameters) -> float:
    """Deflection of the tip of the straight chain by a small force across it [m/N].

    By the slope of the springs' forces: y = J^T K^-1 J for the generalised force J of 1 N.
    """
    q = np.concatenate([p.rest_length, np.zeros(p.modules)])
    force = tip_force(q, 0.0, 1.0, p.entries.tip_length)
    return float(force @ np.linalg.solve(lagrange.stiffness_matrix(p), force))
