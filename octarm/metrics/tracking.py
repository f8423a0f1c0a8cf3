"""How well the arm follows its reference: errors, settling, overshoot, and the tip."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from octarm.arrays import Entry, split
from octarm.metrics.blocks import Extremes, add_rows, filled, first_true, keep_largest

SLIDE_BAND = 1e-3  # [m]; an error within it counts as settled
BEND_BAND = 0.02  # [rad]
# The band has to hold for half a period of the default sine at least: every phase of |e|.
DWELL = 1.0  # [s]


class TrackingError:
    """Size of the error e = q - q_d in the steady regime.

    `rms_error`, `peak_error` = max |e| and `steady_error`, the mean of e with its sign, each of
    shape (..., 2N) [m], [rad]; NaN without a row. For a periodic reference all three are exact
    over whole periods.
    """

    def __init__(self, like: np.ndarray) -> None:
        """Like a row of the error."""
        self._rows = 0
        self._sum = np.zeros_like(like)
        self._squares = np.zeros_like(like)
        self._largest = np.zeros_like(like)

    def update(self, error: np.ndarray, squares: np.ndarray) -> None:
        """Rows of e [m], [rad] and of e^2, both of shape (k, ..., 2N)."""
        self._rows += len(error)
        add_rows(self._sum, error)
        add_rows(self._squares, squares)
        keep_largest(self._largest, squares)

    def result(self) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (..., 2N)."""
        rows = self._rows or math.nan
        return {
            "rms_error": np.sqrt(self._squares / rows),
            "peak_error": np.sqrt(self._largest * (rows / rows)),  # sqrt(e^2) is exactly |e|
            "steady_error": self._sum / rows,
        }


def default_band(modules: int) -> np.ndarray:
    """`SLIDE_BAND` for slides and `BEND_BAND` for bends, shape (2N,) [m], [rad]."""
    return np.repeat([SLIDE_BAND, BEND_BAND], modules)


class Settling:
    """When the error enters a band for good.

    `settling_time` is the first instant from which |e| <= band until the end of the run, shape
    (..., 2N) [s]. It is NaN, and `settled` is 0 instead of 1, unless the error was within the band
    for at least the last `DWELL` seconds: how long an unsettled arm would have taken is not known,
    and the length of the run says nothing about it.
    """

    def __init__(self, like: np.ndarray, period: float, band: npt.ArrayLike) -> None:
        """Like a row of the error; control period [s] and a band that broadcasts to it."""
        self._period = period
        self._limit = np.square(filled("settling band", band, like))
        self._rows = 0
        self._last_outside = np.full_like(like, -1.0)  # number of a row

    def update(self, squares: np.ndarray) -> None:
        """Rows of e^2, shape (k, ..., 2N), from the start of the run on."""
        outside = squares > self._limit
        if np.any(outside):
            last = float(self._rows + len(squares) - 1)
            if len(squares) == 1:
                self._last_outside = np.where(outside[0], last, self._last_outside)
            else:
                found, back = first_true(outside[::-1])
                self._last_outside = np.where(found, last - back, self._last_outside)
        self._rows += len(squares)

    def result(self) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (..., 2N)."""
        inside = self._rows - 1.0 - self._last_outside  # rows at the end of the run
        settled = inside * self._period >= DWELL * (1.0 - 1e-9)
        time = (self._last_outside + 1.0) * self._period
        return {
            "settling_time": np.where(settled, time, np.nan),
            "settled": np.where(settled, 1.0, 0.0),
        }


class Overshoot:
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

    def __init__(self, start: np.ndarray, desired: np.ndarray, band: npt.ArrayLike) -> None:
        """The first rows of q and q_d, and the settling band."""
        self._start = start.copy(order="K")
        self._band = filled("settling band", band, start)
        self._early, self._late = Extremes(start), Extremes(start)
        self._desired = Extremes(desired)

    def update(self, q: np.ndarray, q_d: np.ndarray, steady: bool) -> None:
        """Rows of shape (k, ..., 2N) [m], [rad], and whether they belong to the steady regime."""
        (self._late if steady else self._early).update(q)
        if steady:
            self._desired.update(q_d)

    def reached(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest and smallest q of the whole run, each of shape (..., 2N) [m], [rad]."""
        return (
            np.maximum(self._early.largest, self._late.largest),
            np.minimum(self._early.smallest, self._late.smallest),
        )

    def result(self) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (..., 2N)."""
        top, bottom = self._desired.largest, self._desired.smallest
        centre, amplitude = 0.5 * (top + bottom), 0.5 * (top - bottom)
        moves = amplitude > 0.0
        above, below = self._late.largest - centre, centre - self._late.smallest
        return {
            "overshoot": _percent(np.maximum(above, below), amplitude, moves),
            "undershoot": _percent(np.minimum(above, below), amplitude, moves),
            "step_overshoot": self._step(top, top == bottom),
        }

    def _step(self, goal: np.ndarray, rests: np.ndarray) -> np.ndarray:
        way = goal - self._start
        largest, smallest = self.reached()
        gone = np.where(way > 0.0, largest - self._start, self._start - smallest)
        return _percent(gone, np.abs(way), rests & (np.abs(way) > self._band))


def _percent(reached: np.ndarray, size: np.ndarray, meant: np.ndarray) -> np.ndarray:
    """100 (reached / size - 1), NaN where it is not meant."""
    return np.where(meant, 100.0 * ((reached - size) / np.where(meant, size, 1.0)), np.nan)


class TipError:
    """Distance between the tip p_N(q) and where the reference wants it, p_N(q_d).

    `tip_rms_error` and `tip_peak_error` in the steady regime, each of shape (...) [m]; NaN without
    a row.
    """

    def __init__(self, like: np.ndarray) -> None:
        """Like a row of the coordinates."""
        self._rows = 0
        self._squares = np.zeros_like(like[..., 0])
        self._largest = np.zeros_like(like[..., 0])

    def update(self, q: np.ndarray, q_d: np.ndarray) -> None:
        """Rows of shape (k, ..., 2N) [m], [rad]."""
        self._rows += len(q)
        shared = q_d.size == q_d.shape[-1]  # then it is one point, worked out with plain numbers
        (x, y), (x_d, y_d) = tip(q), tip(q_d.reshape(-1) if shared else q_d)
        dx, dy = x - x_d, y - y_d
        squares = np.asarray(dx * dx + dy * dy)
        add_rows(self._squares, squares)
        keep_largest(self._largest, squares)

    def result(self) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (...) [m]."""
        rows = self._rows or math.nan
        return {
            "tip_rms_error": np.sqrt(self._squares / rows),
            "tip_peak_error": np.sqrt(self._largest * (rows / rows)),
        }


def tip(q: np.ndarray) -> tuple[Entry, Entry]:
    """The tip p_N of `octarm.lagrange.positions`, x and y of shape (...) [m].

    Elementwise, with one tangent of half the angle, which NumPy has several times as fast as a
    sine and a cosine.
    """
    n = q.shape[-1] // 2
    entries = split(q)
    x = entries[0]
    y: Entry = 0.0
    phi: Entry = 0.0
    for i, theta in enumerate(entries[n:-1], 1):
        phi = phi + theta
        half = np.tan(0.5 * phi)
        share = 2.0 / (1.0 + half * half)  # 1 + cos phi
        x = x + entries[i] * (share - 1.0)
        y = y + entries[i] * (share * half)
    return x, y
