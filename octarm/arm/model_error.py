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

from octarm.arm.lagrange import inertial_forces
from octarm.arm.parameters import ArmParameters
from octarm.arm.recursion import Row, plate_rows
from octarm.arrays import Entry, entry, join, split

# For each coordinate: sum_p F_ip and sum_p |F_ip| over some of the parameters.
_Terms = tuple[Sequence[Entry], Sequence[Entry]]


def largest_error(
    nominal: ArmParameters,
    uncertainty: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    a_r: np.ndarray,
    v_r: np.ndarray,
) -> np.ndarray:
    """The largest |F_i| over all arms that the uncertainty allows; for each i one attains it.

    For a share u in [0, 1), shape () or (..., 1) [1], and q, q', q_r'' and q_r' of shape (..., 2N)
    it is a generalised force of shape (..., 2N) [N], [N m].
    """
    n, entries = nominal.modules, nominal.entries
    x, rates = split(q), split(v_r)
    stretches = [x[i] - rest for i, rest in enumerate(entries.rest_length)]
    turns = [x[n + i] - rest for i, rest in enumerate(entries.rest_angle)]
    cos, sin = map(split, plate_rows(q))
    fx, fy, couple = (list[Entry]([0.0]) * n for _ in range(3))
    constants = map(split, nominal.inertial.arrays)
    inertial_forces(
        x, cos, sin, split(v), split(a_r), rates, *constants, fx=fx, fy=fy, couple=couple
    )
    inertial = _inertial_terms(x, cos, sin, fx, fy, couple)
    damping = _column_terms(entries.half_width, entries.damping, rates[:n], rates[n:])
    elastic = _column_terms(entries.half_width, entries.stiffness, stretches, turns)
    if not entries.plain:
        damping = _with_backbone(damping, entries.backbone_damping, rates)
        elastic = _with_backbone(elastic, entries.backbone_stiffness, [*stretches, *turns])
    u = entry(uncertainty[..., 0] if uncertainty.ndim else uncertainty)
    middle, half_width = _interval(u)
    middle_k, half_width_k = _interval(0.5 * u)  # stiffness is known twice as well
    largest: list[Entry] = []
    for i in range(2 * n):
        mean = middle * (inertial[0][i] + damping[0][i]) + middle_k * elastic[0][i]
        spread = half_width * (inertial[1][i] + damping[1][i]) + half_width_k * elastic[1][i]
        largest.append(abs(mean) + spread)
    batch = np.broadcast_shapes(nominal.batch_shape, np.shape(u))
    return join(largest, q, v.shape, a_r.shape, v_r.shape, (*batch, 2 * n))


def _interval(u: Entry) -> tuple[Entry, Entry]:
    rest = 1.0 - u * u
    return u * u / rest, u / rest


def _inertial_terms(x: Row, cos: Row, sin: Row, fx: Row, fy: Row, couple: Row) -> _Terms:
    """What each mass, gravity included, and each inertia contributes to the modules before it."""
    n = len(cos)
    sums: list[Entry] = [0.0] * (2 * n)
    sizes: list[Entry] = [0.0] * (2 * n)
    for b in range(n):
        moment, couple_size = 0.0, abs(couple[b])
        for j in range(b, -1, -1):
            push = fx[b] * cos[j] + fy[b] * sin[j]
            sums[j] = sums[j] + push
            sizes[j] = sizes[j] + abs(push)
            sums[n + j] = sums[n + j] + (moment + couple[b])
            sizes[n + j] = sizes[n + j] + (abs(moment) + couple_size)
            moment = moment + x[j] * (fy[b] * cos[j] - fx[b] * sin[j])
    return sums, sizes


def _column_terms(
    half: Sequence[Entry],
    coefficients: tuple[Sequence[Entry], Sequence[Entry]],
    along: Sequence[Entry],
    bend: Sequence[Entry],
) -> _Terms:
    """What the springs or dampers of the columns contribute, eqs (4) and (5)."""
    forces = [
        (left * (push + lever * turn), right * (push - lever * turn))
        for left, right, push, turn, lever in zip(*coefficients, along, bend, half, strict=True)
    ]
    sizes = [abs(first) + abs(second) for first, second in forces]
    pushes = [first + second for first, second in forces]
    couples = [
        lever * (first - second) for lever, (first, second) in zip(half, forces, strict=True)
    ]
    levers = [lever * size for lever, size in zip(half, sizes, strict=True)]
    return pushes + couples, sizes + levers


def _with_backbone(
    columns: _Terms, coefficients: tuple[Sequence[Entry], Sequence[Entry]], along: Sequence[Entry]
) -> _Terms:
    forces = [k * x for k, x in zip((*coefficients[0], *coefficients[1]), along, strict=True)]
    sums = [a + b for a, b in zip(columns[0], forces, strict=True)]
    return sums, [a + abs(b) for a, b in zip(columns[1], forces, strict=True)]


def straight_inertia(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """The diagonal of D for the modules of q in one straight line, shape (..., 2N).

    No bend of modules of these lengths makes an entry larger.
    """
    n, x, mass, inertia = p.modules, split(q), p.entries.mass, p.entries.inertia
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
