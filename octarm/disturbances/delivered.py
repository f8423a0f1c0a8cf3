"""What was delivered in an episode: how strong a signal was, from when to when, and how late."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from octarm.disturbances.streams import in_steps

if TYPE_CHECKING:
    from octarm.arm.parameters import ArmParameters
    from octarm.disturbances.episode import Episode, Plant

_WINDOW = 65_536  # physics steps
_UNLIKE = 0.01  # share of the changes of a signal by which a late one may differ from it
_HOLDS = 40  # a noise of fewer numbers does not show its spectrum


class Record:
    """A signal of k numbers in an episode: its first rows, and sums over all of them.

    Sums, peaks and times are those of the whole episode; spectra and delays those of its first
    65 536 physics steps.
    """

    def __init__(self, timestep: float, source: Record | None = None) -> None:
        """A signal at physics steps [s], which may be what became of another signal."""
        self._timestep, self._source = timestep, source
        self._rows: list[np.ndarray] = []
        self._steps: list[int] = []
        self._count = 0
        self._squares: np.ndarray | float = 0.0
        self._changes: np.ndarray | float = 0.0
        self._changed: np.ndarray | int = 0
        self._peak: np.ndarray | float = 0.0
        self._active: tuple[int, int] | None = None  # first and last step at which it is not zero

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
            self._active = (step if self._active is None else self._active[0], step)

    def sizes(self) -> dict[str, Any]:
        """Root mean square and peak, and how often it differed from its source, shapes (k,)."""
        if self._source is None:
            return {"rms": np.sqrt(self._squares / self._count), "peak": self._peak}
        return {
            "rms_change": np.sqrt(self._changes / self._count),
            "share_changed": np.asarray(self._changed) / self._count,
            "peak": self._peak,
        }

    def presence(self) -> dict[str, float]:
        """When it was first and last different from zero [s]; nothing if it never was."""
        if self._active is None:
            return {}
        first, last = self._active
        return {"from": self._timestep * first, "until": self._timestep * (last + 1)}

    def delay(self, asked: float) -> float:
        """The time after which it repeats its source [s], next to the one asked for [s].

        It is the one between two physics steps by which it does so best; NaN if it does not.
        """
        assert self._source is not None
        original, rows = np.stack(self._source._rows), np.stack(self._rows)
        at, steps = np.array(self._steps) - self._source._steps[0], in_steps(asked, self._timestep)
        whole = math.floor(steps)
        late = (at > whole) & (at < len(original)) & np.all(np.isfinite(rows), axis=1)
        one, other = original[at[late] - whole], original[at[late] - whole - 1]
        change, gone = other - one, rows[late] - one
        size = float(np.sum(change * change))
        if not size > 0.0:
            return math.nan
        rest = float(np.sum(gone * change)) / size
        left = float(np.sum((gone - rest * change) ** 2)) / size
        good = 0.0 <= rest < 1.0 and left < _UNLIKE
        return self._timestep * (whole + rest) if good else math.nan

    def band(self) -> dict[str, float]:
        """`hold`, the mean time between changes [s], and `corner`, the band of half density [Hz].

        There is less or nothing for a signal too short to tell.
        """
        rows, dt = np.stack(self._rows), self._timestep
        changes = np.flatnonzero(np.any(np.diff(rows, axis=0) != 0.0, axis=1))
        if len(changes) < 2:
            return {}
        hold = float(changes[-1] - changes[0]) / (len(changes) - 1)  # [steps]
        if len(changes) < _HOLDS:
            return {"hold": dt * hold}
        from scipy import signal  # takes a tenth of a second to import

        moving = rows[:, np.std(rows, axis=0) > 0.0]
        length = min(max(math.ceil(16.0 * hold), 256), len(rows) // 2)
        frequency, density = signal.welch(
            moving / moving.std(axis=0), 1.0 / dt, nperseg=length, axis=0
        )
        # Held over a physics step, as it acts, rather than sampled: times sinc^2.
        held = np.mean(density, axis=1) * np.sinc(frequency * dt) ** 2
        smooth = np.convolve(held[1:], np.ones(3) / 3.0, mode="valid")
        frequency = frequency[2:-1]
        level = np.mean(smooth[frequency * hold * dt < 0.15])
        below = np.flatnonzero(smooth < 0.5 * level)
        corner = float(frequency[below[0]]) if below.size else math.nan
        return {"hold": dt * hold, "corner": corner}

    def line(self) -> dict[str, float]:
        """`frequency` of the strongest line [Hz], and `share_in_line`, the power around it [1].

        A force on the tip acts on each coordinate by a lever that moves; all of them count alike.
        There is nothing for less than two periods.
        """
        rows = np.stack(self._rows)
        moving = rows[:, np.std(rows, axis=0) > 0.0]
        if moving.shape[1] == 0:
            return {}
        moving = (moving - moving.mean(axis=0)) / moving.std(axis=0)
        spectrum = np.fft.rfft(moving * np.hanning(len(moving))[:, None], axis=0)
        power = np.sum(np.abs(spectrum) ** 2, axis=1)
        at = int(np.argmax(power))
        if not 2 <= at < len(power) - 1:
            return {}  # less than two periods do not show a frequency
        low, top, high = np.log(power[at - 1 : at + 2] + 1e-300)
        peak = at + 0.5 * (low - high) / (low - 2.0 * top + high)
        share = float(np.sum(power[at - 2 : at + 3]) / np.sum(power))
        return {"frequency": peak / (self._timestep * len(rows)), "share_in_line": share}


class Measured(NamedTuple):
    """What was measured of one disturbance during an episode of one arm.

    Attributes:
        episode: that it acted in.
        signal: the generalised force that it added, or the input forces or readings, q before v,
            that came out of it; empty for a change of the plant.
        plants: the true arm at the start, and whenever a disturbance had changed it.
        unexplained: largest force in the simulation, beyond those of the disturbances [N], [N m].
    """

    episode: Episode
    signal: Record
    plants: Sequence[Plant]
    unexplained: float

    def changes(self) -> dict[str, dict[str, np.ndarray]]:
        """Parameters that were not always what they are undisturbed, and the angle of gravity.

        Each of them at some moments, and its extremes, of the parameter's own shape (...).
        """
        arms = [_numbers(plant.parameters, plant.gravity_angle) for plant in self.plants]
        undisturbed = _numbers(self.episode.plant, 0.0)
        out: dict[str, dict[str, np.ndarray]] = {}
        for name, original in undisturbed.items():
            values = np.stack([arm[name] for arm in arms])
            if np.any(values != original):
                moments = {"undisturbed": original, "start": values[0], "end": values[-1]}
                out[name] = moments | {"least": values.min(axis=0), "most": values.max(axis=0)}
        return out


def _numbers(parameters: ArmParameters, gravity_angle: Any) -> dict[str, np.ndarray]:
    """Parameters that may change by name, with the angle of gravity [rad] for its size."""
    numbers = vars(parameters) | {"gravity_angle": gravity_angle}
    names = [field.name for field in dataclasses.fields(parameters)]
    fixed = ("gravity", "input_range")
    return {n: np.asarray(numbers[n]) for n in (*names, "gravity_angle") if n not in fixed}
