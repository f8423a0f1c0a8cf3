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
from octarm.arm.kinematics import tip_force
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.errors import OctarmError

_STAGES = 10  # in which a load is put on


def static_tip(p: ArmParameters, end_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Tip of a chain under dead loads: x, y and the angle there, shape (3,) [m], [m], [rad].

    Loads are a force on the tip, shape (2,) [N], and an acceleration of the masses, shape (2,)
    [m/s^2]; the chain's own gravity does not count. See `lagrange.newton` for errors.
    """
    n, springs = p.modules, lagrange.stiffness_matrix(p)
    rest = np.concatenate([p.rest_length, np.zeros(n)])
    loads = np.concatenate([p.mass[:, None] * gravity, end_force[None, :]])
    carried = np.cumsum(loads[::-1], axis=0)[::-1]  # by each segment, the tip piece last

    def segments(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lengths and angles of the modules and the tip piece."""
        return (
            np.insert(q[..., :n], n, p.tip_length, axis=-1),
            np.insert(np.cumsum(q[..., n:], axis=-1), 0, 0.0, axis=-1),
        )

    def balance(q: np.ndarray, share: float) -> np.ndarray:
        lengths, phi = segments(q)
        along, across = _components(share * carried, phi)
        turning = np.cumsum((lengths * across)[..., ::-1], axis=-1)[..., ::-1]
        loads = np.concatenate([along[..., :n], turning[..., 1:]], axis=-1)
        return (q - rest) @ springs - loads

    lengths, phi = segments(_loaded(balance, rest))
    return np.array([lengths @ np.cos(phi), lengths @ np.sin(phi), phi[-1]])


def _components(force: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of forces, shape (k, 2), along plates and across them, for angles of shape (..., k)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return cos * force[:, 0] + sin * force[:, 1], cos * force[:, 1] - sin * force[:, 0]


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
    """The same for a rod that is cut into N modules with a hinge in the middle of each, shape (3,).

    Each end of a module has half the mass of the modules beside it.
    """
    p, h = arm_from_rod(rod, modules), rod.length / modules
    axial, bending = np.split(np.diag(lagrange.stiffness_matrix(p)), 2)
    nodes = 0.5 * (p.mass + np.append(p.mass[1:], 0.0))
    loads = nodes[:, None] * gravity
    loads[-1] += end_force
    carried = np.cumsum(loads[::-1], axis=0)[::-1]

    def balance(x: np.ndarray, share: float) -> np.ndarray:
        """Springs less loads by x = [s_1 .. s_N, phi_1 .. phi_N]."""
        s, phi = x[..., :modules], np.insert(x[..., modules:], 0, 0.0, axis=-1)
        halves = [_components(0.5 * share * carried, x) for x in (phi[..., :-1], phi[..., 1:])]
        (along, before), (along_after, after) = halves
        turn = np.diff(phi) * bending
        couples = turn - after * s
        couples[..., :-1] -= turn[..., 1:] + (before * s)[..., 1:]
        return np.concatenate([axial * (s - h) - along - along_after, couples], axis=-1)

    x = _loaded(balance, np.concatenate([np.full(modules, h), np.zeros(modules)]))
    phi = np.append(0.0, x[modules:])
    steps = [0.5 * x[:modules] * (f(phi[1:]) + f(phi[:-1])) for f in (np.cos, np.sin)]
    return np.array([np.sum(steps[0]), np.sum(steps[1]), phi[-1]])
