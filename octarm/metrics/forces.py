"""What the tracking costs: input forces, their limits, energy, and chattering."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from octarm.arrays import Entry, stacked
from octarm.interfaces import Rows
from octarm.metrics.metric import FORCE, STEADY, Accumulator, Metric, Settings
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

    def update(self, rows: Rows, steady: bool) -> None:
        tau, size = rows["tau"], np.abs(rows["tau"])
        self._rows += len(size)
        self._size.update(size * size)
        if not self._unlimited:
            self._saturated.update((tau <= self._low) | (tau >= self._high))

    def result(self) -> dict[str, np.ndarray]:
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

    def update(self, rows: Rows, steady: bool) -> None:
        q, force = rows["q"], rows["force"]
        self._size.update(force * force)
        work = q - self._q_before(q)
        work *= self._force_before(force)
        add_rows(self._net, work)
        add_rows(self._absolute, np.abs(work, out=work))

    def result(self) -> dict[str, np.ndarray]:
        return {
            "force_effort": self._size.root(),
            "energy": self._absolute.copy(),
            "work": self._net.copy(),
        }


class Chattering(Accumulator):
    """How restless the generalised force Q that the arm received is in the steady regime.

    `chattering` is the root mean square of what passes a high-pass filter [N], [N m],

        H(p) = p^2 / (p + w)^2,   w = 2 pi corner,   |H| = f^2 / (f^2 + corner^2),

    so that half of an oscillation at the corner counts, practically all of a faster one, and of
    the motion itself, at 0.5 Hz, only 1e-4. The filter runs in continuous time on the held force,
    and its square is integrated over each physics step, both in closed form: the measure belongs to
    that staircase, not to samples of it. It converges when the control period is halved, also
    for a force that switches at every instant.

    `total_variation` is sum |dQ| / time [N/s], [N m/s] and `switching_activity` the mean |dQ| of a
    period [N], [N m]. They see small and fast changes best, but neither converges when a force
    switches at every instant: the first then grows with the control rate, and the second of a
    smooth force falls with it. Compare them at one control rate only, which `control_rate`
    states, shape () [Hz].

    Each but the last has the shape (..., 2N) and is NaN without a row.
    """

    metrics: ClassVar = {
        "chattering": Metric(
            "coordinate", FORCE, f"high-pass root mean square of Q {STEADY}, any control rate"
        ),
        "total_variation": Metric(
            "coordinate", ("N/s", "N m/s"), f"sum |dQ| a second {STEADY}, at one control rate"
        ),
        "switching_activity": Metric(
            "coordinate", FORCE, f"mean |dQ| a control period {STEADY}, at one control rate"
        ),
        "control_rate": Metric("arm", ("Hz",), "control instants a second", better="neither"),
    }

    def __init__(self, first: Rows, settings: Settings) -> None:
        like, self._settings = first["force"], settings
        x = 2.0 * math.pi * settings.corner * settings.step
        self._decay = math.exp(-x)
        self._weights = _mean_square(x)
        self._rows = 0
        self._before = Before()
        # After a jump the filter's answer decays as exp(-wt) ((1 - wt) y - w period z). These are
        # y and z, and the sums of y^2, y z and z^2.
        self._state = stacked(like, 5)
        self._state[...] = 0.0
        self._variation = np.zeros_like(like)

    def update(self, rows: Rows, steady: bool) -> None:
        force = rows["force"]
        change = force - self._before(force)
        if force.ndim > 2:
            self._pass(change, steady, *self._state)
        else:  # numbers of Python are ten times as fast as arrays of one arm
            for state, jumps in zip(self._state.T, change.T.tolist(), strict=True):
                state[...] = self._pass(jumps, steady, *state.tolist())
        if steady:
            self._rows += len(force)
            add_rows(self._variation, np.abs(change, out=change))

    def _pass(self, jumps: Iterable[Entry], steady: bool, *state: Entry) -> tuple[Entry, ...]:
        """The state after further jumps; one of arrays is changed in place."""
        decay, (y, z, yy, yz, zz) = self._decay, state
        for jump in jumps:  # one physics step, and the jump at its end
            z += y
            z *= decay
            y *= decay
            y += jump
            if steady:
                yy += y * y
                yz += y * z
                zz += z * z
        return y, z, yy, yz, zz

    def result(self) -> dict[str, np.ndarray]:
        rows, settings = self._rows or math.nan, self._settings
        yy, yz, zz = (weight * x for weight, x in zip(self._weights, self._state[2:], strict=True))
        square = (yy + yz + zz) / rows
        return {
            "chattering": np.sqrt(np.maximum(square, 0.0)),  # rounding may go below zero
            "total_variation": self._variation / (rows * settings.step),
            "switching_activity": self._variation / (rows / settings.steps),
            "control_rate": np.asarray(1.0 / settings.control_period),
        }


def _mean_square(x: float) -> tuple[float, float, float]:
    """Weights of y^2, y z and z^2 in the mean of exp(-2u) ((1 - u) y - x z)^2 over 0 < u < x."""
    b, gone = math.exp(-2.0 * x), -math.expm1(-2.0 * x)
    linear = (gone + 2.0 * x * b) / 4.0  # integral of exp(-2u) (1 - u)
    square = (gone + 2.0 * x * b * (1.0 - x)) / 4.0  # integral of exp(-2u) (1 - u)^2
    return square / x, -2.0 * linear, x * gone / 2.0
