"""Where the arm is: ends of the modules, their Jacobians, and what a force on the tip does.

Module i slides by s_i along the axis u(phi_{i-1}) of the plate it stands on, then bends by theta_i.
With u(a) = (cos a, sin a), n(a) = (-sin a, cos a) and phi_i = theta_1 + .. + theta_i, its end is

    p_i = p_{i-1} + s_i u(phi_{i-1})

Pure functions of the coordinates, which know no parameters. Positions are in the base frame: x
along the hanging arm, y across it.
"""

from __future__ import annotations

import numpy as np

from octarm.arrays import Entry, cos_sin, join, split


def positions(q: np.ndarray) -> np.ndarray:
    """Ends of the modules in the base frame, p_1 .. p_N.

    Args:
        q: coordinates, shape (..., 2N) [m], [rad].

    Returns:
        Shape (..., N, 2) [m]; x along the hanging arm. The last one is the tip.
    """
    n = q.shape[-1] // 2
    return np.cumsum(q[..., :n, None] * plate_axes(q), axis=-2)


def jacobian(q: np.ndarray) -> np.ndarray:
    """J = dp_b/dq_j of the ends of the modules.

    Args:
        q: coordinates, shape (..., 2N) [m], [rad].

    Returns:
        Shape (..., N, 2, 2N) [1], [m]: end b, direction, coordinate j. J[..., -1, :, :] is that of
        the tip.
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
    """J' = d/dt dp_b/dq_j when q moves with v.

    Args:
        q: coordinates, shape (..., 2N) [m], [rad].
        v: velocities, shape (..., 2N) [m/s], [rad/s].

    Returns:
        Shape (..., N, 2, 2N) [1/s], [m/s], as `jacobian`.
    """
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
    """The generalised force J(q)^T f of a force on the tip, by recursion from the tip.

    Args:
        q: coordinates, shape (..., 2N) [m], [rad].
        fx: along the x axis of the base frame, down the hanging arm, shape (...) [N].
        fy: along its y axis, shape (...) [N].

    Returns:
        Generalised force, shape (..., 2N) [N], [N m].
    """
    n = q.shape[-1] // 2
    x, axes = split(q), plate_entries(q)
    pushes: list[Entry] = []
    couples: list[Entry] = []
    moment: Entry = 0.0
    for i in reversed(range(n)):
        cos, sin = axes[i]
        pushes.append(fx * cos + fy * sin)
        couples.append(moment)
        moment = moment + x[i] * (fy * cos - fx * sin)
    batch = np.broadcast_shapes(np.shape(fx), np.shape(fy))
    return join(pushes[::-1] + couples[::-1], q, (*batch, 2 * n))


def plate_axes(q: np.ndarray) -> np.ndarray:
    """u(phi_{i-1}), the axis of the plate that module i stands on.

    Args:
        q: coordinates, shape (..., 2N) [m], [rad].

    Returns:
        Unit vectors, shape (..., N, 2) [1].
    """
    angle = _plate_angles(q)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def plate_entries(q: np.ndarray) -> list[tuple[Entry, Entry]]:
    """The same as pairs (cos, sin), for arithmetic along the arm entry by entry.

    Args:
        q: coordinates, shape (..., 2N) [m], [rad].

    Returns:
        N pairs of floats for one arm, of arrays of shape (...) for a batch [1].
    """
    n = q.shape[-1] // 2
    angle: Entry = 0.0
    axes: list[tuple[Entry, Entry]] = [(1.0, 0.0)]
    for theta in split(q[..., n:-1]):
        angle = angle + theta
        axes.append(cos_sin(angle))
    return axes


def tip_position(q: np.ndarray) -> np.ndarray:
    """The tip of an arm at q, shape (..., 2N) [m], [rad], in the world frame, shape (..., 3) [m].

    It is the last of `positions`, worked out entry by entry along the batch.
    """
    x: Entry = 0.0
    y: Entry = 0.0
    for length, (cos, sin) in zip(split(q), plate_entries(q), strict=False):
        x, y = x + length * cos, y + length * sin
    out = np.zeros_like(q, shape=(*q.shape[:-1], 3))
    out[..., 0], out[..., 2] = y, -x
    return out


def _plate_angles(q: np.ndarray) -> np.ndarray:
    """phi_{i-1}, the angle of the plate that module i stands on, shape (..., N) [rad]."""
    n = q.shape[-1] // 2
    out = np.zeros_like(q[..., n:], dtype=np.result_type(q, 1.0))
    out[..., 1:] = np.cumsum(q[..., n:-1], axis=-1)
    return out
