"""The disturbance ledger: what each disturbance was asked to do, and what was delivered.

Measured on one arm, on what really arrived: the forces that MuJoCo was stepped with, the parameters
in its model, and the readings that the controller got. Sums and peaks are of the whole run;
spectra and delays are of its first 65 536 physics steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import signal

from octarm.actuators import ActuationDelay
from octarm.disturbances import to_dict
from octarm.episode import ActuatorFault, Disturbance, Force, PlantChange, SensorFault
from octarm.forces import BandLimitedNoise, SineForce
from octarm.parameters import ArmParameters
from octarm.plant import ArmPhysics
from octarm.sensors import MeasurementDelay

_WINDOW = 65_536  # physics steps
_LONGEST_DELAY = 4_000  # physics steps among which a delay is searched


class Ledger:
    """Watches one arm during one run.

    `step` after every physics step, `instant` after every control period, `rows` at the end.
    """

    def __init__(self, disturbances: Sequence[Disturbance], physics: ArmPhysics) -> None:
        """Watches this arm, whose episode has these disturbances."""
        self._disturbances = disturbances
        self._physics = physics
        self._arms = [_arm(physics)]  # undisturbed, then during the first step
        self._tau, self._motion = _Record(), _Record()
        self._forces: dict[str, _Record] = {}
        self._inputs: dict[str, _Record] = {}
        self._readings: dict[str, _Record] = {}
        self._unexplained = 0.0

    def step(self, physics: ArmPhysics) -> None:
        """A physics step has been done."""
        acting = physics.acting
        if acting is None:
            return
        if len(self._arms) == 1:
            self._arms.append(_arm(physics))
        for name, share in acting.shares.items():
            self._forces.setdefault(name, _Record()).add(physics.steps() - 1, share)
        missing = physics.added() - sum(acting.shares.values())
        self._unexplained = max(self._unexplained, float(np.max(np.abs(missing))))
        asked = physics.tau()
        self._tau.add(physics.steps() - 1, asked)
        for name, received in acting.inputs.items():
            record = self._inputs.setdefault(name, _Record())
            record.add(physics.steps() - 1, received, before=asked)
            asked = received
        self._motion.add(physics.steps(), np.concatenate([physics.q(), physics.v()]))

    def instant(self, physics: ArmPhysics) -> None:
        """A control instant has come, and with it the readings for the next command."""
        acting = physics.acting
        before = np.concatenate([physics.q(), physics.v()])
        for name, reading in acting.readings.items() if acting is not None else ():
            after = np.concatenate(reading)
            record = self._readings.setdefault(name, _Record())
            record.add(physics.steps(), after, before=before)
            before = after

    def rows(self) -> list[dict[str, Any]]:
        """An entry for each disturbance: `name`, `asked`, and `delivered`, ready for JSON.

        Lists are in the order of q, of tau for inputs, and of q, then v for readings.
        """
        rows, counts = [], {}
        for disturbance in self._disturbances:
            count = counts[disturbance.name] = counts.get(disturbance.name, 0) + 1
            name = disturbance.name if count == 1 else f"{disturbance.name}-{count}"
            asked = {key: x for key, x in to_dict(disturbance).items() if key != "name"}
            rows.append(
                {"name": name, "asked": asked, "delivered": self._delivered(disturbance, name)}
            )
        return rows

    def _delivered(self, disturbance: Disturbance, name: str) -> dict[str, Any]:
        dt = self._physics.timestep()
        if isinstance(disturbance, PlantChange) and len(self._arms) == 2:
            return _changes(*self._arms, _arm(self._physics))
        for family, records in (
            (Force, self._forces),
            (ActuatorFault, self._inputs),
            (SensorFault, self._readings),
        ):
            if isinstance(disturbance, family) and name in records:
                return records[name].sizes() | self._character(disturbance, records[name], dt)
        return {}

    def _character(self, disturbance: Disturbance, record: _Record, dt: float) -> dict[str, Any]:
        """What makes a disturbance of its class what it is."""
        match disturbance:
            case BandLimitedNoise():
                return _band(record.rows(), dt) | {"unexplained": self._unexplained}
            case SineForce():
                return _line(record.rows(), dt) | {"unexplained": self._unexplained}
            case Force():
                return _presence(record.rows(), dt) | {"unexplained": self._unexplained}
            case ActuationDelay():
                return {"delay": dt * _delay(record, self._tau)}
            case MeasurementDelay():
                return {"delay": dt * _delay(record, self._motion)}
            case _:
                return {}


class _Record:
    """A signal: its first rows, the numbers of their steps, and sums over all of them."""

    def __init__(self) -> None:
        self._rows: list[np.ndarray] = []
        self._steps: list[int] = []
        self._count = 0
        self._squares: np.ndarray | float = 0.0
        self._changed = False
        self._changes: np.ndarray | float = 0.0
        self._peak: np.ndarray | float = 0.0

    def add(self, step: int, row: np.ndarray, *, before: np.ndarray | None = None) -> None:
        """The signal at a physics step, and what it was before the disturbance."""
        if self._count < _WINDOW:
            self._rows.append(row)
            self._steps.append(step)
        self._count += 1
        self._squares = self._squares + row * row
        self._peak = np.maximum(self._peak, np.abs(row))
        if before is not None:
            self._changed = True
            self._changes = self._changes + (row - before) ** 2

    def rows(self) -> np.ndarray:
        """The first rows, shape (K, ...)."""
        return np.stack(self._rows)

    def steps(self) -> np.ndarray:
        """The physics steps of the first rows, shape (K,)."""
        return np.array(self._steps)

    def sizes(self) -> dict[str, list[float]]:
        """Root mean square, of what was changed where something was, and peak, over the run."""
        name, squares = ("rms_change", self._changes) if self._changed else ("rms", self._squares)
        return {
            name: np.sqrt(squares / self._count).tolist(),
            "peak": np.asarray(self._peak).tolist(),
        }


def _arm(physics: ArmPhysics) -> tuple[ArmParameters, np.ndarray]:
    """The parameters in MuJoCo's model, and its gravity."""
    model = physics.model.ptr
    return ArmParameters.from_model(model), model.opt.gravity.copy()


