"""What the tracking costs: input forces, their limits, and energy."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from octarm.metrics.blocks import Before, Count, add_rows, filled, keep_largest


class InputUse:
    """How much of the input forces tau is asked for, over the whole run.

    `effort`, the root mean square, and `peak_input` = max |tau|, both [N]; `saturation_share`, the
    share of control periods in which |tau| is at its limit [1]. Each has the shape (..., 2N), in
    the order of the columns of eq (2).
    """

    def __init__(self, like: np.ndarray, limit: npt.ArrayLike = math.inf) -> None:
        """Like a row of tau; the bound on |tau| broadcasts to it [N]."""
        self._limit = filled("input limit", limit, like)
        self._unlimited = not np.any(np.isfinite(self._limit))
        self._rows = 0
        self._squares = np.zeros_like(like)
        self._largest = np.zeros_like(like)
        self._saturated = Count(like)

    def update(self, tau: np.ndarray) -> None:
        """Rows of shape (k, ..., 2N) [N]."""
        self._rows += len(tau)
        size = np.abs(tau)
        add_rows(self._squares, size * size)
        keep_largest(self._largest, size)
        if not self._unlimited:
            self._saturated.update(size >= self._limit)

    def result(self) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (..., 2N)."""
        rows = self._rows or math.nan
        return {
            "effort": np.sqrt(self._squares / rows),
            "peak_input": self._largest * (rows / rows),
            "saturation_share": self._saturated.result() / rows,
        }


class ForceUse:
    """Size and work of the controller's generalised force Q, over the whole run.

    `force_effort` is its root mean square [N], [N m]. While Q_j is held, it does the work
    Q_j times the change of q_j until the next instant: exactly so, not only for short periods.
    `work` is the sum, what the arm was given net; `energy` is the sum of the absolute values,
    the integral of |Q_j q_j'| dt as long as q_j' keeps its sign during a period [J]. Each has the
    shape (..., 2N). The period that begins at the last instant is not counted in these two, as
    nothing is known about its end.
    """

    def __init__(self, like: np.ndarray) -> None:
        """Like a row of Q."""
        self._rows = 0
        self._force_before, self._q_before = Before(), Before()
        self._squares = np.zeros_like(like)
        self._net = np.zeros_like(like)
        self._absolute = np.zeros_like(like)

    def update(self, q: np.ndarray, force: np.ndarray) -> None:
        """Rows of q [m], [rad] and Q [N], [N m], both of shape (k, ..., 2N)."""
        self._rows += len(force)
        add_rows(self._squares, force * force)
        work = q - self._q_before(q)
        work *= self._force_before(force)
        add_rows(self._net, work)
        add_rows(self._absolute, np.abs(work, out=work))

    def result(self) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (..., 2N)."""
        return {
            "force_effort": np.sqrt(self._squares / (self._rows or math.nan)),
            "energy": self._absolute.copy(),
            "work": self._net.copy(),
        }
