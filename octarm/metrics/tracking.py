"""How well the arm follows its reference: errors, settling, overshoot, and the tip."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from octarm.arm.kinematics import arc_tip, tip
from octarm.interfaces import Rows
from octarm.metrics.metric import POSITION, STEADY, Accumulator, Metric, Settings
from octarm.metrics.rows import Extremes, Size, add_rows, filled

# The band has to hold for half a period of the default sine at least: every phase of |e|.
DWELL = 1.0  # [s]


class TrackingError(Accumulator):
    """Size of the error e = q - q_d in the steady regime.

    `rms_error`, `peak_error` = max |e| and `steady_error`, the mean of e with its sign, each of
    shape (..., 2N) [m], [rad]; NaN without a row. For a periodic reference all three are exact
    over whole periods.
    """

    metrics: ClassVar = {
        "rms_error": Metric("coordinate", POSITION, f"root mean square of q - q_d {STEADY}"),
        "peak_error": Metric("coordinate", POSITION, f"largest |q - q_d| {STEADY}"),
        "steady_error": Metric(
            "coordinate", POSITION, f"mean of q - q_d {STEADY}, signed", zero_best=True
        ),
    }

    def __init__(self, first: Rows, settings: Settings) -> None:
        self._rows = 0
        self._sum, self._size = np.zeros_like(first["q"]), Size(first["q"])

    def update(self, rows: Rows, steady: bool) -> None:
        if steady:
            self._rows += len(rows["error"])
            add_rows(self._sum, rows["error"])
            self._size.update(rows["squared_error"])

    def result(self) -> dict[str, np.ndarray]:
        return {
            "rms_error": self._size.root(),
            "peak_error": self._size.peak(),
            "steady_error": self._sum / (self._rows or math.nan),
        }


class Settling(Accumulator):
    """When the error enters a band for good.

    `settling_time` is the first instant from which |e| <= band until the end of the run, shape
    (..., 2N) [s]. It is NaN, and `settled` is 0 instead of 1, unless the error was within the band
    for at least the last `DWELL` seconds: how long an unsettled arm would have taken is not known,
    and the length of the run says nothing about it.
    """

    metrics: ClassVar = {
        "settling_time": Metric(
            "coordinate",
            ("s",),
            f"when |q - q_d| is within its band for good, {DWELL:g} s at least",
            waits_for="settled",
        ),
        "settled": Metric("coordinate", ("1",), "1 if there is a settling time, else 0", "more"),
    }

    def __init__(self, first: Rows, settings: Settings) -> None:
        like, self._step = first["q"], settings.step
        band = settings.band_of(like.shape[-1])
        self._limit = np.square(filled("settling band", band, like))
        self._rows = 0
        self._last_outside = np.full_like(like, -1.0)  # number of a row

    def update(self, rows: Rows, steady: bool) -> None:
        squares = rows["squared_error"]
        outside = squares > self._limit
        self._rows += len(squares)
        if np.count_nonzero(outside):
            ever, last = outside[0], self._rows - 1.0
            if len(squares) > 1:
                ever, last = np.any(outside, axis=0), last - np.argmax(outside[::-1], axis=0)
            self._last_outside = np.where(ever, last, self._last_outside)

    def result(self) -> dict[str, np.ndarray]:
        inside = self._rows - 1.0 - self._last_outside  # rows at the end of the run
        settled = inside * self._step >= DWELL * (1.0 - 1e-9)
        time = (self._last_outside + 1.0) * self._step
        return {"settling_time": np.where(settled, time, np.nan), "settled": 1.0 * settled}


class Overshoot(Accumulator):
    """How far the arm swings beyond, or short of, the ends of the reference.

    In the steady regime q_d moves between two ends, c - A and c + A. By equations.md for a centre
    c of zero, an end that q reaches up to r from c is exceeded by 100 (r / A - 1) percent, with a
    minus sign where it falls short. `overshoot` is that of the end that is exceeded most,
    `undershoot` that of the other one: a gain of 1.03 makes both +3 %, one of 0.97 both -3 %, and
    a shift of the motion by 5 % of A makes them +5 % and -5 %. NaN where q_d stands still.

    `step_overshoot` is for a reference that stands still by then, at a place that differs from
    where q began by more than the settling band: how far q has gone beyond that place, in the
    direction of the step and in percent of it; negative if q never got there. NaN otherwise.

    Each has the shape (..., 2N) [%].
    """

    metrics: ClassVar = {
        name: Metric("coordinate", ("%",), text, zero_best=True)
        for name, text in {
            "overshoot": f"by how much q exceeds the reference's swing {STEADY}, signed",
            "undershoot": "the same at the end of the swing where q exceeds it least",
            "step_overshoot": "by how much q goes beyond a step, in percent of it",
        }.items()
    }

    def __init__(self, first: Rows, settings: Settings) -> None:
        start = first["q"]
        self._start = start.copy(order="K")
        self._band = filled("settling band", settings.band_of(start.shape[-1]), start)
        self._early, self._late = Extremes(start), Extremes(start)
        self._desired = Extremes(first["q_d"])

    def update(self, rows: Rows, steady: bool) -> None:
        (self._late if steady else self._early).update(rows["q"])
        if steady:
            self._desired.update(rows["q_d"])

    def result(self) -> dict[str, np.ndarray]:
        top, bottom = self._desired.largest, self._desired.smallest
        centre, amplitude = 0.5 * (top + bottom), 0.5 * (top - bottom)
        moves = amplitude > 0.0
        above, below = self._late.largest - centre, centre - self._late.smallest
        step = top - self._start
        largest = np.maximum(self._early.largest, self._late.largest)
        smallest = np.minimum(self._early.smallest, self._late.smallest)
        gone = np.where(step > 0.0, largest - self._start, self._start - smallest)
        stepped = (top == bottom) & (np.abs(step) > self._band)
        return {
            "overshoot": _percent(np.maximum(above, below), amplitude, moves),
            "undershoot": _percent(np.minimum(above, below), amplitude, moves),
            "step_overshoot": _percent(gone, np.abs(step), stepped),
        }


def _percent(reached: np.ndarray, size: np.ndarray, meant: np.ndarray) -> np.ndarray:
    return np.where(meant, 100.0 * ((reached - size) / np.where(meant, size, 1.0)), np.nan)


class TipError(Accumulator):
    """Distance between the tip p_N(q) and where the reference wants it, p_N(q_d).

    A plant of more modules has its tip where it is, and the reference wants it at the end of arcs
    of constant curvature: the end of a module that is not bent between its plates is far from both.

    `tip_rms_error` and `tip_peak_error` in the steady regime, each of shape (...) [m]; NaN without
    a row.
    """

    metrics: ClassVar = {
        "tip_rms_error": Metric("arm", ("m",), f"root mean square distance of the tips {STEADY}"),
        "tip_peak_error": Metric("arm", ("m",), f"largest distance of the tips {STEADY}"),
    }

    def __init__(self, first: Rows, settings: Settings) -> None:
        self._size = Size(first["q"][..., 0])

    def update(self, rows: Rows, steady: bool) -> None:
        if steady:
            q_d = rows["q_d"]
            shared = q_d.size == q_d.shape[-1]  # then it is one point, computed with plain numbers
            q_d = q_d.reshape(-1) if shared else q_d
            if "plant_tip" in rows:
                (x, y), (x_d, y_d) = np.moveaxis(rows["plant_tip"], -1, 0), arc_tip(q_d)
            else:
                (x, y), (x_d, y_d) = tip(rows["q"]), tip(q_d)
            dx, dy = x - x_d, y - y_d
            self._size.update(np.asarray(dx * dx + dy * dy))

    def result(self) -> dict[str, np.ndarray]:
        return {"tip_rms_error": self._size.root(), "tip_peak_error": self._size.peak()}
