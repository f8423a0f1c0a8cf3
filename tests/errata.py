"""Eqs (2)-(5) twice, for N = 3: as the paper prints them, and derived from energies and work.

Printed: transcribed entry by entry, with two repairs that the text needs before it has units at
all: `l`, which it shows as 1 (1/2 for l/2, 1^2/4 for l^2/4), and the dot on every theta that
multiplies a mass in eq (4), written w here. Nothing else is repaired.

Derived: with u(a) = (cos a, sin a) and phi_i = theta_1 + .. + theta_i,

    p_i = p_{i-1} + s_i u(phi_{i-1})
    T = 1/2 sum m_i |p_i'|^2 + I_i phi_i'^2
    V = -g u(0).sum m_i p_i + 1/2 sum k_ai (L_ai - s0_i)^2
    R = 1/2 sum c_ai L_ai'^2,    L_1i, L_2i = s_i +- (l/2) theta_i

and column (a, i) of F_coeff from the virtual work of a unit force on p_i along u(phi_{i-1}) and a
couple +-l/2 on plate i, both reacting on the ground.

CORRECTIONS lists what the printed matrices should say where they are wrong.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping

import sympy as sp

m = m1, m2, m3 = sp.symbols("m1:4")
inertia = I1, I2, I3 = sp.symbols("I1:4")
k1 = k11, k12, k13 = sp.symbols("k11:14")
k2 = k21, k22, k23 = sp.symbols("k21:24")
c1 = c11, c12, c13 = sp.symbols("c11:14")
c2 = c21, c22, c23 = sp.symbols("c21:24")
rest = s01, s02, s03 = sp.symbols("s01 s02 s03")  # "s01:04" would be s1, s2, s3
width, g = sp.symbols("l g")
q = s1, s2, s3, t1, t2, t3 = sp.symbols("s1:4 t1:4")
v = v1, v2, v3, w1, w2, w3 = sp.symbols("v1:4 w1:4")
stray = sp.Symbol("I")  # stands alone, without index, in the printed D(5,4)

PARAMETERS = (*m, *inertia, width, *k1, *k2, *c1, *c2, *rest, g)

Matrix = sp.Matrix | sp.ImmutableMatrix
Entries = set[tuple[int, int]]

sin1, cos1, sin2, cos2 = sp.sin(t1), sp.cos(t1), sp.sin(t2), sp.cos(t2)
sin12, cos12 = sp.sin(t1 + t2), sp.cos(t1 + t2)


def printed_force_coefficients() -> sp.Matrix:
    """Eq (2)."""
    a = width / 2
    return sp.Matrix(
        [
            [1, 1, cos1, cos1, cos12, cos12],
            [0, 0, 1, 1, cos2, cos2],
            [0, 0, 0, 0, 1, 1],
            [a, -a, a, -a, a + s2 * sin2, -a + s2 * sin2],
            [0, 0, a, -a, a, -a],
            [0, 0, 0, 0, a, -a],
        ]
    )


def printed_mass_matrix() -> sp.Matrix:
    """Eq (3); its first row has only five entries, the missing one reads as 0."""
    d14 = -m2 * s2 * sin1 - m3 * s2 * sin1 - m3 * s3 * sin12
    d44 = m2 * s2**2 + I1 + I2 + I3 + m3 * s2**2 + m3 * s3**2 + 2 * m3 * s3 * cos2 * s2
    d45 = I2 + m3 * s3**2 + I3 + m3 * s3 * cos2 * s2
    d54 = I2 + m3 * s3**2 + I3 + m3 * s3 * cos2 * s2 * stray
    d55 = I2 + m3 * s3**2 + I3
    slide = m2 * cos1 + m3 * cos1
    return sp.Matrix(
        [
            [m1 + m2 + m3, slide, m3 * cos12, d14, 0, 0],
            [slide, m2 + m3, m3 * cos2, -m3 * s3 * sin2, -m3 * s3 * sin2, 0],
            [m3 * cos12, m3 * cos2, m3, m3 * s3 * sin2, 0, 0],
            [d14, -m3 * s3 * sin2, m3 * s2 * sin2, d44, d45, I3],
            [-m3 * s3 * sin12, -m3 * s3 * sin2, 0, d54, d55, I3],
            [0, 0, 0, I3, I3, I3],
        ]
    )


def printed_rate_matrix() -> sp.Matrix:
    """Eq (4): what multiplies q', Coriolis terms and damping together."""
    a, b = width / 2, width**2 / 4
    return sp.Matrix(
        [
            [
                c11 + c21,
                -2 * m2 * sin1 * w1 - 2 * m3 * sin1 * w1,
                -2 * m3 * sin12 * (w1 + w2),
                -m2 * s2 * cos1 * w1 + a * (c11 + c21) - m3 * s2 * cos1 * w1 - m3 * s3 * cos12 * w1,
                -m3 * s3 * sin12,
                0,
            ],
            [
                0,
                c12 + c22,
                -2 * m3 * sin2 * (w1 + w2),
                -m3 * s3 * w1 + a * (c12 + c22) - m3 * s2 * w1 - m3 * s3 * cos2 * w1,
                -2 * m3 * s3 * cos2 * w1,
                0,
            ],
            [
                0,
                2 * m3 * sin2 * w1,
                c13 + c23,
                -m3 * s3 * s2 * cos2 * w1 - m3 * s3 * w1,
                -2 * m3 * s3 * w1 - m3 * s3 * w2,
                a * (c13 + c23),
            ],
            [
                a * (c11 + c21),
                2 * m3 * s3 * cos2 * w1 - 2 * m3 * s2 * w1 + 2 * m2 * s2 * w1,
                2 * m3 * s3 * (w1 + w2) - 2 * m3 * s2 * cos2 * (w1 + w2),
                2 * m3 * s3 * s2 * sin2 * w2 + b * (c11 + c21),
                m3 * s3 * s2 * sin2 * w2,
                0,
            ],
            [
                0,
                a * (c12 + c22) + 2 * m3 * s3 * cos2 * w1,
                2 * m3 * s3 * (w1 + w2),
                m3 * s3 * s2 * sin2 * w1,
                b * (c12 + c22),
                0,
            ],
            [0, 0, a * (c13 - c23), 0, 0, b * (c13 + c23)],
        ]
    )


