"""How a sliding-mode controller reaches its surface s = 0 and stays there."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from octarm.interfaces import Rows
from octarm.metrics.metric import STEADY, Accumulator, Metric, Settings
from octarm.metrics.rows import Before, Count, filled


class Sliding(Accumulator):
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

    metrics: ClassVar = {
        "reaching_time": Metric(
            "coordinate", ("s",), "when s first enters its layer", waits_for="sliding_violations"
        ),
        "sliding_violations": Metric(
            "coordinate", ("1",), "share of periods outside the layer over which |s| grew"
        ),
        "layer_share": Metric(
            "coordinate", ("1",), f"share of time with |s| <= phi {STEADY}", better="more"
        ),
    }
    signals: ClassVar = ("s",)

    def __init__(self, first: Rows, settings: Settings) -> None:
        start, layer = first["s"], settings.layer
        self._layered = layer is not None
        self._phi = filled("layer", 0.0 if layer is None else layer, start)
        self._start = np.sign(start)
        self._time = np.full_like(start, np.nan)
        self._waiting = np.ones_like(start, dtype=bool)
        self._steady_rows = 0
        self._early, self._late, self._grown = (Count(start) for _ in range(3))
        self._size_before, self._outside_before = Before(), Before()

    def update(self, rows: Rows, steady: bool) -> None:
        t, s = rows["t"], rows["s"]
        size = np.abs(s)
        outside = size > self._phi
        if self._waiting.any():
            arriving = self._waiting & (~outside | (s * self._start <= 0.0))
            if np.any(arrived := np.any(arriving, axis=0)):
                self._time = np.where(arrived, t[np.argmax(arriving, axis=0)], self._time)
                self._waiting &= ~arrived
        (self._late if steady else self._early).update(outside)
        self._steady_rows += len(t) if steady else 0
        grown = size > self._size_before(size)
        grown &= self._outside_before(outside)
        self._grown.update(grown)

    def result(self) -> dict[str, np.ndarray]:
        early, late = self._early.result(), self._late.result()
        # Nothing is known about the end of the period that begins at the last instant.
        last = self._outside_before.last
        begun = early + late - (0 if last is None else last)
        results = {
            "reaching_time": self._time.copy(),
            "sliding_violations": self._grown.result() / np.where(begun > 0, begun, np.nan),
        }
        if self._layered:
            results["layer_share"] = 1.0 - late / (self._steady_rows or math.nan)
        return results


class ReachingBound(Accumulator):
    """The time within which the controller promised s = 0 at the start, shape (...) [s].

    A controller gives one for the arm, or one for each coordinate: then all of them have reached
    s = 0 after the largest.
    """

    metrics: ClassVar = {
        "reaching_bound": Metric(
            "arm", ("s",), "what the controller promised for s = 0 at the start", better="neither"
        )
    }
    signals: ClassVar = ("reaching_bound",)

    def __init__(self, first: Rows, settings: Settings) -> None:
        self._bound = np.max(first["reaching_bound"], axis=-1)

    def update(self, rows: Rows, steady: bool) -> None:
        """Takes nothing more: the promise at the start counts."""

    def result(self) -> dict[str, np.ndarray]:
        return {"reaching_bound": self._bound}
