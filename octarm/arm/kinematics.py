"""Where the arm is: ends of the modules, their Jacobians, and what a force on the tip does.

Module i slides by s_i along the axis u(phi_{i-1}) of the plate it stands on, then bends by theta_i.
With u(a) = (cos a, sin a), n(a) = (-sin a, cos a) and phi_i = theta_1 + .. + theta_i, its end is

    p_i = p_{i-1} + s_i u(phi_{i-1})

and the tip is p_N + b u(phi_N), with b the length of a rigid piece beyond the last plate, mostly 0.

Pure functions of the coordinates q, shape (..., 2N) [m], [rad], and velocities v, which know no
other parameter than b, shape (...) [m]. Positions are in the base frame: x along the hanging arm,
y across it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octarm.arm.recursion import plate_rows
from octarm.arrays import Entry, added_up, cos_sin, entry, join, split

_FEW = 8  # modules; of one arm with more, arrays are faster than numbers


def positions(q: np.ndarray) -> np.ndarray:
    """Ends of the modules in the base frame, p_1 .. p_N, shape (..., N, 2) [m]."""
    n = q.shape[-1] // 2
    return np.cumsum(q[..., :n, None] * plate_axes(q), axis=-2)


def jacobian(q: np.ndarray) -> np.ndarray:
    """J = dp_b/dq_j of the ends of the modules, shape (..., N, 2, 2N) [1], [m].

    Axes are end b, direction, coordinate j; J[..., -1, :, :] is that of the tip where no rigid
    piece follows.
    """
    u = plate_axes(q)
    return _along_the_arm(u, q[..., : u.shape[-2], None] * _normal(u))


def jacobian_rate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """J' = d/dt dp_b/dq_j when q moves with v, shape (..., N, 2, 2N) [1/s], [m/s]."""
    u = plate_axes(q)
    n, normal = u.shape[-2], _normal(u)
    rate = _plate_angles(v)[..., None]
    turn = rate * normal  # u' = phi' n
    swing = v[..., :n, None] * normal - q[..., :n, None] * rate * u  # (s n)' = s' n - s phi' u
    return _along_the_arm(turn, swing)


def _normal(u: np.ndarray) -> np.ndarray:
    return np.stack([-u[..., 1], u[..., 0]], axis=-1)


def _along_the_arm(slides: np.ndarray, levers: np.ndarray) -> np.ndarray:
    """What all ends get from what the segments before them contribute, shape (..., N, 2, 2N).

    Segment j gives `slides`, shape (..., N, 2), to its own s_j, and its lever, of the same shape,
    to every theta_k with k < j.
    """
    n = slides.shape[-2]
    before = np.tri(n, dtype=bool)[..., None]  # j <= b
    out = np.empty_like(slides, shape=(*slides.shape[:-2], n, 2, 2 * n))
    out[..., :n] = np.swapaxes(np.where(before, slides[..., None, :, :], 0.0), -1, -2)
    swings = np.where(
        before.swapaxes(0, 1) & ~np.eye(n, dtype=bool)[..., None], levers[..., None, :, :], 0.0
    )  # [k, j], j > k
    out[..., n:] = np.moveaxis(np.cumsum(swings, axis=-2), -3, -1)
    return out


def tip_force(q: np.ndarray, fx: Entry, fy: Entry, tip_length: Entry = 0.0) -> np.ndarray:
    """The generalised force J(q)^T f of a force f on the tip, shape (..., 2N) [N], [N m].

    By recursion from the tip; fx and fy are along the axes of the base frame, shape (...) [N].
    """
    n = q.shape[-1] // 2
    x, axes = split(q), plate_entries(q)
    pushes: list[Entry] = []
    couples: list[Entry] = []
    moment: Entry = 0.0
    if np.count_nonzero(tip_length):
        cos, sin = last_axis(q)
        moment = tip_length * (fy * cos - fx * sin)
    for i in reversed(range(n)):
        cos, sin = axes[i]
        pushes.append(fx * cos + fy * sin)
        couples.append(moment)
        moment = moment + x[i] * (fy * cos - fx * sin)
    batch = np.broadcast_shapes(np.shape(fx), np.shape(fy))
    return join(pushes[::-1] + couples[::-1], q, (*batch, 2 * n))


