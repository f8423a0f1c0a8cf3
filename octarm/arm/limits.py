"""The states beyond which the equations no longer describe an arm in one piece."""

from __future__ import annotations

import dataclasses
import functools
from operator import le

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.arrays import Entry, planar_coordinates, split


@dataclasses.dataclass(frozen=True)
class Limits:
    """Bounds on the state of an arm. A run that leaves them has diverged.

    A bound is a number, or an array of shape (n,) for arms of different size.

    Attributes:
        low: smallest coordinates, 2N of them [m], [rad].
        high: largest coordinates, 2N of them [m], [rad].
        speed: largest absolute velocities, 2N of them [m/s], [rad/s].
    """

    low: tuple[Entry, ...]
    high: tuple[Entry, ...]
    speed: tuple[Entry, ...]

    @classmethod
    def of(cls, arm: ArmParameters) -> Limits:
        """Limits that no arm of this size passes in one piece.

        A module is neither crushed to nothing nor stretched fivefold nor bent to a full loop, and
        moves no faster than 40 rest lengths or 8 turns (50 rad) a second; OctArm's own sections
        turn 380 degrees in half a second.
        """
        rest, n = arm.rest_length, arm.modules
        return cls(
            low=(0.0,) * n + (-2.0 * np.pi,) * n,
            high=(*split(5.0 * rest), *(2.0 * np.pi,) * n),
            speed=(*split(40.0 * rest), *(50.0,) * n),
        )

    def reordered(self, places: np.ndarray) -> Limits:
        """Those of arrays in which the coordinates stand in these places, shape (2N,)."""
        order: list[int] = np.argsort(places).tolist()
        low, high, speed = (
            tuple(bound[i] for i in order) for bound in (self.low, self.high, self.speed)
        )
        return Limits(low, high, speed)

    def hold(self, q: np.ndarray, v: np.ndarray) -> bool:
        """Whether one arm's state, q and v of shape (2N,), is within the limits; NaN never is."""
        place, speed = q.tolist(), map(abs, v.tolist())
        inside = all(map(le, self.low, place)) and all(map(le, place, self.high))
        return inside and all(map(le, speed, self.speed))

    def holding(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Which arms of a batch are within the limits, q and v of shape (n, 2N), shape (n,)."""
        (low, high, speed), place = self._columns, q.T
        return np.all((place >= low) & (place <= high) & (np.abs(v.T) <= speed), axis=0)

    @functools.cached_property
    def _columns(self) -> list[np.ndarray]:
        """The bounds with arms on the last axis, each of shape (2N, 1) or (2N, n)."""
        bounds = (self.low, self.high, self.speed)
        return [np.stack(np.broadcast_arrays(*map(np.atleast_1d, bound))) for bound in bounds]

    def violation(self, q: np.ndarray, v: np.ndarray) -> str:
        """Which coordinate of one arm, q and v of shape (2N,), has left them; empty if none has."""
        of = planar_coordinates(len(q) // 2)
        for j, (name, unit) in enumerate(zip(of.names, of.units, strict=True)):
            low, high, top = self.low[j], self.high[j], self.speed[j]
            if not low <= q[j] <= high:
                return f"{name} is {q[j]:.4g} {unit}, outside {low:.4g} .. {high:.4g} {unit}"
            if not abs(v[j]) <= top:
                return f"{name} moves at {v[j]:.4g} {unit}/s, faster than {top:.4g} {unit}/s"
        return ""
