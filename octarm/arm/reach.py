"""How far an arm can be bent and held still by inputs within their range.

At given bends theta, the couples that hold the arm still follow from eq (1) with q' = q'' = 0, and
with Q = F_coeff tau module by module from the tip. What is left open is by how much both columns of
a module push together. Here they push as little as the range of the inputs allows, columns that
only push therefore as much as the couple asks for, and the modules lengthen by what that does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from octarm.arm.actuation import GroundedActuation, carried_moment
from octarm.arm.kinematics import plate_entries
from octarm.arm.lagrange import equilibrium, inverse_dynamics, stiffness_matrix
from octarm.arm.limits import Limits
from octarm.arm.parameters import ArmParameters
from octarm.arrays import split

_POINTS = 49  # bends that are tried at a time, from one that is held to one that is not
_REFINED = 3  # times
_ITERATIONS = 200
_ACCURACY = 1e-9  # share of a rest length


class Reach(NamedTuple):
    """The largest bends that are held still, those to either side, negative ones first.

    Attributes:
        alone: of each module while the others are straight, shape (2, N) [rad].
        alike: of all modules together, of each of them, shape (2,) [rad].
    """

    alone: np.ndarray
    alike: np.ndarray


def reach(p: ArmParameters) -> Reach:
    """The largest bends of one arm; 2 pi where the range of the inputs does not limit them.

    A bend counts if all smaller ones to the same side are held as well.
    """
    n = p.modules
    shapes = np.concatenate([np.eye(n), np.ones((1, n))])
    directions = np.concatenate([-shapes, shapes])
    least, most = np.zeros(len(directions)), np.full(len(directions), 2.0 * np.pi)
    for _ in range(_REFINED):
        sizes = np.linspace(least, most, _POINTS, axis=-1)
        held, _ = hold(p, sizes[..., None] * directions[:, None, :])
        held[:, 0] = True
        last = np.where(held.all(axis=1), _POINTS, np.argmin(held, axis=1)) - 1
        rows = np.arange(len(last))
        least, most = sizes[rows, last], sizes[rows, np.minimum(last + 1, _POINTS - 1)]
    low = least.reshape(2, n + 1)
    return Reach(low[:, :-1] * [[-1.0], [1.0]], low[:, -1] * [-1.0, 1.0])


def hold(p: ArmParameters, bends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether bends theta, shape (..., N) [rad], are held still by inputs within their range.

    Shape (...) of bool, and the arm bent so, q of shape (..., 2N) [m], [rad].
    """
    n, limits = p.modules, Limits.of(p)
    rest = equilibrium(p)
    q = np.concatenate([np.broadcast_to(rest[:n], bends.shape), bends], axis=-1)
    still = np.zeros_like(q)
    actuation = GroundedActuation(p.widths)
    axial = np.diagonal(stiffness_matrix(p))[:n]
    step, within = np.full(bends.shape[:-1], np.inf), np.ones(bends.shape[:-1], dtype=bool)
    with np.errstate(all="ignore"):  # what is not held may be anywhere
        for _ in range(_ITERATIONS):
            needed = inverse_dynamics(p, q, still, still)
            tau, within = _inputs(p, q, needed)
            slides = (actuation.force(q, tau) - needed)[..., :n] / axial
            q[..., :n] += np.clip(slides, -0.2 * p.rest_length, 0.2 * p.rest_length)
            step = np.max(np.abs(slides) / p.rest_length, axis=-1)
            if not np.any(within & (step > _ACCURACY)):
                break
        inside = np.all((q[..., :n] >= 0.0) & (q[..., :n] <= limits.high[:n]), axis=-1)
    return within & (step <= _ACCURACY) & inside, q


def _inputs(p: ArmParameters, q: np.ndarray, needed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inputs tau that hold the couples of `needed`, and whether they are within their range."""
    n, widths = p.modules, p.widths.tolist()
    s, axes, wanted = split(q), plate_entries(q), split(needed)
    lowest, highest = (bound.tolist() for bound in p.input_bounds(()))
    tau = np.empty_like(q)
    within = np.ones(q.shape[:-1], dtype=bool)
    fx = fy = carried = 0.0  # force and moment of the modules below
    for i in reversed(range(n)):
        couple = (wanted[n + i] - carried) / widths[i]
        left, right = 2 * i, 2 * i + 1
        least = np.maximum(lowest[left] - couple, lowest[right] + couple)
        most = np.minimum(highest[left] - couple, highest[right] + couple)
        within = within & (least <= most)
        common = np.minimum(np.maximum(0.0, least), most)
        tau[..., left], tau[..., right] = common + couple, common - couple
        cos, sin = axes[i]
        fx, fy = fx + 2.0 * common * cos, fy + 2.0 * common * sin
        carried = carried_moment(wanted[n + i], s[i], cos, sin, fx, fy)
    return tau, within
