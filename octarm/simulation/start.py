"""Where episodes begin: hanging at rest, or drawn about it.

A drawn start is a share of what the inputs reach alone, from one end to the other: slides by
pushing and pulling with both columns of a module, bends as far as a module is held by itself, and
with all others bent alike (`octarm.arm.reach`). Speeds are those of a swing of this size at the
slowest mode.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from octarm.arm.lagrange import equilibrium, stiffness_matrix
from octarm.arm.limits import Limits
from octarm.arm.modes import modes
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import reach
from octarm.errors import OctarmError, closest, quoted

REST, RANDOM, MOVING = STARTS = ("rest", "random", "moving")
SHARE = 0.1  # within which a start is drawn unless another one is given


@dataclasses.dataclass(frozen=True, eq=False)
class Start:
    """The range of what is drawn.

    Attributes:
        low: smallest difference from the arm at rest, shape (..., 2N) [m], [rad].
        high: largest difference, likewise.
        speed: largest velocity either way, likewise [m/s], [rad/s]; 0 for an arm that is let go at
            rest.
    """

    low: np.ndarray
    high: np.ndarray
    speed: np.ndarray

    @classmethod
    def of(cls, arm: ArmParameters, kind: str, share: float) -> Start | None:
        """The start of a kind, of arms with or without a batch axis; None for the arm at rest.

        Raises OctarmError for an unknown kind, or a share that is not above 0 and at most 1.
        """
        if kind not in STARTS:
            raise OctarmError(f"unknown start {quoted(kind)}{closest(kind, STARTS)}")
        if not 0.0 < share <= 1.0:
            raise OctarmError(f"start_share is {share:g}; it must be above 0 and at most 1")
        if kind == REST:
            return None
        arms = [arm.arm(i) for i in range(arm.batch_shape[0])] if arm.batch_shape else [arm]
        rows = np.stack([_reached(each, share) for each in arms], axis=1)
        low, high, speed = rows if arm.batch_shape else rows[:, 0]
        return cls(low, high, speed if kind == MOVING else 0.0 * speed)

    def drawn(self, generators: Sequence[np.random.Generator]) -> tuple[np.ndarray, np.ndarray]:
        """The difference of q from rest, and v, shapes (n, 2N) for so many arms [m], [rad], [s]."""
        size = self.low.shape[-1]
        place, speed = np.stack([each.random((2, size)) for each in generators], axis=1)
        return self.low + place * (self.high - self.low), (2.0 * speed - 1.0) * self.speed


def _reached(p: ArmParameters, share: float) -> np.ndarray:
    """How far coordinates of one arm go to either side of rest, and how fast, shape (3, 2N)."""
    n, limits, rest = p.modules, Limits.of(p), equilibrium(p)
    axial = np.diagonal(stiffness_matrix(p))[:n]
    alone, alike = reach(p)
    bends = np.maximum(alone[0], alike[0]), np.minimum(alone[1], alike[1])
    ends: list[np.ndarray] = []
    for inputs, limit, bend in zip(
        p.input_bounds(()), (limits.low, limits.high), bends, strict=True
    ):
        slides = np.sum(inputs.reshape(n, 2), axis=-1) / axial
        way = np.concatenate([slides, bend - rest[n:]])
        furthest = np.array(limit) - rest
        ends.append(np.where(np.abs(way) < np.abs(furthest), way, furthest))
    low, high = share * np.minimum(ends[0], 0.0), share * np.maximum(ends[1], 0.0)
    slowest = 2.0 * math.pi * float(np.nanmin([mode.frequency for mode in modes(p, rest)]))
    return np.stack([low, high, np.minimum(slowest * (high - low) / 2.0, np.array(limits.speed))])