def _changes(*arms: tuple[ArmParameters, np.ndarray]) -> dict[str, Any]:
    """Parameters that differ between the arms: without disturbance, at the start, at the end."""
    tables = [arm.to_dict() for arm, _ in arms]
    angles = [float(np.arctan2(gravity[0], -gravity[2])) for _, gravity in arms]
    for table, angle in zip(tables, angles, strict=True):
        table["gravity_angle"] = angle
    moments = ("undisturbed", "start", "end")
    return {
        name: dict(zip(moments, (table[name] for table in tables), strict=True))
        for name in tables[0]
        if any(table[name] != tables[0][name] for table in tables)
    }


def _band(rows: np.ndarray, dt: float) -> dict[str, float]:
    """A noise: mean time between its changes [s], and where its power density is halved [Hz]."""
    changes = int(np.sum(np.any(np.diff(rows, axis=0) != 0.0, axis=1)))
    moving = rows[:, np.std(rows, axis=0) > 0.0]
    if not changes:
        return {}
    frequency, density = signal.welch(
        moving / moving.std(axis=0),
        1.0 / dt,
        nperseg=min(len(rows), max(64, len(rows) // 16)),
        axis=0,
    )
    smooth = np.convolve(np.mean(density, axis=1)[1:], np.ones(3) / 3.0, mode="same")
    hold = dt * (len(rows) - 1) / changes
    low = frequency[1:] < 0.2 / hold
    below = np.flatnonzero(smooth < 0.5 * np.mean(smooth[low] if low.any() else smooth[:1]))
    return {"hold": hold, "corner": float(frequency[1 + below[0]]) if below.size else np.inf}


def _line(rows: np.ndarray, dt: float) -> dict[str, float]:
    """A sine: the frequency of its strongest line [Hz], and the share of power around it."""
    moving = rows[:, np.std(rows, axis=0) > 0.0]
    if not moving.size:
        return {}
    spectrum = np.fft.rfft(
        (moving - moving.mean(axis=0)) * np.hanning(len(moving))[:, None], axis=0
    )
    power = np.sum(np.abs(spectrum) ** 2, axis=1)
    at = int(np.argmax(power))
    share = float(np.sum(power[max(at - 2, 0) : at + 3]) / np.sum(power))
    return {"frequency": at / (dt * len(rows)), "share_in_line": share}


def _presence(rows: np.ndarray, dt: float) -> dict[str, float]:
    """A push: when it began and ended [s]."""
    acts = np.flatnonzero(np.any(rows != 0.0, axis=1))
    return {"from": dt * int(acts[0]), "until": dt * int(acts[-1] + 1)} if acts.size else {}


def _delay(record: _Record, source: _Record) -> int:
    """The delay at which a signal is most like its source, in physics steps."""
    rows, at = record.rows(), record.steps()
    original, first = source.rows(), int(source.steps()[0])
    at = at - first
    few = np.linspace(0, len(at) - 1, min(len(at), 1000)).astype(int)
    scale = np.std(original, axis=0)
    alive = scale > 0.0
    if not alive.any():
        return 0
    best, found = np.inf, 0
    for delay in range(min(_LONGEST_DELAY, len(original) - 1)):
        usable = few[(at[few] >= delay) & (at[few] - delay < len(original))]
        if len(usable) < max(2, len(few) // 4):
            break
        miss = (rows[usable] - original[at[usable] - delay])[:, alive] / scale[alive]
        size = float(np.mean(miss * miss))
        if size < best:
            best, found = size, delay
    return found


def in_words(rows: Sequence[dict[str, Any]]) -> list[str]:
    """What was delivered, a line a disturbance, for the terminal."""
    return [f"{row['name']:>18}  {_words(row['delivered'])}" for row in rows]


def _words(delivered: dict[str, Any]) -> str:
    if not delivered:
        return "nothing"
    parts = []
    for name, value in delivered.items():
        if isinstance(value, dict):
            parts.append(f"{name} {_number(value['undisturbed'])} -> {_number(value['end'])}")
        elif name not in ("peak", "unexplained"):
            parts.append(f"{name.replace('_', ' ')} {_number(value)}{_UNITS.get(name, '')}")
    return "; ".join(parts)


def _number(value: Any) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(map(_number, value)) + ")"
    return f"{value:.3g}"


_UNITS = {
    "hold": " s",
    "corner": " Hz",
    "frequency": " Hz",
    "delay": " s",
    "from": " s",
    "until": " s",
}
