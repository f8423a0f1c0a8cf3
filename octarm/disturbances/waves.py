"""Sizes that change in time, step by step: a box, and a sine within one."""

from __future__ import annotations

import dataclasses

import numpy as np

from octarm.arrays import entry
from octarm.disturbances.fields import Amount
from octarm.disturbances.streams import NEVER


class Box:
    """A height during a span of time, and 0 outside; constant between a few steps.

    A step that lies in the span in part has that part of the height.
    """

    def __init__(self, height: Amount, begin: np.ndarray, end: np.ndarray) -> None:
        """A height of shape () or (n,), from `begin` to `end`, shapes () or (n,) [steps]."""
        self._height, self._begin, self._end = height, begin, end
        ends = np.minimum(np.concatenate([np.zeros(1), np.ravel(begin), np.ravel(end)]), NEVER)
        self._edges = np.unique(np.concatenate([np.floor(ends), np.ceil(ends)]).astype(np.int64))
        self._from, self._until, self._size = 0, 0, 0.0

    def __call__(self, step: int) -> Amount:
        """The mean size over a step, of shape () or (n,); one object as long as it stays."""
        if not self._from <= step < self._until:
            place = int(np.searchsorted(self._edges, step, side="right"))
            self._from = int(self._edges[place - 1])
            self._until = int(self._edges[place]) if place < len(self._edges) else NEVER
            ended, begun = (np.clip(x - step, 0.0, 1.0) for x in (self._end, self._begin))
            self._size = entry((ended - begun) * self._height + 0.0)  # 0.0 rather than -0.0
        return self._size


@dataclasses.dataclass(frozen=True)
class Sine:
    """A box times sin(omega (t - at) + phase) with t the time at which a step begins.

    Attributes:
        box: when it acts, and how high it is.
        omega: shape () or (n,) [rad/s].
        phase: shape () or (n,) [rad].
        at: shape () or (n,) [s].
        timestep: length of a step [s].
    """

    box: Box
    omega: Amount
    phase: Amount
    at: Amount
    timestep: float

    def __call__(self, step: int) -> Amount:
        """The size at the beginning of a step, of shape () or (n,)."""
        amplitude = self.box(step)
        if isinstance(amplitude, float) and amplitude == 0.0:
            return amplitude
        angle = self.omega * (step * self.timestep - self.at) + self.phase
        return entry(amplitude * np.sin(angle) + 0.0)
