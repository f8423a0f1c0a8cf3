"""The smooth planar arm as shapes in space, for pictures.

The drawn arm is a picture of the lumped model, not a second model. Module i ends at
p_i = p_{i-1} + s_i u(phi_{i-1}), where `octarm.lagrange.positions` puts it: it slides first and
bends at its end. No arc of constant curvature does that: one that leaves plate i-1 along
u(phi_{i-1}) and turns by theta_i ends s_i theta_i / 2 away from p_i. So the tube is a cubic Hermite
curve through the ends p_i that leaves plate i-1 along u(phi_{i-1}) and meets plate i along
u(phi_i): its tangent is continuous, module i turns by exactly theta_i over about the length s_i,
and the tip is the simulated tip. The columns are the parallel curves at half the width, so that
their lengths differ by l theta_i as those of the model do. `skeleton` is the lumped arm itself.

Coordinates q have shape (..., 2N) [m], [rad]; places are in the world frame [m].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from octarm.arm.kinematics import positions
from octarm.arm.mjcf import world_position
from octarm.palette import BRIGHT_MODULES

TUBE_PIECES = 6  # of the tube, for each module
COLUMN_PIECES = 4
RIBS = 4  # of the desired arm, for each module
OVERLAP = 1.08  # drawn length of a piece over its own, so that there is no gap where the arm bends
_RELAXED, _PULL, _PUSH = (112, 118, 126), (240, 243, 248), (232, 62, 62)
_STEEL = 7850.0  # [kg/m^3]; a payload is drawn as a ball of it
_LONGEST = 100.0  # [m], [rad]; an arm with a larger coordinate cannot be drawn


class Pieces(NamedTuple):
    """Short straight pieces of a curve in the plane of the arm.

    Attributes:
        centers: in the world frame, shape (..., pieces, 3) [m].
        angles: by which a turn about the world's y axis takes z along the piece, shape
            (..., pieces) [rad].
        lengths: shape (..., pieces) [m].
    """

    centers: np.ndarray
    angles: np.ndarray
    lengths: np.ndarray


def module_colors(count: int) -> np.ndarray:
    """One colour for each module, from 0 to 255, shape (count, 3)."""
    return np.resize([list(bytes.fromhex(color[1:])) for color in BRIGHT_MODULES], (count, 3))


def drawable(q: np.ndarray) -> np.ndarray:
    """Whether an arm is small enough to be drawn, shape (...) of bool; a diverging one grows."""
    return np.abs(q).max(axis=-1) < _LONGEST


def smooth_arm(q: np.ndarray, offset: float = 0.0, points: int = 12) -> np.ndarray:
    """Points along each module, its ends included, shape (..., N, points, 3) [m].

    The curve runs at a distance `offset` [m] from the backbone, towards column 2.
    """
    n = q.shape[-1] // 2
    end = positions(q)[..., None, :]
    chord = np.diff(end, axis=-3, prepend=0.0)  # s_i u(phi_{i-1}), also the tangent at the start
    phi = np.cumsum(q[..., n:], axis=-1)[..., None]
    last = np.stack([np.cos(phi), np.sin(phi)], axis=-1) * q[..., :n, None, None]
    u = np.linspace(0.0, 1.0, points)[:, None]
    curve = end - chord + chord * u + (chord - last) * u * u * (1 - u)
    slope = chord + (chord - last) * u * (2 - 3 * u)
    normal = np.stack([-slope[..., 1], slope[..., 0]], axis=-1)
    size = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return world_position(curve + offset * normal / size)


def pieces_of(curves: np.ndarray, axes: int = 1) -> Pieces:
    """The pieces of curves of shape (..., points, 3).

    The last `axes` axes before that of x, y and z count curves and points: their pieces stand one
    after another.
    """
    step = np.diff(curves, axis=-2)
    centers = 0.5 * (curves[..., 1:, :] + curves[..., :-1, :])
    angles = np.arctan2(step[..., 0], step[..., 2])
    lengths = np.linalg.norm(step, axis=-1)
    flat = (*angles.shape[: angles.ndim - axes], -1)
    return Pieces(centers.reshape(*flat, 3), angles.reshape(flat), lengths.reshape(flat))


def backbone(q: np.ndarray, pieces: int) -> Pieces:
    """The backbone for q of shape (..., 2N), in that many pieces for each module."""
    return pieces_of(smooth_arm(q, points=pieces + 1), axes=2)


def columns(q: np.ndarray, width: float, pieces: int = COLUMN_PIECES) -> Pieces:
    """Columns for q of shape (..., 2N), in the order of tau, in that many pieces each."""
    sides = [smooth_arm(q, side * width, pieces + 1) for side in (-0.5, 0.5)]
    return pieces_of(np.stack(sides, axis=-3), axes=3)


def plates(q: np.ndarray) -> Pieces:
    """The plates at the ends of the modules for q of shape (..., 2N); they face along the arm."""
    angles = np.pi - np.cumsum(q[..., q.shape[-1] // 2 :], axis=-1)
    return Pieces(world_position(positions(q)), angles, np.zeros_like(angles))


def tip(q: np.ndarray) -> np.ndarray:
    """The tip, shape (..., 3) [m]."""
    return world_position(positions(q)[..., -1, :])


def skeleton(q: np.ndarray) -> np.ndarray:
    """The lumped arm: base, then the ends of the modules, shape (..., N + 1, 3) [m]."""
    ends = world_position(positions(q))
    return np.concatenate([np.zeros_like(ends[..., :1, :]), ends], axis=-2)


def force_arrows(q: np.ndarray, force: np.ndarray, rim: float) -> tuple[np.ndarray, np.ndarray]:
    """A generalised force, shape (..., 2N) [N], [N m], as forces on the plates.

    A force on s_i pulls plate i along its module; a moment on theta_i is a couple at the rim of
    plate i, two opposite forces that far from its middle [m]. Where the forces act [m], and the
    forces [N], each have the shape (..., 3N, 3).
    """
    n = q.shape[-1] // 2
    end, phi = positions(q), np.cumsum(q[..., n:], axis=-1)
    along, slide = (
        np.stack([np.cos(angle), np.sin(angle)], axis=-1) for angle in (phi, phi - q[..., n:])
    )
    across = rim * np.stack([-along[..., 1], along[..., 0]], axis=-1)
    couple = along * (0.5 / rim * force[..., n:, None])
    origins = np.concatenate([end, end + across, end - across], axis=-2)
    forces = np.concatenate([slide * force[..., :n, None], -couple, couple], axis=-2)
    return world_position(origins), world_position(forces)


def column_looks(tau: np.ndarray, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns are red and thick where they push, white and thick where they pull.

    For input forces of shape (..., 2N) and the weight of the arm [N] these are red, green and blue
    from 0 to 255, shape (..., 2N, 3), and radii as shares of the arm's width, shape (..., 2N).
    """
    size = np.tanh(tau / (0.8 * weight))
    toward = np.where(size[..., None] > 0.0, _PUSH, _PULL)
    share = np.abs(size[..., None]) ** 0.6
    return np.array(_RELAXED) + share * (toward - np.array(_RELAXED)), 0.055 + 0.075 * np.abs(size)


def payload_balls(
    payloads: Sequence[tuple[float, float]], t: np.ndarray, q: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray]:
    """Payloads as balls of steel below the last plate, of no size until they are carried.

    They have masses and are carried from some instant on [kg], [s]. At instants t, shape (k,) [s],
    of an arm of this width [m] with q of shape (k, 2N) [m], [rad] these are their places, shape
    (k, payloads, 3) [m], and radii, shape (k, payloads) [m].
    """
    mass, begin = np.reshape(payloads, (-1, 2)).T
    radius, angle = np.cbrt(0.75 * mass / (np.pi * _STEEL)), np.sum(q[:, q.shape[1] // 2 :], axis=1)
    down = np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
    below = down[:, None] * (radius + 0.035 * width)[:, None]
    return tip(q)[:, None] + below, (t[:, None] >= begin) * radius
