"""One RK4 step of many arms by the equations of `octarm.arm.lagrange`, compiled.

The acceleration comes from a recursion in O(N) that uses how the arm is built: the mass of a module
is at its hinge, and its inertia turns with its plate. Write module i in the axes u, n of plate
i-1, with a, alpha the accelerations of that plate, w its rate, f, c the force on s_i and the couple
on theta_i, and f', c' what the next module's force and couple put on plate i. From the tip inwards,
what plate i feels of the next module across its axis is R' = mu' (a_i.n_i + s' alpha_i) + beta':

    J = I + mu' s'^2,  k = mu' I / J,  b = (I beta' + mu' s' t) / J         t = c - c'
    d = m + k sin^2 theta,  e = k sin theta cos theta / d,  p = f - f' cos theta + b sin theta
    mu = m (m + k) / d,  beta = f' sin theta + b cos theta - e p + 2 mu s_i' w

and from the base outwards, with y = a.n + s alpha + 2 s' w and x = p / d + e y,

    s'' = x - a.u + s w^2,   a_i = (x, y),   alpha_i = (t - s' beta' - s' mu' a_i.n_i) / J

All operations are those of IEEE 754 arithmetic, cosine and sine included: they are rounded alike in
every lane, for every number of arms and on every processor. Arms are computed `LANES` at a time,
which suits the vector registers. What is needed of them lies in one block `w` of a record per
module, so that the compiler sees that nothing overlaps; indices are unsigned because signed ones
may count from the end. Record 0 is the base, record N + 1 stands for what is beyond the tip.
"""
# pyright: basic
# (numba has no types)

from __future__ import annotations

import functools
import math

import numba
import numpy as np

from octarm.arm.recursion import kept

LANES = 16

_FIELDS = 50  # of a record, each of which has a place for every lane
(
    S, T, VS, VT, S0, T0, VS0, VT0, DS, DT, DVS, DVT,  # state, at the start, mean derivative
    MASS, INERTIA, KS, KD, KT, CS, CD, CT, REST_S, REST_T, HALF,  # the plant: see `rk4_step`
    LOW_S, LOW_T, HIGH_S, HIGH_T, FAST_S, FAST_T, INSIDE,  # its limits, and whether they hold
    FS, FT, RS, RT,  # force and couple that are held, and the parts that act on the ground
    QS, QT, C, SN, W, P, E, MU, BETA, A0, A1, AX, AY, ALPHA, AS, AT,  # of a stage; s'', theta''
) = (np.uint64(i * LANES) for i in range(_FIELDS))  # fmt: skip
PLANT_ROWS = 17
_RECORD = np.uint64(_FIELDS * LANES)
_LANES, _ONE, _TWO, _ZERO = np.uint64(LANES), np.uint64(1), np.uint64(2), np.uint64(0)