def printed_potential_force() -> sp.Matrix:
    """Eq (5)."""
    a = width / 2
    left = [k1[i] * (q[i] + a * q[3 + i] - rest[i]) for i in range(3)]
    right = [k2[i] * (q[i] - a * q[3 + i] - rest[i]) for i in range(3)]
    return sp.Matrix(
        [
            -m1 * g - m2 * g + left[0] + right[0] - m3 * g,
            -m2 * g * cos1 + left[1] + right[1] - m3 * g * cos1,
            -m3 * g * cos12 + left[2] + right[2],
            m2 * s2 * g * sin1
            + m3 * s3 * g * sin12
            + m3 * s2 * g * sin1
            + left[0] * a
            + right[0] * -a,
            m3 * s3 * g * sin12 + left[1] * a + right[1] * -a,
            left[2] * a + right[2] * -a,
        ]
    )


# Row and column, counted from 1 as in the paper: what the entry should say.
CORRECTIONS: dict[str, dict[tuple[int, int], sp.Expr]] = {
    "F_coeff": {},
    "D": {
        (1, 5): -m3 * s3 * sin12,
        (3, 4): m3 * s2 * sin2,
        (5, 4): I2 + m3 * s3**2 + I3 + m3 * s3 * cos2 * s2,
    },
    "C": {
        (1, 4): -m2 * s2 * cos1 * w1
        - m3 * s2 * cos1 * w1
        - m3 * s3 * cos12 * w1
        + width / 2 * (c11 - c21),
        (1, 5): -m3 * s3 * cos12 * (2 * w1 + w2),
        (2, 4): -m2 * s2 * w1 - m3 * s2 * w1 - m3 * s3 * cos2 * w1,
        (2, 5): -m3 * s3 * cos2 * (2 * w1 + w2) + width / 2 * (c12 - c22),
        (3, 4): -m3 * s2 * cos2 * w1 - m3 * s3 * w1,
        (3, 6): width / 2 * (c13 - c23),
        (4, 1): width / 2 * (c11 - c21),
        (4, 2): 2 * m3 * s3 * cos2 * w1 + 2 * m3 * s2 * w1 + 2 * m2 * s2 * w1,
        (4, 3): 2 * m3 * s3 * (w1 + w2) + 2 * m3 * s2 * cos2 * (w1 + w2),
        (4, 4): -2 * m3 * s2 * s3 * sin2 * w2 + width**2 / 4 * (c11 + c21),
        (4, 5): -m3 * s2 * s3 * sin2 * w2,
        (5, 2): width / 2 * (c12 - c22) + 2 * m3 * s3 * cos2 * w1,
    },
    "G": {},
}


def _positions() -> list[sp.Matrix]:
    point, angle, points = sp.zeros(2, 1), sp.Integer(0), []
    for i in range(3):
        point = point + q[i] * sp.Matrix([sp.cos(angle), sp.sin(angle)])
        angle = angle + q[3 + i]
        points.append(point)
    return points


def rate(x: sp.Expr) -> sp.Expr:
    """The time derivative of a function of q, with q' = v."""
    return sp.Add(*(sp.diff(x, a) * b for a, b in zip(q, v, strict=True)))


def _kinetic() -> sp.Expr:
    turning = list(itertools.accumulate(v[3:]))
    moving = [p.applyfunc(rate) for p in _positions()]
    twice = (m[i] * moving[i].dot(moving[i]) + inertia[i] * turning[i] ** 2 for i in range(3))
    return sp.Add(*twice) / 2


