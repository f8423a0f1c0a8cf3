"""Statics and modes of chains of modules, which are compared with the rod that they stand for.

`halves_tip` is the statics of a third layout, which no arm has, with a hinge in the middle of each
module. Module i leads from there half along each plate, so that one coordinate drives two slides:

    p_i = p_(i-1) + (s_i / 2) (u(phi_(i-1)) + u(phi_i))

It is the trapezoidal rule on the rod's p' = (1 + eps) u(phi), and stretches up to the tip. So it is
of second order under every static load, and exact for weight along the rod.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh

from octarm.arm import lagrange
from octarm.arm.kinematics import jacobian, last_axis, positions, tip_force
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.errors import OctarmError

_STAGES = 10  # in which a load is put on


def static_tip(p: ArmParameters, end_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Tip of a chain under dead loads: x, y and the angle there, shape (3,) [m], [m], [rad].

    Loads are a force on the tip, shape (2,) [N], and an acceleration of the masses, shape (2,)
    [m/s^2]; the chain's own gravity does not count. See `lagrange.newton` for errors.
    """
    n, springs, b = p.modules, lagrange.stiffness_matrix(p), p.entries.tip_length
    rest = np.concatenate([p.rest_length, np.zeros(n)])
    fx, fy = map(float, end_force)

    def balance(q: np.ndarray, share: float) -> np.ndarray:
        weight = np.einsum("b,...bxi,x->...i", p.mass, jacobian(q), gravity)
        return (q - rest) @ springs - share * (weight + tip_force(q, fx, fy, b))

    q = _loaded(balance, rest)
    end = positions(q)[-1] + p.tip_length * np.array(last_axis(q))
    return np.append(end, np.sum(q[n:]))


def _loaded(balance: Callable[[np.ndarray, float], np.ndarray], rest: np.ndarray) -> np.ndarray:
    """Where the springs less a share of the loads balance, for the share 1, from rest.

    By Newton's method; slopes are imaginary parts at complex steps, exact to rounding.
    """
    q, steps = rest, 1e-30j * np.eye(len(rest))
    for share in np.arange(1, _STAGES + 1) / _STAGES:
        q = lagrange.newton(
            lambda q, f=share: (balance(q, f), np.imag(balance(q + steps, f)).T / 1e-30), q, 1e-13
        )
    return q


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
    """`static_tip` of a rod cut into N modules with a hinge in the middle of each, shape (3,).

    Each end of a module has half the mass of the modules beside it.
    """
    p, h = arm_from_rod(rod, modules), rod.length / modules
    axial, bending = np.split(np.diag(lagrange.stiffness_matrix(p)), 2)
    loads = 0.5 * (p.mass + np.append(p.mass[1:], 0.0))[:, None] * gravity
    loads[-1] += end_force
    carried = np.cumsum(loads[::-1], axis=0)[::-1]

    def balance(x: np.ndarray, share: float) -> np.ndarray:
        """Springs less loads by x = [s_1 .. s_N, phi_1 .. phi_N]."""
        s, phi = x[..., :modules], np.insert(x[..., modules:], 0, 0.0, axis=-1)
        cos, sin = np.cos(phi), np.sin(phi)
        fx, fy = 0.5 * share * carried.T
        along = fx * (cos[..., :-1] + cos[..., 1:]) + fy * (sin[..., :-1] + sin[..., 1:])
        across = fy * cos[..., 1:] - fx * sin[..., 1:]  # along the plate that ends the module
        before = fy * cos[..., :-1] - fx * sin[..., :-1]
        turn = np.diff(phi) * bending
        couples = turn - across * s
        couples[..., :-1] -= turn[..., 1:] + (before * s)[..., 1:]
        return np.concatenate([axial * (s - h) - along, couples], axis=-1)

    x = _loaded(balance, np.concatenate([np.full(modules, h), np.zeros(modules)]))
    phi = np.append(0.0, x[modules:])
    steps = [0.5 * x[:modules] * (f(phi[1:]) + f(phi[:-1])) for f in (np.cos, np.sin)]
    return np.array([np.sum(steps[0]), np.sum(steps[1]), phi[-1]])
