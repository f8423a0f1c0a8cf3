"""Measures of a run, as accumulators: `update` per block, `result` at the end.

An accumulator never holds a trajectory; its result does not depend on how the run was cut into
blocks, rounding aside.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

SETTLED_AFTER = 2.0  # [s]; the reaching phase before it does not count in the errors


class TrackingError:
    """Size of the error e = q - q_d once the arm has had time to reach the reference.

    The result has `rms_error` and `peak_error`, each of shape (..., 2N) [m], [rad]; NaN when
    there was no sample after `SETTLED_AFTER`.
    """

    def __init__(self) -> None:
        self._count = 0
        self._squares: np.ndarray | float = 0.0
        self._peak: np.ndarray | float = 0.0

    def update(self, t: np.ndarray, error: np.ndarray) -> None:
        """A block of k instants: t of shape (k,) [s], error of shape (k, ..., 2N) [m], [rad]."""
        settled = error[t >= SETTLED_AFTER]
        if len(settled) == 0:
            self._squares = self._squares + 0.0 * error[0]
            return
        self._count += len(settled)
        self._squares = self._squares + np.sum(settled * settled, axis=0)
        self._peak = np.maximum(self._peak, np.max(np.abs(settled), axis=0))

    def result(self) -> Mapping[str, np.ndarray]:
        """The measures so far."""
        if not self._count:
            nothing = np.full(np.shape(self._squares), np.nan)
            return {"rms_error": nothing, "peak_error": nothing}
        return {
            "rms_error": np.sqrt(self._squares / self._count),
            "peak_error": np.asarray(self._peak),
        }


class Effort:
    """Root mean square of the input forces: `effort`, shape (..., 2N) [N]."""

    def __init__(self) -> None:
        self._count = 0
        self._squares: np.ndarray | float = 0.0

    def update(self, tau: np.ndarray) -> None:
        """A block of k instants: tau of shape (k, ..., 2N) [N]."""
        self._count += len(tau)
        self._squares = self._squares + np.sum(tau * tau, axis=0)

    def result(self) -> Mapping[str, np.ndarray]:
        """The measure so far."""
        return {"effort": np.sqrt(self._squares / max(self._count, 1))}
