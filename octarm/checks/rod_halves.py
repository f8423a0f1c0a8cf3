"""The statics of a third layout, in which a hinge stands in the middle of each module.

Module i leads from the middle of its hinge half along each plate, so that one coordinate drives two
slides, which MuJoCo has only through constraints:

    p_i = p_(i-1) + (s_i / 2) (u(phi_(i-1)) + u(phi_i))

It is the trapezoidal rule on the rod's p' = (1 + eps) u(phi), and stretches up to the tip. So it is
of second order under every static load, and exact for weight along the rod: what the layouts that
an arm can have are compared with.
"""

from __future__ import annotations

import numpy as np

from octarm.arm import lagrange
from octarm.arm.rod import Rod, arm_from_rod

_STAGES = 10  # in which a load is put on


def static_tip(rod: Rod, modules: int, end_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Tip under dead loads: x, y and the angle there, shape (3,) [m], [m], [rad].

    Args:
        rod: that is cut into modules; its own gravity does not count.
        modules: their number N.
        end_force: dead force on the tip, shape (2,) [N].
        gravity: acceleration of the masses, shape (2,) [m/s^2]. Each end of a module has half the
            mass of the modules beside it.

    Raises:
        OctarmError: if there is no such shape.
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
            lambda x, f=share * carried: _balance(x, axial, bending, h, f), x, 1e-13
        )
    phi = np.append(0.0, x[modules:])
    steps = [0.5 * x[:modules] * (f(phi[1:]) + f(phi[:-1])) for f in (np.cos, np.sin)]
    return np.array([np.sum(steps[0]), np.sum(steps[1]), phi[-1]])


def _balance(
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
