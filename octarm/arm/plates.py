"""What sensors on the plates that end groups say of a plant: arcs of constant curvature.

From one plate to the next group i is taken for an arc, which turns by the angle theta_i between
them. Its length follows from its chord c_i, the inverse of `octarm.arm.kinematics.arc_tip`, and its
velocity is the derivative:

    s_i = |c_i| g(theta_i / 2),    s_i' = |c_i|' g + |c_i| g' theta_i' / 2,    g(x) = x / sin x

In the layout `paper` a plate is beyond the hinge that ends its group. In the layout `centred` it is
inside the slide that leads across the border and turns with it; the last one ends the rigid piece.
So bends are the sums over groups, and lengths are, too, where the arm is straight.
"""

from __future__ import annotations

import numpy as np

from octarm.arm.groups import PLATES, Groups

_SMALL = 0.03  # half an angle below which g' is summed up as a series [rad]


def readings(groups: Groups, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q_M and v_M as they are read, given q_N and v_N, shapes (..., 2M) and (..., 2N).

    They are the sums over groups unless the groups are sensed by plates. In [m], [rad] and their
    rates; the chord of a group that is a full circle does not say how long it is.
    """
    read, rates = groups.measured(q), groups.rates(v)
    if groups.sensing != PLATES:
        return read, rates
    m = groups.arm.modules
    with np.errstate(all="ignore"):  # an arm that is lost may be anywhere
        half, half_rate = 0.5 * read[..., m:], 0.5 * rates[..., m:]
        x, y, x_rate, y_rate = _chords(groups, q, v)
        chord = np.hypot(x, y)
        chord_rate = (x * x_rate + y * y_rate) / chord
        stretch = 1.0 / np.sinc(half / np.pi)
        read[..., :m] = chord * stretch
        rates[..., :m] = chord_rate * stretch + chord * _slope(half) * half_rate
    return read, rates


def _chords(groups: Groups, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Chords of groups along x and across it, then their rates, shape (4, ..., M) [m], [m/s]."""
    n, every = groups.plant.modules, groups.plant.modules // groups.arm.modules
    s, s_rate, angle, turn = q[..., :n], v[..., :n], _plate_angles(q), _plate_angles(v)
    cos, sin = np.cos(angle), np.sin(angle)
    cos_rate, sin_rate = -turn * sin, turn * cos
    slides = [s * cos[..., :n], s * sin[..., :n]]
    slides += [s_rate * cos[..., :n] + s * cos_rate[..., :n]]
    slides += [s_rate * sin[..., :n] + s * sin_rate[..., :n]]
    out = groups.along(np.stack(slides))
    edges = groups.beyond * np.stack([x[..., every::every] for x in (cos, sin, cos_rate, sin_rate)])
    out += edges
    out[..., 1:] -= edges[..., :-1]
    return out


def _plate_angles(q: np.ndarray) -> np.ndarray:
    """The angles of the base and of all plates, shape (..., N + 1) [rad], or their rates."""
    n = q.shape[-1] // 2
    out = np.zeros_like(q, shape=(*q.shape[:-1], n + 1))
    out[..., 1:] = np.add.accumulate(q.T[n:], axis=0).T
    return out


def _slope(x: np.ndarray) -> np.ndarray:
    """g'(x) = (sin x - x cos x) / sin(x)^2 of g(x) = x / sin x, shape (...) [1/rad]."""
    z, sin = x * x, np.sin(x)
    series = x * (1.0 / 3.0 + z * (7.0 / 90.0 + z * (31.0 / 2520.0 + z * (127.0 / 75600.0))))
    return np.where(np.abs(x) < _SMALL, series, (sin - x * np.cos(x)) / (sin * sin))
