"""The disturbance ledger: what each disturbance was asked to do, and what was delivered.

Measured on one arm, on what really arrived: the forces that MuJoCo was stepped with, the parameters
in its model, and the readings that the controller got. Sums, peaks and times are of the whole run;
spectra and delays are of its first 65 536 physics steps.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.disturbances.actuators import ActuationDelay
from octarm.disturbances.delivered import Record, band, line
from octarm.disturbances.episode import ActuatorFault, Disturbance, Force, PlantChange, SensorFault
from octarm.disturbances.forces import BandLimitedNoise, SineForce
from octarm.disturbances.sensors import MeasurementDelay, MeasurementNoise
from octarm.disturbances.spelling import Acting, from_dict, spelling, to_dict
from octarm.simulation.physics import ArmPhysics


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
        self._tau, self._motion = Record(), Record()
        self._truth = np.empty(0)
        self._forces: dict[str, Record] = {}
        self._inputs: dict[str, Record] = {}
        self._readings: dict[str, Record] = {}
        self._read: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._unexplained = np.zeros(())

    @np.errstate(all="ignore")
    def _take_up(self, step: int) -> None:
        """What acted during a physics step, and the readings if it is the first of a period."""
        physics = self._physics
        acting = physics.acting
        assert acting is not None
        for name, share in acting.shares.items():
            self._forces.setdefault(name, Record()).add(step, share)
        if acting.forces:
            missing = np.abs(physics.added() - sum(acting.shares.values()))
            self._unexplained = np.maximum(self._unexplained, np.max(missing))
        before, source = physics.tau(), self._tau
        if acting.actuators:
            source.add(step, before)
        for name, received in acting.inputs.items():
            record = self._inputs.setdefault(name, Record(source))
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
            record = self._readings.setdefault(name, Record(source))
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

    def _character(self, disturbance: Disturbance, name: str, record: Record) -> dict[str, Any]:
        """How strong it was, and what makes a disturbance of its class what it is."""
        dt, sizes = self._physics.timestep(), record.sizes()
        acting = self._physics.acting
        assert acting is not None
        processes: dict[str, Any] = dict([*acting.forces, *acting.sensors])
        match disturbance:
            case BandLimitedNoise():
                wanted = {"rms_asked": processes[name].rms}
                more = band(record.rows(), dt) | {"unexplained": self._unexplained}
                return wanted | sizes | more
            case MeasurementNoise():
                process = processes[name]
                return {"rms_asked": np.concatenate([process.rms_q, process.rms_v])} | sizes
            case SineForce():
                return sizes | line(record.rows(), dt) | {"unexplained": self._unexplained}
            case Force():
                return sizes | record.presence(dt) | {"unexplained": self._unexplained}
            case ActuationDelay() | MeasurementDelay():
                return sizes | {"delay": dt * record.delay()}
            case _:
                return sizes


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
    out: dict[str, Any] = {}
    for name, original in undisturbed.items():
        values = np.stack([arm[name] for arm in arms])
        if np.any(values != original):
            moments = {"undisturbed": original, "start": values[0], "end": values[-1]}
            out[name] = moments | {"least": values.min(axis=0), "most": values.max(axis=0)}
    return out


def _finite(value: Any) -> Any:
    """Numbers, lists and dicts for JSON, with None for what is not finite."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in cast("dict[str, Any]", value).items()}
    if isinstance(value, np.ndarray | np.generic):
        return _finite(value.tolist())
    if isinstance(value, list):
        return [_finite(item) for item in cast("list[Any]", value)]
    return value if math.isfinite(value) else None


def asked(disturbances: Sequence[Disturbance]) -> list[dict[str, Any]]:
    """An entry for each disturbance, `name` and `asked`: the ledger before a run."""
    rows: list[dict[str, Any]] = []
    counts: dict[str, int] = {}
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
    parts: list[str] = []
    for name, value in delivered.items():
        if isinstance(value, dict):
            parts.append(_change(name, cast("dict[str, Any]", value)))
        elif name not in ("peak", "unexplained"):
            unit = "" if value is None else _UNITS.get(name, "")
            parts.append(f"{name.replace('_', ' ')} {_number(value)}{unit}")
    return "; ".join(parts)


def _change(name: str, moments: dict[str, Any]) -> str:
    """A parameter before and at the end, and what it was in between if that is beyond both."""
    before, end, least, most = (moments[key] for key in ("undisturbed", "end", "least", "most"))
    said = f"{name} {_number(before)} -> {_number(end)}"
    if np.any(least < np.minimum(before, end)) or np.any(most > np.maximum(before, end)):
        return f"{said}, in between {_number(least)} to {_number(most)}"
    return said


def _number(value: Any) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(map(_number, cast("list[Any]", value))) + ")"
    return "unknown" if value is None else f"{value:.3g}"


_UNITS = {
    "hold": " s",
    "corner": " Hz",
    "frequency": " Hz",
    "delay": " s",
    "from": " s",
    "until": " s",
}
