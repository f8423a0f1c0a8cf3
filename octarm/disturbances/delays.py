"""Delays: what every arm was given a while ago, each with a delay of its own."""

from __future__ import annotations

import math

import numpy as np

from octarm.arrays import Entry, entry
from octarm.disturbances.episode import Episode
from octarm.disturbances.fields import Amount
from octarm.disturbances.streams import in_steps


class DelayLine:
    """A ring of the last rows, as long as the longest delay; before the first row all is zero.

    Attributes:
        delay: of each arm, whole physics steps, shape (...) [s].
        steps: the same in physics steps, shape (...) of integers.
    """

    delay: Entry
    steps: np.ndarray

    def __init__(self, name: str, delay: Amount, episode: Episode) -> None:
        """A line for the arms of an episode, empty.

        Args:
            name: of the delay, for errors.
            delay: rounded to whole physics steps, shape () or the batch's [s].
            episode: that begins.

        Raises:
            ValueError: if the delay does not suit the batch.
        """
        in_time = in_steps(episode.per_arm(name, delay), episode.timestep)
        self.steps = np.broadcast_to(np.rint(in_time).astype(np.int64), episode.batch_shape)
        self.delay = entry(self.steps * episode.timestep)
        self._length = int(np.max(self.steps)) + 1
        self._ring = np.empty(0)
        self._place = np.empty(0, dtype=np.int64)

    def put(self, step: int, *rows: np.ndarray) -> None:
        """Keeps what belongs to a step: arrays of one shape (..., 2N), the same number always."""
        if not self._ring.size:  # the arms' axis is last, so that it is contiguous
            shape = (len(rows), *rows[0].T.shape)
            self._ring = np.zeros_like(rows[0], shape=(self._length, *shape))
            self._place = np.arange(math.prod(shape)).reshape(shape)
        for kept, row in zip(self._ring[step % self._length], rows, strict=True):
            kept[...] = row.T

    def take(self, steps: np.ndarray) -> list[np.ndarray]:
        """What was put at these steps, one an arm, shape (...): arrays of shape (..., 2N)."""
        row = steps % self._length
        return [kept.T for kept in self._ring.take(self._place + row * self._place.size)]
