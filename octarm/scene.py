"""The smooth arm as curves in space, for pictures.

The drawn arm is a picture of the lumped model, not a second model. Module i ends at
p_i = p_{i-1} + s_i u(phi_{i-1}), where `octarm.lagrange.positions` puts it; a chain of true arcs of
constant curvature would end elsewhere. So the backbone is a cubic Hermite curve through the ends
p_i that leaves plate i-1 along u(phi_{i-1}) and meets plate i along u(phi_i): its tangent is
continuous, module i turns by exactly theta_i over about the length s_i, and the tip is the lumped
tip. The columns are the curves beside it at half the width, so that their lengths differ by
l theta_i as those of the model do.
"""

from __future__ import annotations

import numpy as np

from octarm.lagrange import positions
from octarm.model import world_position

POINTS = 12  # a module


def smooth_arm(q: np.ndarray, offset: float = 0.0) -> np.ndarray:
    """The smooth arm in the world frame.

    Args:
        q: coordinates, shape (..., 2N) [m], [rad].
        offset: distance of the curve from the backbone, towards column 2 [m].

    Returns:
        Points along each module, shape (..., N, POINTS, 3) [m].
    """
    n = q.shape[-1] // 2
    end = positions(q)[..., None, :]
    chord = np.diff(end, axis=-3, prepend=0.0)  # s_i u(phi_{i-1}), also the tangent at the start
    phi = np.cumsum(q[..., n:], axis=-1)[..., None]
    last = np.stack([np.cos(phi), np.sin(phi)], axis=-1) * q[..., :n, None, None]
    u = np.linspace(0.0, 1.0, POINTS)[:, None]
    curve = end - chord + chord * u + (chord - last) * u * u * (1 - u)
    slope = chord + (chord - last) * u * (2 - 3 * u)
    normal = np.stack([-slope[..., 1], slope[..., 0]], axis=-1)
    size = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return world_position(curve + offset * normal / size)


def plate_quaternions(q: np.ndarray) -> np.ndarray:
    """Orientation of each plate in the world frame, x y z w, shape (..., N, 4)."""
    half = -0.5 * np.cumsum(q[..., q.shape[-1] // 2 :], axis=-1)
    zero = np.zeros_like(half)
    return np.stack([zero, np.sin(half), zero, np.cos(half)], axis=-1)