# Angles are reduced by multiples of pi/2, in two parts: the first one has 33 bits, so that its
# multiples are exact. Adding and taking off 1.5 2^52 rounds to a whole number.
_TWO_OVER_PI = 2.0 / math.pi
_HALF_PI = float.fromhex("0x1.921fb544p+0")
_HALF_PI_REST = 6.077100506506192e-11
_ROUND = 1.5 * 2.0**52
# The Taylor series of sin(r)/r and cos(r) on |r| < pi/4, good to an error of 1e-17.
_S3, _S5, _S7, _S9, _S11, _S13, _S15 = (
    (-1) ** (k // 2) / math.factorial(k) for k in range(3, 16, 2)
)
_C2, _C4, _C6, _C8, _C10, _C12, _C14, _C16 = (
    (-1) ** (k // 2) / math.factorial(k) for k in range(2, 17, 2)
)


# The inner functions have no files of their own: two processes that compile at once could leave a
# mix of files that do not fit together. That of `rk4_step` holds all.
_inner = numba.njit(nogil=True)


def work_space(modules: int) -> np.ndarray:
    """Memory for `rk4_step`, shape (k,); every thread needs one."""
    return np.zeros((modules + 2) * int(_RECORD))


@numba.njit(inline="always")  # or the loop around it would not become one of vectors
def cos_sin(x):
    """Cosine and sine of an angle [rad] within +-1e5, to an error of 2e-16."""
    n = (x * _TWO_OVER_PI + _ROUND) - _ROUND
    r = (x - n * _HALF_PI) - n * _HALF_PI_REST
    quarter = n - 4.0 * ((0.25 * n + _ROUND) - _ROUND)  # -2 .. 2
    z = r * r
    c = _C10 + z * (_C12 + z * (_C14 + z * _C16))
    c = 1.0 + z * (_C2 + z * (_C4 + z * (_C6 + z * (_C8 + z * c))))
    s = _S9 + z * (_S11 + z * (_S13 + z * _S15))
    s = r + r * (z * (_S3 + z * (_S5 + z * (_S7 + z * s))))
    turned, half = abs(quarter) == 1.0, abs(quarter) == 2.0
    cos = s if turned else c
    sin = c if turned else s
    cos = -cos if (half or quarter == 1.0) else cos
    sin = -sin if (half or quarter == -1.0) else sin
    return cos, sin


@_inner
def _accelerate(w, n):
    """AS and AT of all modules at the state of the stage."""
    for i in range(_ONE, n):
        at = i * _RECORD
        for k in range(_LANES):
            w[at + C + k], w[at + SN + k] = cos_sin(w[at + T + k])
    for i in range(_ONE, n + _ONE):
        at = i * _RECORD
        before = at - _RECORD
        for k in range(_LANES):
            stretch, bend = w[at + S + k] - w[at + REST_S + k], w[at + T + k] - w[at + REST_T + k]
            vs, vt = w[at + VS + k], w[at + VT + k]
            spring = w[at + KS + k] * stretch + w[at + KD + k] * bend
            damper = w[at + CS + k] * vs + w[at + CD + k] * vt
            w[at + QS + k] = w[at + FS + k] - (spring + damper)
            spring = w[at + KD + k] * stretch + w[at + KT + k] * bend
            damper = w[at + CD + k] * vs + w[at + CT + k] * vt
            w[at + QT + k] = w[at + FT + k] - (spring + damper)
            w[at + W + k] = w[before + W + k] + vt
    for j in range(_ZERO, n):
        at = (n - j) * _RECORD
        before, after = at - _RECORD, at + _RECORD
        for k in range(_LANES):
            c, s = w[at + C + k], w[at + SN + k]
            m, inertia = w[at + MASS + k], w[at + INERTIA + k]
            length, mu, beta = w[after + S + k], w[after + MU + k], w[after + BETA + k]
            couple = w[at + QT + k] - (w[after + QT + k] - w[after + RT + k])
            pull = w[after + QS + k] - w[after + RS + k]
            mass_lever = mu * length
            by_j = 1.0 / (inertia + mass_lever * length)
            stiff = mu * inertia * by_j
            b = (inertia * beta + mass_lever * couple) * by_j
            w[at + A0 + k] = (couple - length * beta) * by_j
            w[at + A1 + k] = mass_lever * by_j
            by_d = 1.0 / (m + stiff * s * s)
            e = stiff * s * c * by_d
            p = w[at + QS + k] - pull * c + b * s
            mu = m * (m + stiff) * by_d
            w[at + P + k], w[at + E + k], w[at + MU + k] = p * by_d, e, mu
            turn = 2.0 * w[at + VS + k] * w[before + W + k]
            w[at + BETA + k] = (pull * s + b * c - e * p) + mu * turn
    for i in range(_ONE, n + _ONE):
        at = i * _RECORD
        before = at - _RECORD
        for k in range(_LANES):
            c, s, length = w[at + C + k], w[at + SN + k], w[at + S + k]
            rate, alpha = w[before + W + k], w[before + ALPHA + k]
            y = (w[before + AY + k] + length * alpha) + 2.0 * w[at + VS + k] * rate
            x = w[at + P + k] + w[at + E + k] * y
            w[at + AS + k] = (x - w[before + AX + k]) + length * (rate * rate)
            across = c * y - s * x
            w[at + AX + k], w[at + AY + k] = c * x + s * y, across
            turn = w[at + A0 + k] - w[at + A1 + k] * across
            w[at + ALPHA + k], w[at + AT + k] = turn, turn - alpha


@_inner
def _add(w, n, share):
    """Adds a share of the derivative at the stage to the mean one."""
    for i in range(_ONE, n + _ONE):
        at = i * _RECORD
        for k in range(_LANES):
            w[at + DS + k] += share * w[at + VS + k]
            w[at + DT + k] += share * w[at + VT + k]
            w[at + DVS + k] += share * w[at + AS + k]
            w[at + DVT + k] += share * w[at + AT + k]


@_inner
def _move(w, n, h):
    """Goes to the next stage: from the start for h [s], with the derivative at this stage."""
    for i in range(_ONE, n + _ONE):
        at = i * _RECORD
        for k in range(_LANES):
            w[at + S + k] = w[at + S0 + k] + h * w[at + VS + k]
            w[at + T + k] = w[at + T0 + k] + h * w[at + VT + k]
            w[at + VS + k] = w[at + VS0 + k] + h * w[at + AS + k]
            w[at + VT + k] = w[at + VT0 + k] + h * w[at + AT + k]


@_inner
def _rk4(w, n, h):
    """One step of the lanes of a block; the new state is where that of a stage was."""
    _accelerate(w, n)
    for i in range(_ONE, n + _ONE):
        at = i * _RECORD
        for k in range(_LANES):
            w[at + DS + k] = w[at + DT + k] = w[at + DVS + k] = w[at + DVT + k] = 0.0
    _add(w, n, 1.0 / 6.0)
    _move(w, n, 0.5 * h)
    _accelerate(w, n)
    _add(w, n, 1.0 / 3.0)
    _move(w, n, 0.5 * h)
    _accelerate(w, n)
    _add(w, n, 1.0 / 3.0)
    _move(w, n, h)
    _accelerate(w, n)
    _add(w, n, 1.0 / 6.0)
    for i in range(_ONE, n + _ONE):
        at = i * _RECORD
        for k in range(_LANES):
            w[at + S + k] = w[at + S0 + k] + h * w[at + DS + k]
            w[at + T + k] = w[at + T0 + k] + h * w[at + DT + k]
            w[at + VS + k] = w[at + VS0 + k] + h * w[at + DVS + k]
            w[at + VT + k] = w[at + VT0 + k] + h * w[at + DVT + k]


@_inner
def _check(w, n):
    """Writes 1 to the base's INSIDE for arms whose new state is within the limits, else 0."""
    for k in range(_LANES):
        w[INSIDE + k] = 1.0
    for i in range(_ONE, n + _ONE):
        at = i * _RECORD
        for k in range(_LANES):
            s, t = w[at + S + k], w[at + T + k]
            vs, vt = abs(w[at + VS + k]), abs(w[at + VT + k])
            good = (s >= w[at + LOW_S + k]) & (s <= w[at + HIGH_S + k])
            good &= (t >= w[at + LOW_T + k]) & (t <= w[at + HIGH_T + k])
            good &= (vs <= w[at + FAST_S + k]) & (vt <= w[at + FAST_T + k])
            w[INSIDE + k] = w[INSIDE + k] if good else 0.0


@_inner
def _fetch(w, at, row, start, count):
    """Copies a row's arms to the lanes; lanes without an arm get the last one."""
    if len(row) == 1:
        for k in range(_LANES):
            w[at + k] = row[0]
    elif count == LANES:
        for k in range(_LANES):
            w[at + k] = row[start + k]
    else:
        for k in range(LANES):
            w[at + np.uint64(k)] = row[start + np.uint64(min(k, count - 1))]


@_inner
def _load_plant(w, plant, gravity, start, count):
    """Fills a block with the plants of the arms from `start` on."""
    _fetch(w, AX, gravity[0], start, count)
    _fetch(w, AY, gravity[1], start, count)
    for i in range(len(plant)):
        at = np.uint64(i + 1) * _RECORD
        for j in range(PLANT_ROWS):
            _fetch(w, at + MASS + np.uint64(j) * _LANES, plant[i, j], start, count)
        for k in range(_LANES):
            w[at + C + k], w[at + SN + k] = 1.0, 0.0  # of the last plate nothing depends


@_inner
def _load(w, q, v, ctrl, added, start, count):
    """Fills a block with the states of the arms from `start` on, and with what acts on them."""
    n = len(q) // 2
    for i in range(n):
        at = np.uint64(i + 1) * _RECORD
        _fetch(w, at + S0, q[i], start, count)
        _fetch(w, at + T0, q[n + i], start, count)
        _fetch(w, at + VS0, v[i], start, count)
        _fetch(w, at + VT0, v[n + i], start, count)
        _fetch(w, at + FS, added[i], start, count)
        _fetch(w, at + FT, added[n + i], start, count)
        _fetch(w, at + A0, ctrl[2 * i], start, count)
        _fetch(w, at + A1, ctrl[2 * i + 1], start, count)
        if i > 0:
            _fetch(w, at + RS, ctrl[2 * (n + i) - 2], start, count)
            _fetch(w, at + RT, ctrl[2 * (n + i) - 1], start, count)
        for k in range(_LANES):
            w[at + S + k], w[at + T + k] = w[at + S0 + k], w[at + T0 + k]
            w[at + VS + k], w[at + VT + k] = w[at + VS0 + k], w[at + VT0 + k]
            half, left, right = w[at + HALF + k], w[at + A0 + k], w[at + A1 + k]
            w[at + FS + k] += left + right
            w[at + FT + k] += half * (left - right)
            left, right = w[at + RS + k], w[at + RT + k]
            w[at + RS + k], w[at + RT + k] = left + right, half * (left - right)


@_inner
def _store(w, q, v, alive, outside, start, count):
    """Takes the new states of the arms that are alive; the number that left their limits."""
    n = len(q) // 2
    living = lost = 0
    for k in range(count):
        arm = start + np.uint64(k)
        outside[arm] = alive[arm] and w[INSIDE + np.uint64(k)] == 0.0
        living += alive[arm]
        lost += outside[arm]
    for i in range(n):
        at = np.uint64(i + 1) * _RECORD
        for row, place in ((q[i], S), (q[n + i], T), (v[i], VS), (v[n + i], VT)):
            if living == LANES:
                for k in range(_LANES):
                    row[start + k] = w[at + place + k]
            else:
                for k in range(np.uint64(count)):
                    if alive[start + k]:
                        row[start + k] = w[at + place + k]
    return lost


@functools.partial(kept, functools.partial(numba.njit, nogil=True))
def rk4_step(q, v, ctrl, added, plant, gravity, alive, outside, h, w, first, last):
    """Steps the arms first to last - 1 of n, of which those that are not alive stay.

    Args:
        q: coordinates, shape (2N, n) [m], [rad]; overwritten.
        v: velocities, likewise.
        ctrl: see `octarm.arm.actuation.Actuation.ctrl`, shape (4N - 2, n) [N].
        added: generalised forces in addition, shape (2N, n) [N], [N m].
        plant: shape (N, PLANT_ROWS, n), or (N, PLANT_ROWS, 1) if all arms are the same; of each
            module mass, inertia, the stiffness and the damping of s, of s with theta, and of theta,
            rest length, rest angle, half width, and limits: lowest s and theta, highest s and
            theta, largest speed of s and theta.
        gravity: acceleration of the ground against gravity along x and y, shape (2, n) or (2, 1)
            [m/s^2].
        alive: shape (n,) of bool.
        outside: set where an arm that is alive has left its limits, shape (n,) of bool.
        h: length of the step [s].
        w: from `work_space`.
        first: a multiple of LANES.
        last: number of an arm.

    Returns:
        How many arms have left their limits.
    """
    lost, modules = 0, np.uint64(len(plant))
    for begin in range(first, last, LANES):
        start, count = np.uint64(begin), min(LANES, last - begin)
        if begin == first or plant.shape[2] > 1 or gravity.shape[1] > 1:
            _load_plant(w, plant, gravity, start, count)
        _load(w, q, v, ctrl, added, start, count)
        _rk4(w, modules, h)
        _check(w, modules)
        lost += _store(w, q, v, alive, outside, start, count)
    return lost
