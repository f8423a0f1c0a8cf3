"""Chattering of a force that is held from one physics step to the next."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from octarm.interfaces import Rows
from octarm.metrics.metric import FORCE, STEADY, Accumulator, Metric, Settings
from octarm.metrics.rows import Before, add_rows


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
        # After a jump the filter's answer decays as exp(-wt) ((1 - wt) y - w period z).
        self._y, self._z = np.zeros_like(like), np.zeros_like(like)
        self._yy, self._yz, self._zz = (np.zeros_like(like) for _ in range(3))
        self._variation = np.zeros_like(like)

    def update(self, rows: Rows, steady: bool) -> None:  # noqa: D102
        force = rows["force"]
        change = force - self._before(force)
        y, z = self._advance(change)
        if not steady:
            return
        self._rows += len(force)
        add_rows(self._yy, y * y)
        add_rows(self._yz, y * z)
        add_rows(self._zz, z * z)
        add_rows(self._variation, np.abs(change, out=change))

    def _advance(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The filter's state after each jump, both of shape (k, ..., 2N)."""
        y, z, decay = self._y, self._z, self._decay
        if len(change) == 1:
            _step(y, z, decay, change[0])
            return y[None], z[None]
        ys, zs = np.empty_like(change), np.empty_like(change)
        for i, jump in enumerate(change):
            _step(y, z, decay, jump)
            ys[i], zs[i] = y, z
        return ys, zs

    def result(self) -> dict[str, np.ndarray]:  # noqa: D102
        rows, settings = self._rows or math.nan, self._settings
        yy, yz, zz = self._weights
        square = (yy * self._yy + yz * self._yz + zz * self._zz) / rows
        return {
            "chattering": np.sqrt(np.maximum(square, 0.0)),  # rounding may go below zero
            "total_variation": self._variation / (rows * settings.step),
            "switching_activity": self._variation / (rows / settings.steps),
            "control_rate": np.asarray(1.0 / settings.control_period),
        }


def _step(y: np.ndarray, z: np.ndarray, decay: float, jump: np.ndarray) -> None:
    """One physics step, and the jump at its end."""
    z += y
    z *= decay
    y *= decay
    y += jump


def _mean_square(x: float) -> tuple[float, float, float]:
    """Weights of y^2, y z and z^2 in the mean of exp(-2u) ((1 - u) y - x z)^2 over 0 < u < x."""
    b, gone = math.exp(-2.0 * x), -math.expm1(-2.0 * x)
    linear = (gone + 2.0 * x * b) / 4.0  # integral of exp(-2u) (1 - u)
    square = (gone + 2.0 * x * b * (1.0 - x)) / 4.0  # integral of exp(-2u) (1 - u)^2
    return square / x, -2.0 * linear, x * gone / 2.0
