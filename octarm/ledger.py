"""The disturbance ledger: what each disturbance was asked to do, and what was delivered.

Measured on one arm, on what really arrived: the forces that MuJoCo was stepped with, the parameters
in its model, and the readings that the controller got. Sums, peaks and times are of the whole run;
spectra and delays are of its first 65 536 physics steps.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import signal

from octarm.disturbances import Acting, from_dict, spelling, to_dict
from octarm.effects.actuators import ActuationDelay
from octarm.effects.episode import ActuatorFault, Disturbance, Force, PlantChange, SensorFault
from octarm.effects.forces import BandLimitedNoise, SineForce
from octarm.effects.sensors import MeasurementDelay, MeasurementNoise
from octarm.parameters import ArmParameters
from octarm.plant import ArmPhysics

_WINDOW = 65_536  # physics steps
_HOLDS = 40  # fewer of a noise do not tell its spectrum


class Ledger:
    """Watches one arm: `physics.watch = ledger.step` before the episode, `rows` after it.

    It starts anew with every episode.
    """

    def __init__(self, disturbances: Sequence[Disturbance], physics: ArmPhysics) -> None:
        """Watches this arm, whose episodes have these disturbances."""
        self._disturbances = disturbances
        self._physics = physics
        self._begin()

    def step(self, physics: ArmPhysics) -> None:
        """An episode has begun, or a physics step has been done."""
        acting, step = physics.acting, physics.steps() - 1
        if acting is None:
            return
        if step < 0:
            self._begin()
        else:
            self._take_up(step)
        if step < 0 or any(process.changes_at(step) for _, process in acting.plant_changes):
            self._arms.append(_arm(physics))
        if acting.sensors:
            self._truth = np.concatenate([physics.q(), physics.v()])
            self._motion.add(step + 1, self._truth)

    def rows(self) -> list[dict[str, Any]]:
        """An entry for each disturbance: `name`, `asked`, and `delivered`, ready for JSON.

        Lists are in the order of q, of tau for inputs, and of q, then v for readings. None stands
        for what could not be seen, or was not finite.
        """
        rows, acting = asked(self._disturbances), self._physics.acting
        with np.errstate(all="ignore"):  # a diverged arm may hold anything
            if acting is not None and self._truth.size and self._physics.steps() == 0:
                self._hear(acting, 0)  # the run ended with the first readings
            for row, disturbance in zip(rows, self._disturbances, strict=True):
                row["delivered"] = _finite(self._delivered(disturbance, row["name"]))
        return rows

    def _begin(self) -> None:
        self._arms: list[dict[str, np.ndarray]] = []  # whenever they changed, from the start on
        self._tau, self._motion = _Record(), _Record()
        self._truth = np.empty(0)
        self._forces: dict[str, _Record] = {}
        self._inputs: dict[str, _Record] = {}
        self._readings: dict[str, _Record] = {}
        self._read: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._unexplained = np.zeros(())

    @np.errstate(all="ignore")
    def _take_up(self, step: int) -> None:
        """What acted during a physics step, and the readings if it is the first of a period."""
        physics = self._physics
        acting = physics.acting
        assert acting is not None
        for name, share in acting.shares.items():
            self._forces.setdefault(name, _Record()).add(step, share)
        if acting.forces:
            missing = np.abs(physics.added() - sum(acting.shares.values()))
            self._unexplained = np.maximum(self._unexplained, np.max(missing))
        before, source = physics.tau(), self._tau
        if acting.actuators:
            source.add(step, before)
        for name, received in acting.inputs.items():
            record = self._inputs.setdefault(name, _Record(source))
            record.add(step, received, before=before)
            before, source = received, record
        self._hear(acting, step)

    def _hear(self, acting: Acting, step: int) -> None:
        """The readings, if they are new."""
        before, source = self._truth, self._motion
        for name, reading in acting.readings.items():
            if reading is self._read.get(name):
                break  # the controller still goes by what it got earlier
            self._read[name], after = reading, np.concatenate(reading)
            record = self._readings.setdefault(name, _Record(source))
            record.add(step, after, before=before)
            before, source = after, record

    def _delivered(self, disturbance: Disturbance, name: str) -> dict[str, Any]:
        acting = self._physics.acting
        if isinstance(disturbance, PlantChange) and acting is not None and self._arms:
            return _changes(_table(acting.undisturbed.parameters, 0.0), self._arms)
        for family, records in (
            (Force, self._forces),
            (ActuatorFault, self._inputs),
            (SensorFault, self._readings),
        ):
            if isinstance(disturbance, family) and name in records:
                return self._character(disturbance, name, records[name])
        return {}

    def _character(self, disturbance: Disturbance, name: str, record: _Record) -> dict[str, Any]:
        """How strong it was, and what makes a disturbance of its class what it is."""
        dt, sizes = self._physics.timestep(), record.sizes()
        acting = self._physics.acting
        assert acting is not None
        processes: dict[str, Any] = dict([*acting.forces, *acting.sensors])
        match disturbance:
            case BandLimitedNoise():
                wanted = {"rms_asked": processes[name].rms}
                more = _band(record.rows(), dt) | {"unexplained": self._unexplained}
                return wanted | sizes | more
            case MeasurementNoise():
                process = processes[name]
                return {"rms_asked": np.concatenate([process.rms_q, process.rms_v])} | sizes
            case SineForce():
                return sizes | _line(record.rows(), dt) | {"unexplained": self._unexplained}
            case Force():
                return sizes | record.presence(dt) | {"unexplained": self._unexplained}
            case ActuationDelay() | MeasurementDelay():
                return sizes | {"delay": dt * record.delay()}
            case _:
                return sizes


class _Record:
    """A signal: its first rows, the numbers of their steps, and sums over all of them."""

    def __init__(self, source: _Record | None = None) -> None:
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
        """The signal at a physics step, and what it was before the disturbance."""
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
        """The first rows, shape (K, ...)."""
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


def _arm(physics: ArmPhysics) -> dict[str, np.ndarray]:
    """The parameters in MuJoCo's model, and where its gravity points."""
    model = physics.model.ptr
    gravity = model.opt.gravity
    return _table(ArmParameters.from_model(model), np.arctan2(gravity[0], -gravity[2]))


