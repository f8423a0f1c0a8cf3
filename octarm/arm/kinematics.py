"""Where the arm is: ends of the modules, their Jacobians, and what a force on the tip does.

Module i slides by s_i along the axis u(phi_{i-1}) of the plate it stands on, then bends by theta_i.
With u(a) = (cos a, sin a), n(a) = (-sin a, cos a) and phi_i = theta_1 + .. + theta_i, its end is

    p_i = p_{i-1} + s_i u(phi_{i-1})

Pure functions of the coordinates q, shape (..., 2N) [m], [rad], and velocities v, which know no
parameters. Positions are in the base frame: x along the hanging arm, y across it.
"""

from __future__ import annotations

import numpy as np

from octarm.arrays import Entry, cos_sin, join, split


def positions(q: np.ndarray) -> np.ndarray:
    """Ends of the modules in the base frame, p_1 .. p_N, shape (..., N, 2) [m]; tip last."""
    n = q.shape[-1] // 2
    return np.cumsum(q[..., :n, None] * plate_axes(q), axis=-2)


def jacobian(q: np.ndarray) -> np.ndarray:
    """J = dp_b/dq_j of the ends of the modules, shape (..., N, 2, 2N) [1], [m].

    Axes are end b, direction, coordinate j; J[..., -1, :, :] is that of the tip.
    """
    n = q.shape[-1] // 2
    u = plate_axes(q)
    normal = np.stack([-u[..., 1], u[..., 0]], axis=-1)
    out = np.zeros_like(u, shape=(*q.shape[:-1], n, 2, 2 * n))
    for b in range(n):
        for j in range(b + 1):
            out[..., b, :, j] = u[..., j, :]
            lever = q[..., j, None] * normal[..., j, :]
            out[..., b, :, n : n + j] += lever[..., None]  # segment j swings with theta_k, k < j
    return out


def jacobian_rate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """J' = d/dt dp_b/dq_j when q moves with v, shape (..., N, 2, 2N) [1/s], [m/s]."""
    n = q.shape[-1] // 2
    u = plate_axes(q)
    normal = np.stack([-u[..., 1], u[..., 0]], axis=-1)
    rate = _plate_angles(v)[..., None]
    turn = rate * normal  # u' = phi' n
    swing = v[..., :n, None] * normal - q[..., :n, None] * rate * u  # (s n)' = s' n - s phi' u
    out = np.zeros_like(u, shape=(*np.broadcast_shapes(q.shape, v.shape)[:-1], n, 2, 2 * n))
    for b in range(n):
        for j in range(b + 1):
            out[..., b, :, j] = turn[..., j, :]
            out[..., b, :, n : n + j] += swing[..., j, :, None]
    return out


def tip_force(q: np.ndarray, fx: Entry, fy: Entry) -> np.ndarray:
    """The generalised force J(q)^T f of a force f on the tip, shape (..., 2N) [N], [N m].

    By recursion from the tip; fx and fy are along the axes of the base frame, shape (...) [N].
    """
    n = q.shape[-1] // 2
    x, axes = split(q), plate_entries(q)
    pushes: list[Entry] = []
    couples: list[Entry] = []
    moment = 0.0
    for i in reversed(range(n)):
        cos, sin = axes[i]
        pushes.append(fx * cos + fy * sin)
        couples.append(moment)
        moment = moment + x[i] * (fy * cos - fx * sin)
    batch = np.broadcast_shapes(np.shape(fx), np.shape(fy))
    return join(pushes[::-1] + couples[::-1], q, (*batch, 2 * n))


def plate_axes(q: np.ndarray) -> np.ndarray:
    """u(phi_{i-1}), the axes of the plates that the modules stand on, shape (..., N, 2) [1]."""
    angle = _plate_angles(q)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def plate_entries(q: np.ndarray) -> list[tuple[Entry, Entry]]:
    """The same as N pairs (cos, sin) of entries of shape (...) [1]; see `octarm.arrays.split`."""
    n = q.shape[-1] // 2
    angle: Entry = 0.0
    axes: list[tuple[Entry, Entry]] = [(1.0, 0.0)]
    for theta in split(q[..., n:-1]):
        angle = angle + theta
        axes.append(cos_sin(angle))
    return axes


def tip_position(q: np.ndarray) -> np.ndarray:
    """The tip in the world frame, shape (..., 3) [m], entry by entry along the batch."""
    x, y = tip(q)
    out = np.zeros_like(q, shape=(*q.shape[:-1], 3))
    out[..., 0], out[..., 2] = y, -x
    return out


def tip(q: np.ndarray) -> tuple[Entry, Entry]:
    """The tip p_N of arms side by side, x and y in the base frame, shape (...) [m].

    It takes one tangent of half the angle, which NumPy computes several times as fast as a sine
    and a cosine.
    """
    n = q.shape[-1] // 2
    entries = split(q)
    x, y, phi = entries[0], 0.0, 0.0
    for i, theta in enumerate(entries[n:-1], 1):
        phi = phi + theta
        half = np.tan(0.5 * phi)
        share = 2.0 / (1.0 + half * half)  # 1 + cos phi
        x = x + entries[i] * (share - 1.0)
        y = y + entries[i] * (share * half)
    return x, y


def _plate_angles(q: np.ndarray) -> np.ndarray:
    """phi_{i-1}, the angle of the plate that module i stands on, shape (..., N) [rad]."""
    n = q.shape[-1] // 2
    out = np.zeros_like(q[..., n:], dtype=np.result_type(q, 1.0))
    out[..., 1:] = np.cumsum(q[..., n:-1], axis=-1)
    return out
