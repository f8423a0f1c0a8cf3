"""How a sliding-mode controller reaches its surface s = 0 and stays there."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from octarm.metrics.blocks import Before, Count, filled, first_true


class Sliding:
    """Reaching, residence in the boundary layer, and violations of the sliding condition.

    `reaching_time` is the first instant at which |s| <= phi, or at which s no longer has the sign
    it began with, as it then went through the layer between two instants; without a layer phi is
    zero. NaN when that never came [s].

    `layer_share` is the share of the steady regime with |s| <= phi [1]; there is none without a
    layer.

    `sliding_violations` is the share of the control periods that begin with |s| > phi and over
    which |s| grew, in the whole run [1]; NaN when none begins so.

    Each has the shape (..., 2N).
    """

    def __init__(self, start: np.ndarray, phi: npt.ArrayLike | None = None) -> None:
        """The first row of s; the half width of the layer broadcasts to it [m/s], [rad/s]."""
        self._layered = phi is not None
        self._phi = filled("phi", 0.0 if phi is None else phi, start)
        self._start = np.sign(start)
        self._time = np.full_like(start, np.nan)
        self._waiting = np.ones_like(start, dtype=bool)
        self._steady_rows = 0
        self._early, self._late, self._grown = (Count(start) for _ in range(3))
        self._size_before, self._outside_before = Before(), Before()

    def update(self, t: np.ndarray, s: np.ndarray, steady: bool) -> None:
        """Rows of t, shape (k,) [s], and s, shape (k, ..., 2N); are they in the steady regime."""
        size = np.abs(s)
        outside = size > self._phi
        if self._waiting.any():
            self._reach(t, ~outside | (s * self._start <= 0.0))
        (self._late if steady else self._early).update(outside)
        self._steady_rows += len(t) if steady else 0
        grown = size > self._size_before(size)
        grown &= self._outside_before(outside)
        self._grown.update(grown)

    def _reach(self, t: np.ndarray, there: np.ndarray) -> None:
        arriving = there & self._waiting
        if arriving.any():
            found, row = first_true(arriving)
            self._time = np.where(found, t[row], self._time)
            self._waiting &= ~found

    def result(self) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (..., 2N)."""
        early, late = self._early.result(), self._late.result()
        # Nothing is known about the end of the period that begins at the last instant.
        begun = early + late - self._outside_before.last
        results = {
            "reaching_time": self._time.copy(),
            "sliding_violations": self._grown.result() / np.where(begun > 0, begun, np.nan),
        }
        if self._layered:
            results["layer_share"] = 1.0 - late / (self._steady_rows or math.nan)
        return results