def _column_energy(first: tuple, second: tuple, x: tuple, zero: tuple) -> sp.Expr:
    """1/2 sum coefficient (L_ai - zero_i)^2 with L of the coordinates or rates x."""
    ahead = [first[i] * (x[i] + width / 2 * x[3 + i] - zero[i]) ** 2 for i in range(3)]
    behind = [second[i] * (x[i] - width / 2 * x[3 + i] - zero[i]) ** 2 for i in range(3)]
    return sp.Add(*ahead, *behind) / 2


@functools.cache
def derived_mass_matrix() -> sp.ImmutableMatrix:
    """D = d2T/dv dv."""
    return sp.ImmutableMatrix(sp.hessian(_kinetic(), v).applyfunc(tidy))


@functools.cache
def derived_velocity_force() -> sp.ImmutableMatrix:
    """h = d/dt dT/dv - dT/dq without the accelerations: the vector C q', whatever C is."""
    kinetic = _kinetic()
    return sp.ImmutableMatrix(
        [tidy(rate(sp.diff(kinetic, v[i])) - sp.diff(kinetic, q[i])) for i in range(6)]
    )


@functools.cache
def derived_christoffel() -> sp.ImmutableMatrix:
    """C_ij = 1/2 sum_k (dD_ij/dq_k + dD_ik/dq_j - dD_jk/dq_i) v_k."""
    d = derived_mass_matrix()

    def entry(i: int, j: int) -> sp.Expr:
        brackets = (
            sp.diff(d[i, j], q[k]) + sp.diff(d[i, k], q[j]) - sp.diff(d[j, k], q[i])
            for k in range(6)
        )
        return sp.Add(*(bracket * v[k] / 2 for k, bracket in enumerate(brackets)))

    return sp.ImmutableMatrix(6, 6, lambda i, j: sp.expand(entry(int(i), int(j))))


@functools.cache
def derived_damping() -> sp.ImmutableMatrix:
    """B = d2R/dv dv."""
    return sp.ImmutableMatrix(sp.hessian(_column_energy(c1, c2, v, (0, 0, 0)), v))


@functools.cache
def derived_potential_force() -> sp.ImmutableMatrix:
    """G = dV/dq."""
    weight = sum(m[i] * point[0] for i, point in enumerate(_positions()))
    potential = _column_energy(k1, k2, q, rest) - g * weight
    return sp.ImmutableMatrix([sp.diff(potential, x) for x in q])


@functools.cache
def derived_force_coefficients() -> sp.ImmutableMatrix:
    """F_coeff by virtual work."""
    columns = []
    for i, point in enumerate(_positions()):
        parent, plate = sum(q[3 : 3 + i]), sum(q[3 : 4 + i])
        push = point.jacobian(q).T * sp.Matrix([sp.cos(parent), sp.sin(parent)])
        turn = sp.Matrix([plate]).jacobian(q).T * width / 2
        columns += [push + turn, push - turn]
    return sp.ImmutableMatrix(sp.Matrix.hstack(*columns))


# Where the paper puts the products theta_1' theta_2', which either column could hold.
PAPER_PLACEMENT = (4, 4, 4, 3, 4, 4)


def rate_matrix_in_paper_layout(placement: tuple[int, ...] = PAPER_PLACEMENT) -> sp.Matrix:
    """The C of eq (4) that satisfies C q' = h + B q', laid out as the paper lays it out.

    Products s_i' theta_j' stand whole in the column of s_i, squares theta_j'^2 in that of theta_j,
    and products theta_1' theta_2' of row r in the column placement[r].
    """
    out = sp.Matrix(derived_damping())
    forces = derived_velocity_force()
    for row in range(6):
        force = forces[row, 0]
        if force == 0:
            continue
        for powers, coefficient in sp.Poly(force, *v).terms():
            first, second = (i for i in range(6) for _ in range(powers[i]))
            column = placement[row] if (first, second) == (3, 4) else first
            other = first + second - column
            out[row, column] += coefficient * v[other]
    return out


def tidy(x: sp.Expr) -> sp.Expr:
    """The normal form of a polynomial in sines and cosines of t1 and t2: 0 if and only if zero."""
    x = sp.expand(sp.expand_trig(x))
    for angle in (t1, t2):
        sine, cosine = sp.sin(angle), sp.cos(angle)
        x = sp.expand(
            x.replace(
                lambda e, s=sine: e.is_Pow and e.base == s and e.exp >= 2,
                lambda e, c=cosine: (1 - c**2) ** (e.exp // 2) * e.base ** (e.exp % 2),
            )
        )
    return x


def differing_entries(left: Matrix, right: Matrix) -> Entries:
    """The entries, counted from 1, in which two matrices differ as functions."""
    difference = left - right
    return {
        (i + 1, j + 1)
        for i, j in itertools.product(*map(range, difference.shape))
        if tidy(difference[i, j]) != 0
    }


def corrected(matrix: sp.Matrix, corrections: Mapping[tuple[int, int], sp.Expr]) -> sp.Matrix:
    """A printed matrix with corrections put in."""
    out = sp.Matrix(matrix)
    for (i, j), entry in corrections.items():
        out[i - 1, j - 1] = entry
    return out
