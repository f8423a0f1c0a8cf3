"""What theory says of an extensible rod that does not shear: exact statics, and beam modes.

The base frame has x along the hanging rod and y across it; see `octarm.arm.rod` for the rod. These
are the references that chains of modules are compared with; nothing here knows of modules.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root_scalar

from octarm.arm.rod import Rod
from octarm.errors import OctarmError

_STAGES = 10  # in which a load is put on, so that the secant method starts near each solution


def static_tip(rod: Rod, tip_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Tip of a clamped rod under dead loads: x, y and the angle there, shape (3,) [m], [m], [rad].

    The boundary-value problem in the unloaded arc length S, by shooting at a tolerance of 1e-12:

        p' = (1 + eps) u(phi),  phi' = m / EI,  m' = -(1 + eps) u(phi) x n,  eps = n.u(phi) / EA

    with the force n(S) of all loads beyond S; the clamp gives p(0) = 0 and phi(0) = 0, and the free
    end m(L) = 0. Loads are a force on the tip, shape (2,) [N], and an acceleration, shape (2,)
    [m/s^2]; the rod's own gravity does not count. Raises OctarmError if the shooting does not
    converge: the load is too large for one simple bow.
    """
    length = rod.length
    axial, bending = rod.at(rod.EA), rod.at(rod.EI)
    tip = float(np.broadcast_to(rod.density, 2)[1])

    def mass_beyond(x: float) -> float:
        return (length - x) * (0.5 * (rod.at(rod.density)(x) + tip))

    def end(moment: float, share: float) -> np.ndarray:
        def slope(x: float, state: np.ndarray) -> np.ndarray:
            n = share * (tip_force + mass_beyond(x) * gravity)
            u = np.array([np.cos(state[2]), np.sin(state[2])])
            stretch = 1.0 + (n @ u) / axial(x)
            turning = stretch * (u[0] * n[1] - u[1] * n[0])
            return np.array([*(stretch * u), state[3] / bending(x), -turning])

        start = [0.0, 0.0, 0.0, moment]
        solution = solve_ivp(slope, (0.0, length), start, method="DOP853", rtol=1e-12, atol=1e-14)
        return solution.y[:, -1]

    def remaining(moment: float, share: float) -> float:
        return float(end(moment, share)[3])

    moment = 0.0
    for share in np.arange(1, _STAGES + 1) / _STAGES:
        close = moment + 1e-6 * float(np.broadcast_to(rod.EI, 2)[0]) / length
        solution = root_scalar(
            remaining, args=(share,), x0=moment, x1=close, method="secant", xtol=1e-14
        )
        if not solution.converged:
            raise OctarmError("the static shape of the rod was not found; the load is too large")
        moment = solution.root
    return end(moment, 1.0)[:3]


def bending_frequencies(rod: Rod, count: int) -> np.ndarray:
    """The lowest frequencies of a uniform clamped-free Rayleigh beam, shape (count,) [Hz].

    EI w'''' + w^2 (rho I w'' - rho A w) = 0 with w = w' = 0 at the clamp and, at the free end,
    w'' = 0 and EI w''' + rho I w^2 w' = 0.
    """
    length, stiff, heavy, turning = _uniform(rod)

    def determinant(w: float) -> float:
        b = turning * w * w
        root = np.sqrt(b * b + 4.0 * stiff * heavy * w * w)
        a, c = np.sqrt((root - b) / (2.0 * stiff)), np.sqrt((root + b) / (2.0 * stiff))
        ch, sh = np.cosh(a * length), np.sinh(a * length)
        co, si = np.cos(c * length), np.sin(c * length)
        # The two shapes that the clamp allows: cosh(a x) - cos(c x), sinh(a x)/a - sin(c x)/c.
        moments = (a * a * ch + c * c * co, a * sh + c * si)
        shears = (
            stiff * (a**3 * sh - c**3 * si) + b * (a * sh + c * si),
            stiff * (a * a * ch + c * c * co) + b * (ch - co),
        )
        return float(moments[0] * shears[1] - moments[1] * shears[0]) / (ch * ch)

    roots: list[float] = []
    step = 0.1 * np.sqrt(stiff / heavy) / length**2  # a fraction of the first frequency
    low, before = step, determinant(step)
    while len(roots) < count:
        high = low + step
        after = determinant(high)
        if before * after < 0.0:
            roots.append(float(brentq(determinant, low, high, xtol=1e-12)))
        low, before = high, after
    return np.array(roots) / (2.0 * np.pi)


def axial_frequencies(rod: Rod, count: int) -> np.ndarray:
    """The lowest axial frequencies of a uniform clamped-free rod, shape (count,) [Hz]."""
    length, _, heavy, _ = _uniform(rod)
    odd = 2.0 * np.arange(1, count + 1) - 1.0
    return odd * np.sqrt(float(np.mean(rod.EA)) / heavy) / (4.0 * length)


def _uniform(rod: Rod) -> tuple[float, float, float, float]:
    profiles = (rod.EA, rod.EI, rod.density, rod.rotary_inertia)
    if any(np.ptp(np.broadcast_to(p, 2)) > 0.0 for p in profiles):
        raise OctarmError("beam theory needs a uniform rod; this one tapers")
    stiff, heavy, turning = (float(np.mean(p)) for p in profiles[1:])
    return rod.length, stiff, heavy, turning