def _table(p: ArmParameters, gravity_angle: float) -> dict[str, np.ndarray]:
    """Parameters by name, with the angle of gravity [rad] for its size, which nothing changes."""
    fields = {name: np.asarray(value) for name, value in p.to_dict().items() if name != "gravity"}
    return fields | {"gravity_angle": np.asarray(gravity_angle)}


def _changes(
    undisturbed: dict[str, np.ndarray], arms: Sequence[dict[str, np.ndarray]]
) -> dict[str, Any]:
    """Parameters that were not always what they are undisturbed: at some moments, and extremes."""
    out = {}
    for name, original in undisturbed.items():
        values = np.stack([arm[name] for arm in arms])
        if np.any(values != original):
            moments = {"undisturbed": original, "start": values[0], "end": values[-1]}
            out[name] = moments | {"least": values.min(axis=0), "most": values.max(axis=0)}
    return out


def _band(rows: np.ndarray, dt: float) -> dict[str, float]:
    """A noise: mean time between its changes [s], and where its power density is halved [Hz]."""
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


def _line(rows: np.ndarray, dt: float) -> dict[str, float]:
    """A sine: the frequency of its strongest line [Hz], and the share of power around it.

    A force on the tip acts on each coordinate by a lever that moves; all of them count alike.
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


def _finite(value: Any) -> Any:
    """Numbers, lists and dicts for JSON, with None for what is not finite."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return value if math.isfinite(value) else None


def asked(disturbances: Sequence[Disturbance]) -> list[dict[str, Any]]:
    """An entry for each disturbance, `name` and `asked`: the ledger before a run."""
    rows, counts = [], {}
    for disturbance in disturbances:
        fields = to_dict(disturbance)
        kind = fields.pop("name")
        count = counts[kind] = counts.get(kind, 0) + 1
        rows.append({"name": kind if count == 1 else f"{kind}-{count}", "asked": fields})
    return rows


def in_words(rows: Sequence[dict[str, Any]]) -> list[str]:
    """What was asked and what was delivered, a line a disturbance, for the terminal."""
    return [f"  {_spelt(row)} -> {_words(row['delivered'])}" for row in rows]


def _spelt(row: dict[str, Any]) -> str:
    name = re.sub(r"-\d+$", "", row["name"])  # noise-2 is a noise
    return spelling(from_dict({"name": name, **row["asked"]}))


def _words(delivered: dict[str, Any]) -> str:
    if not delivered:
        return "nothing"
    parts = []
    for name, value in delivered.items():
        if isinstance(value, dict):
            parts.append(f"{name} {_number(value['undisturbed'])} -> {_number(value['end'])}")
            ends = [value["undisturbed"], value["end"]]
            if np.any(value["least"] < np.min(ends, 0)) or np.any(value["most"] > np.max(ends, 0)):
                between = _number(value["least"]), _number(value["most"])
                parts[-1] += ", in between {} to {}".format(*between)
        elif name not in ("peak", "unexplained"):
            unit = "" if value is None else _UNITS.get(name, "")
            parts.append(f"{name.replace('_', ' ')} {_number(value)}{unit}")
    return "; ".join(parts)


def _number(value: Any) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(map(_number, value)) + ")"
    return "unknown" if value is None else f"{value:.3g}"


_UNITS = {
    "hold": " s",
    "corner": " Hz",
    "frequency": " Hz",
    "delay": " s",
    "from": " s",
    "until": " s",
}
