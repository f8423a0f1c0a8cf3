"""How wrong the nominal model can be: the bound (40) from a declared share, and what follows.

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

import functools
from collections.abc import Sequence

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.arrays import Entry, cos_sin, entry, join, split

# For each coordinate: sum_p F_ip and sum_p |F_ip| over some of the parameters.
_Terms = tuple[list[Entry], list[Entry]]


def largest_model_error(
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
    stretches = [x[i] - rest for i, rest in enumerate(split(nominal.rest_length))]
    inertial = _inertial_terms(nominal, x, split(v), split(a_r), rates)
    damping = _column_terms(nominal, nominal.damping, rates[:n], rates[n:])
    elastic = _column_terms(nominal, nominal.stiffness, stretches, x[n:])
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


def reaching_time_bound(
    nominal: ArmParameters, uncertainty: np.ndarray, eta: np.ndarray, q: np.ndarray, V: np.ndarray
) -> np.ndarray:
    """Longest time until s = 0, eqs (14) and (15) for a vector, shape (..., 1) [s].

    By (42) V' <= -y with y = sum eta_i |s_i|. On the set of all s with the same y, the convex
    V = 1/2 s^T D s is largest at a corner, where only one s_i differs from zero: V <= 1/2 L y^2
    with L = max D_ii / eta_i^2. Hence V' <= -sqrt(2 V / L), and V is zero after sqrt(2 L V) at
    most; for one coordinate this is D |s| / eta.

    D is neither known nor constant. All its entries and V are sums over masses and inertias,
    hence at most 1 / (1 - u) times the nominal ones. D_ii is taken at the straight arm, where it
    is largest for modules of these lengths. Only modules that lengthen on the way are not
    foreseen: the bound grows at most by the share by which they do. The bound is one of continuous
    time: under sampling the force is late, and s ends in the chattering about zero.

    Args:
        nominal: the model that the controller believes.
        uncertainty: share u in [0, 1), shape () or (..., 1) [1].
        eta: reaching gain, broadcasts to (..., 2N) [N], [N m].
        q: coordinates, shape (..., 2N) [m], [rad].
        V: 1/2 s^T D^ s, shape (..., 1) [J].
    """
    inertia = _straight_inertia(nominal, split(q))
    gains = split(eta) if eta.shape[-1:] == (len(inertia),) else [_one_an_arm(eta)] * len(inertia)
    L = functools.reduce(
        np.maximum, [D_ii / (eta_i * eta_i) for D_ii, eta_i in zip(inertia, gains, strict=True)]
    )
    known = np.asarray(1.0 - _one_an_arm(uncertainty))
    return np.sqrt(2.0 * np.asarray(L)[..., None] * V) / known[..., None]


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
    mass, inertia = split(p.mass), split(p.inertia)
    sums: list[Entry] = [0.0] * (2 * n)
    sizes: list[Entry] = [0.0] * (2 * n)
    axes: list[tuple[Entry, Entry]] = [(1.0, 0.0)]
    phi = w = w_r = alpha = 0.0
    ax, ay = -entry(p.gravity), 0.0
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
    p: ArmParameters, coefficient: np.ndarray, along: Sequence[Entry], bend: Sequence[Entry]
) -> _Terms:
    """What the springs or dampers of the columns contribute, eqs (4) and (5)."""
    half = 0.5 * entry(p.width)
    left, right = (split(coefficient[..., a, :]) for a in (0, 1))
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


def _straight_inertia(p: ArmParameters, x: Sequence[Entry]) -> list[Entry]:
    """The diagonal of D^ for modules of these lengths in one straight line."""
    n = p.modules
    mass, inertia = split(p.mass), split(p.inertia)
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
    return slides + bends
