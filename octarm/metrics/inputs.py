"""What the tracking costs: input forces, their limits, and energy."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from octarm.interfaces import Rows
from octarm.metrics.metric import FORCE, Accumulator, Metric, Settings
from octarm.metrics.rows import Before, Count, Size, add_rows, filled


class InputUse(Accumulator):
    """How large the input forces tau are that the arm received, over the whole run.

    `effort`, the root mean square, and `peak_input` = max |tau|, both [N]; `saturation_share`, the
    share of physics steps in which tau is at an end of its range or beyond [1]. The range is that
    of the arm, narrowed by a disturbance that limits the inputs. Each has the shape (..., 2N), in
    the order of the columns of eq (2).
    """

    metrics: ClassVar = {
        "effort": Metric("input", ("N",), "root mean square of the input forces", together="rms"),
        "peak_input": Metric("input", ("N",), "largest absolute input force", together="max"),
        "saturation_share": Metric("input", ("1",), "share of time at the input limit"),
    }

    def __init__(self, first: Rows, settings: Settings) -> None:
        ends = (filled("input range", end, first["tau"]) for end in settings.input_range)
        self._low, self._high = ends
        self._unlimited = not np.any(np.isfinite(self._low) | np.isfinite(self._high))
        self._rows = 0
        self._size, self._saturated = Size(first["tau"]), Count(first["tau"])

    def update(self, rows: Rows, steady: bool) -> None:  # noqa: D102
        tau, size = rows["tau"], np.abs(rows["tau"])
        self._rows += len(size)
        self._size.update(size * size)
        if not self._unlimited:
            self._saturated.update((tau <= self._low) | (tau >= self._high))

    def result(self) -> dict[str, np.ndarray]:  # noqa: D102
        return {
            "effort": self._size.root(),
            "peak_input": self._size.peak(),
            "saturation_share": self._saturated.result() / (self._rows or math.nan),
        }


class ForceUse(Accumulator):
    """Size and work of the generalised force Q of the inputs that the arm received.

    `force_effort` is its root mean square [N], [N m]. The work that Q_j does during a physics step
    is taken to be Q_j times the change of q_j: exactly so for a Q that is held; where tau is held
    and the arm turns, up to terms that vanish with the step.
    `work` is the sum, what the arm was given net; `energy` is the sum of the absolute values,
    the integral of |Q_j q_j'| dt as long as q_j' keeps its sign during a step [J]. Each has the
    shape (..., 2N) and is of the whole run. The last physics step is not counted in these two, as
    nothing is known about its end.
    """

    metrics: ClassVar = {
        "force_effort": Metric("coordinate", FORCE, "root mean square of Q"),
        "energy": Metric("coordinate", ("J",), "integral of |Q_j q_j'|"),
        "work": Metric("coordinate", ("J",), "integral of Q_j q_j'", better="neither"),
    }

    def __init__(self, first: Rows, settings: Settings) -> None:
        like = first["force"]
        self._force_before, self._q_before = Before(), Before()
        self._size = Size(like)
        self._net, self._absolute = np.zeros_like(like), np.zeros_like(like)

    def update(self, rows: Rows, steady: bool) -> None:  # noqa: D102
        q, force = rows["q"], rows["force"]
        self._size.update(force * force)
        work = q - self._q_before(q)
        work *= self._force_before(force)
        add_rows(self._net, work)
        add_rows(self._absolute, np.abs(work, out=work))

    def result(self) -> dict[str, np.ndarray]:  # noqa: D102
        return {
            "force_effort": self._size.root(),
            "energy": self._absolute.copy(),
            "work": self._net.copy(),
        }