def last_axis(q: np.ndarray) -> tuple[Entry, Entry]:
    """u(phi_N), the axis of the last plate, cosine and sine of shape (...) [1]."""
    angle: Entry = 0.0
    for theta in split(q[..., q.shape[-1] // 2 :]):
        angle = angle + theta
    return cos_sin(angle)


def plate_axes(q: np.ndarray) -> np.ndarray:
    """u(phi_{i-1}), the axes of the plates that the modules stand on, shape (..., N, 2) [1]."""
    angle = _plate_angles(q)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def plate_entries(q: np.ndarray) -> Sequence[tuple[Entry, Entry]]:
    """The same as N pairs (cos, sin) of entries of shape (...) [1]; see `split`."""
    return list(zip(*map(split, plate_rows(q)), strict=True))


def tip_position(q: np.ndarray, tip_length: Entry = 0.0) -> np.ndarray:
    """The tip in the world frame, shape (..., 3) [m], entry by entry along the batch."""
    x, y = tip(q)
    if np.count_nonzero(tip_length):
        cos, sin = last_axis(q)
        x, y = x + tip_length * cos, y + tip_length * sin
    out = np.zeros_like(q, shape=(*q.shape[:-1], 3))
    out[..., 0], out[..., 2] = y, -x
    return out


def tip(q: np.ndarray) -> tuple[Entry, Entry]:
    """The end p_N of arms side by side, x and y in the base frame, shape (...) [m].

    It takes one tangent of half the angle, which NumPy computes several times as fast as a sine
    and a cosine.
    """
    n = q.shape[-1] // 2
    if n > _FEW:
        x, y = _tips(np.atleast_2d(q))
        return (float(x[0]), float(y[0])) if q.ndim == 1 else (x, y)
    entries = split(q)
    x, y, phi = entries[0], entries[0] - entries[0], 0.0  # y is an entry, too
    for i, theta in enumerate(entries[n:-1], 1):
        phi = phi + theta
        half = np.tan(0.5 * phi)
        share = 2.0 / (1.0 + half * half)  # 1 + cos phi
        x = x + entries[i] * (share - 1.0)
        y = y + entries[i] * (share * half)
    return x, y


def _tips(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for arms of many modules: all of them at once, added up in the same order."""
    n = q.shape[-1] // 2
    s, phi = q.T[:n], np.add.accumulate(q.T[n:-1], axis=0)
    half = np.tan(0.5 * phi)
    share = 2.0 / (1.0 + half * half)
    along, across = np.concatenate([s[:1], s[1:] * (share - 1.0)]), s[1:] * (share * half)
    across = np.concatenate([np.zeros_like(s[:1]), across])
    return added_up(along, 0).T, added_up(across, 0).T


def arc_tip(q: np.ndarray) -> tuple[Entry, Entry]:
    """The end of a chain of arcs of constant curvature, x and y in the base frame, shape (...) [m].

    Arc i has the length s_i and turns by theta_i; its chord s_i sin(theta_i/2) / (theta_i/2) points
    along u(phi_{i-1} + theta_i/2). It is where modules with distributed curvature put the tip.
    """
    n = q.shape[-1] // 2
    entries = split(q)
    x, y, phi = 0.0, 0.0, 0.0
    for length, theta in zip(entries[:n], entries[n:], strict=True):
        cos, sin = cos_sin(phi + 0.5 * theta)
        chord = length * entry(np.sinc(theta * (0.5 / np.pi)))
        x, y, phi = x + chord * cos, y + chord * sin, phi + theta
    return x, y


def _plate_angles(q: np.ndarray) -> np.ndarray:
    """phi_{i-1}, the angle of the plate that module i stands on, shape (..., N) [rad]."""
    n = q.shape[-1] // 2
    out = np.zeros_like(q[..., n:], dtype=np.result_type(q, 1.0))
    out[..., 1:] = np.cumsum(q[..., n:-1], axis=-1)
    return out
