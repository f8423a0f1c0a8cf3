"""How wrong a nominal model can be: the bound (40) from a declared share.

The generalised force is linear in masses, inertias, stiffnesses and dampings. With F_p for what
the nominal parameter p^ alone contributes to it, the error of the model is

    F = D~ q_r'' + (C~ + B~) q_r' + G~ = sum_p (1 - p / p^) F_p,    D~ = D^ - D, ...

An uncertainty u says that each nominal mass, inertia and damping lies within the share u of its
true value, |p^ - p| <= u p, and each stiffness within u/2: what `ArmParameters.mismatched` does for
a mismatch between -u and u. Then p / p^ lies between 1 / (1 + u) and 1 / (1 - u), an interval with
the middle 1 + u^2 / (1 - u^2) and the half width u / (1 - u^2), so that over all such arms

    max |F_i| = |sum_p u_p^2 / (1 - u_p^2) F_ip| + sum_p u_p / (1 - u_p^2) |F_ip|.

The sizes are added parameter by parameter, not matrix by matrix as in (39): an arm attains this
bound, so that no smaller gain will do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.arrays import Entry, cos_sin, entry, join, split

# For each coordinate: sum_p F_ip and sum_p |F_ip| over some of the parameters.
_Terms = tuple[list[Entry], list[Entry]]


def largest_error(
    nominal: ArmParameters,
    uncertainty: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    a_r: np.ndarray,
    v_r: np.ndarray,
) -> np.ndarray:
    """The largest |F_i| over all arms that the uncertainty allows; for each i one attains it.

    Args:
        nominal: the model that the controller believes.
        uncertainty: share u in [0, 1), shape () or (..., 1) [1].
        q: coordinates, shape (..., 2N) [m], [rad].
        v: velocities, shape (..., 2N) [m/s], [rad/s].
        a_r: q_r'', shape (..., 2N) [m/s^2], [rad/s^2].
        v_r: q_r', shape (..., 2N) [m/s], [rad/s].

    Returns:
        Generalised force, shape (..., 2N) [N], [N m].
    """
    n = nominal.modules
    x, rates = split(q), split(v_r)
    stretches = [x[i] - rest for i, rest in enumerate(nominal.entries.rest_length)]
    inertial = _inertial_terms(nominal, x, split(v), split(a_r), rates)
    damping = _column_terms(nominal, nominal.entries.damping, rates[:n], rates[n:])
    elastic = _column_terms(nominal, nominal.entries.stiffness, stretches, x[n:])
    u = _one_an_arm(uncertainty)
    middle, half_width = _interval(u)
    middle_k, half_width_k = _interval(0.5 * u)  # stiffness is known twice as well
    largest: list[Entry] = []
    for i in range(2 * n):
        mean = middle * (inertial[0][i] + damping[0][i]) + middle_k * elastic[0][i]
        spread = half_width * (inertial[1][i] + damping[1][i]) + half_width_k * elastic[1][i]
        largest.append(abs(mean) + spread)
    batch = np.broadcast_shapes(nominal.batch_shape, np.shape(u))
    return join(largest, q, v.shape, a_r.shape, v_r.shape, (*batch, 2 * n))


def _one_an_arm(value: np.ndarray) -> Entry:
    """The number or the array of numbers in an array of shape () or (..., 1)."""
    return entry(value if value.ndim == 0 else value[..., 0])


def _interval(u: Entry) -> tuple[Entry, Entry]:
    """Middle and half width of the interval of p / p^ - 1."""
    rest = 1.0 - u * u
    return u * u / rest, u / rest


def _inertial_terms(
    p: ArmParameters,
    x: Sequence[Entry],
    v: Sequence[Entry],
    a: Sequence[Entry],
    v_r: Sequence[Entry],
) -> _Terms:
    """What the masses, gravity included, and the inertias contribute; one pass outwards a mass.

    Outwards as in `lagrange.inverse_dynamics`; then each mass alone hangs on the modules below it.
    """
    n = p.modules
    mass, inertia = p.entries.mass, p.entries.inertia
    sums: list[Entry] = [0.0] * (2 * n)
    sizes: list[Entry] = [0.0] * (2 * n)
    axes: list[tuple[Entry, Entry]] = [(1.0, 0.0)]
    phi = w = w_r = alpha = 0.0
    ax, ay = -p.entries.gravity, 0.0
    for b in range(n):
        cos, sin = axes[b]
        along = a[b] - x[b] * (w * w_r)
        across = x[b] * alpha + (v[b] * w_r + v_r[b] * w)
        ax = ax + (along * cos - across * sin)
        ay = ay + (along * sin + across * cos)
        w, w_r, alpha = w + v[n + b], w_r + v_r[n + b], alpha + a[n + b]
        fx, fy, couple = mass[b] * ax, mass[b] * ay, inertia[b] * alpha
        moment, couple_size = 0.0, abs(couple)
        for j in reversed(range(b + 1)):
            cos, sin = axes[j]
            push = fx * cos + fy * sin
            sums[j] = sums[j] + push
            sizes[j] = sizes[j] + abs(push)
            sums[n + j] = sums[n + j] + (moment + couple)
            sizes[n + j] = sizes[n + j] + (abs(moment) + couple_size)
            moment = moment + x[j] * (fy * cos - fx * sin)
        if b + 1 < n:
            phi = phi + x[n + b]
            axes.append(cos_sin(phi))
    return sums, sizes


def _column_terms(
    p: ArmParameters,
    coefficients: tuple[Sequence[Entry], Sequence[Entry]],
    along: Sequence[Entry],
    bend: Sequence[Entry],
) -> _Terms:
    """What the springs or dampers of the columns contribute, eqs (4) and (5)."""
    half, (left, right) = p.entries.half_width, coefficients
    pushes: list[Entry] = []
    couples: list[Entry] = []
    push_sizes: list[Entry] = []
    couple_sizes: list[Entry] = []
    for i in range(p.modules):
        first = left[i] * (along[i] + half * bend[i])
        second = right[i] * (along[i] - half * bend[i])
        size = abs(first) + abs(second)
        pushes.append(first + second)
        push_sizes.append(size)
        couples.append(half * (first - second))
        couple_sizes.append(half * size)
    return pushes + couples, push_sizes + couple_sizes


def straight_inertia(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """The diagonal of D for the modules of q in one straight line, shape (..., 2N).

    No bend of modules of these lengths makes an entry larger.
    """
    n = p.modules
    x, mass, inertia = split(q), p.entries.mass, p.entries.inertia
    slides: list[Entry] = []
    bends: list[Entry] = []
    for k in range(n):
        total = turned = lever = 0.0
        for b in range(k, n):
            lever = lever + abs(x[b]) if b > k else 0.0
            total = total + mass[b]
            turned = turned + (inertia[b] + mass[b] * (lever * lever))
        slides.append(total)
        bends.append(turned)
    return join(slides + bends, q, (*p.batch_shape, 2 * n))
