"""Signals as they were delivered: how strong, from when to when, how late, and how fast."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import signal

_WINDOW = 65_536  # physics steps
_HOLDS = 40  # fewer of a noise do not tell its spectrum


class Record:
    """A signal: its first rows, the numbers of their steps, and sums over all of them."""

    def __init__(self, source: Record | None = None) -> None:
        """A signal, which may be made of another one."""
        self._source = source
        self._rows: list[np.ndarray] = []
        self._steps: list[int] = []
        self._count = 0
        self._squares: np.ndarray | float = 0.0
        self._changes: np.ndarray | float = 0.0
        self._changed: np.ndarray | int = 0
        self._peak: np.ndarray | float = 0.0
        self._acts: tuple[int, int] | None = None  # first and last step at which it is not zero

    def add(self, step: int, row: np.ndarray, *, before: np.ndarray | None = None) -> None:
        """The signal at a physics step, and what it was before the disturbance, shapes (k,)."""
        if step < _WINDOW:
            self._rows.append(row)
            self._steps.append(step)
        self._count += 1
        self._squares = self._squares + row * row
        self._peak = np.maximum(self._peak, np.abs(row))
        if before is not None:
            self._changes = self._changes + (row - before) ** 2
            self._changed = self._changed + (row != before)
        elif np.any(row):
            self._acts = (step if self._acts is None else self._acts[0], step)

    def rows(self) -> np.ndarray:
        """The first rows, shape (T, k)."""
        return np.stack(self._rows)

    def sizes(self) -> dict[str, Any]:
        """Root mean square and peak over the run, and how often a signal was changed."""
        if self._source is None:
            return {"rms": np.sqrt(self._squares / self._count), "peak": self._peak}
        return {
            "rms_change": np.sqrt(self._changes / self._count),
            "share_changed": np.asarray(self._changed) / self._count,
            "peak": self._peak,
        }

    def presence(self, dt: float) -> dict[str, float]:
        """When it began and ended [s]."""
        if self._acts is None:
            return {}
        return {"from": dt * self._acts[0], "until": dt * (self._acts[1] + 1)}

    def delay(self) -> float:
        """The number of steps after which it repeats its source exactly; NaN if there is none."""
        assert self._source is not None
        original, rows = self._source.rows(), self.rows()
        at = np.array(self._steps) - self._source._steps[0]
        usable = (at < len(original)) & np.all(np.isfinite(rows), axis=1)
        rows, at = rows[usable], at[usable]
        if not len(at):
            return math.nan
        like_last = np.flatnonzero(np.all(original == rows[-1], axis=1))
        for delay in at[-1] - like_last[like_last <= at[-1]][::-1]:
            late = at >= delay
            repeated = original[at[late] - delay]
            if np.array_equal(rows[late], repeated) and np.any(np.ptp(repeated, axis=0) > 0.0):
                return float(delay)
        return math.nan


def band(rows: np.ndarray, dt: float) -> dict[str, float]:
    """What makes a noise: how long it holds, and its band.

    Args:
        rows: force at each physics step, shape (T, k) [N], [N m].
        dt: physics step [s].

    Returns:
        `hold`, the mean time between changes [s], and `corner`, where the power density is halved
        [Hz]; of a signal too short to tell, less or nothing.
    """
    changes = np.flatnonzero(np.any(np.diff(rows, axis=0) != 0.0, axis=1))
    if len(changes) < 2:
        return {}
    hold = float(changes[-1] - changes[0]) / (len(changes) - 1)  # [steps]
    if len(changes) < _HOLDS:
        return {"hold": dt * hold}
    moving = rows[:, np.std(rows, axis=0) > 0.0]
    length = min(max(math.ceil(16.0 * hold), 256), len(rows) // 2)
    frequency, density = signal.welch(moving / moving.std(axis=0), 1.0 / dt, nperseg=length, axis=0)
    # Held over a physics step, as it acts, rather than sampled: times sinc^2.
    held = np.mean(density, axis=1) * np.sinc(frequency * dt) ** 2
    smooth = np.convolve(held[1:], np.ones(3) / 3.0, mode="valid")
    frequency = frequency[2:-1]
    level = np.mean(smooth[frequency * hold * dt < 0.15])
    below = np.flatnonzero(smooth < 0.5 * level)
    corner = float(frequency[below[0]]) if below.size else math.nan
    return {"hold": dt * hold, "corner": corner}


def line(rows: np.ndarray, dt: float) -> dict[str, float]:
    """What makes a sine: its frequency, and how pure it is.

    A force on the tip acts on each coordinate by a lever that moves; all of them count alike.

    Args:
        rows: force at each physics step, shape (T, k) [N], [N m].
        dt: physics step [s].

    Returns:
        `frequency` of the strongest line [Hz], and `share_in_line`, the power around it [1];
        nothing for less than two periods.
    """
    moving = rows[:, np.std(rows, axis=0) > 0.0]
    if moving.shape[1] == 0:
        return {}
    moving = (moving - moving.mean(axis=0)) / moving.std(axis=0)
    spectrum = np.fft.rfft(moving * np.hanning(len(moving))[:, None], axis=0)
    power = np.sum(np.abs(spectrum) ** 2, axis=1)
    at = int(np.argmax(power))
    if not 2 <= at < len(power) - 1:
        return {}  # less than two periods do not tell a frequency
    low, top, high = np.log(power[at - 1 : at + 2] + 1e-300)
    peak = at + 0.5 * (low - high) / (low - 2.0 * top + high)
    share = float(np.sum(power[at - 2 : at + 3]) / np.sum(power))
    return {"frequency": peak / (dt * len(rows)), "share_in_line": share}
