"""Statics and modes of chains of modules, which are compared with the rod that they stand for.

`halves_tip` is the statics of a third layout, which no arm has, with a hinge in the middle of each
module. Module i leads from there half along each plate, so that one coordinate drives two slides:

    p_i = p_(i-1) + (s_i / 2) (u(phi_(i-1)) + u(phi_i))

It is the trapezoidal rule on the rod's p' = (1 + eps) u(phi), and stretches up to the tip. So it is
of second order under every static load, and exact for weight along the rod.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from octarm.arm import lagrange
from octarm.arm.kinematics import tip_force
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
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


def halves_tip(rod: Rod, modules: int, end_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """The same for a rod that is cut into N modules with a hinge in the middle of each, shape (3,).

    Each end of a module has half the mass of the modules beside it.
    """
    p, h = arm_from_rod(rod, modules), rod.length / modules
    axial, bending = np.split(np.diag(lagrange.stiffness_matrix(p)), 2)
    nodes = 0.5 * (p.mass + np.append(p.mass[1:], 0.0))
    loads = nodes[:, None] * gravity
    loads[-1] += end_force
    carried = np.cumsum(loads[::-1], axis=0)[::-1]
    x = np.concatenate([np.full(modules, h), np.zeros(modules)])
    for share in np.arange(1, _STAGES + 1) / _STAGES:
        x = lagrange.newton(
            lambda x, f=share * carried: _halves_balance(x, axial, bending, h, f), x, 1e-13
        )
    phi = np.append(0.0, x[modules:])
    steps = [0.5 * x[:modules] * (f(phi[1:]) + f(phi[:-1])) for f in (np.cos, np.sin)]
    return np.array([np.sum(steps[0]), np.sum(steps[1]), phi[-1]])


def _halves_balance(
    x: np.ndarray, axial: np.ndarray, bending: np.ndarray, h: float, carried: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Hessian of springs less loads by x = [s_1 .. s_N, phi_1 .. phi_N]."""
    n = len(x) // 2
    s, phi = x[:n], np.append(0.0, x[n:])
    u = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    normal = np.stack([-u[:, 1], u[:, 0]], axis=-1)
    # Of each module: components of what it carries along and across the plate before and after it.
    along = [0.5 * np.sum(carried * axes, axis=-1) for axes in (u[:-1], u[1:])]
    across = [0.5 * np.sum(carried * axes, axis=-1) for axes in (normal[:-1], normal[1:])]
    turn = np.diff(phi) * bending
    later = np.append(across[0][1:] * s[1:], 0.0)
    couples = turn - np.append(turn[1:], 0.0) - across[1] * s - later
    gradient = np.concatenate([axial * (s - h) - along[0] - along[1], couples])
    hessian = np.zeros((2 * n, 2 * n))
    i = np.arange(n)
    hessian[i, i] = axial
    hessian[i, n + i] = hessian[n + i, i] = -across[1]
    hessian[i[1:], n + i[:-1]] = hessian[n + i[:-1], i[1:]] = -across[0][1:]
    hold = np.append(along[0][1:] * s[1:], 0.0)
    hessian[n + i, n + i] = bending + np.append(bending[1:], 0.0) + along[1] * s + hold
    hessian[n + i[1:], n + i[:-1]] = hessian[n + i[:-1], n + i[1:]] = -bending[1:]
    return gradient, hessian
