"""The disturbance ledger: what each disturbance was asked to do, and what was delivered.

Measured on one arm, on what really arrived: the forces that the simulation was stepped with, the
parameters in its model, and the readings that the controller got. What is stated of a disturbance,
it says itself in `Disturbance.delivered`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Protocol, cast

import numpy as np
from pydantic import Strict

from octarm.arrays import plain
from octarm.declared import BUILT_IN, Code
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.delivered import Measured, Record
from octarm.disturbances.episode import Disturbance, Plant, numbered, occurrences
from octarm.disturbances.spelling import DISTURBANCES, from_entry, spelling, to_dict
from octarm.formats import Array, Model

Number = Annotated[float, Strict(False)]  # infinity is a word in JSON
Moment = Annotated[tuple[Number, str], Strict(False)]
Load = Annotated[tuple[Number, Number], Strict(False)]

_NOT_IN_LINES = ("peak", "unexplained")
_MOST_NUMBERS = 12  # of a parameter or signal in a line; of more, the least and the largest one


class _Arm(Protocol):
    """What the ledger asks of `octarm.simulation.stepping.AnyPhysics` with one arm."""

    active: ActiveDisturbances | None

    def steps(self) -> int: ...
    def readings(self) -> tuple[np.ndarray, np.ndarray]: ...
    def added(self) -> np.ndarray: ...
    def plant(self) -> Plant: ...


class Ledger:
    """Watches one arm: `physics.watch = ledger.step` before the episode, `rows` after it.

    It starts anew with every episode.
    """

    def __init__(self, disturbances: Sequence[Disturbance], arm: _Arm) -> None:
        """Watches this arm, whose episodes have these disturbances."""
        self._disturbances = disturbances
        self._arm = arm
        self._signals: dict[str, Record] = {}

    def step(self, arm: _Arm) -> None:
        """An episode has begun, or a physics step has been done."""
        active, step = arm.active, arm.steps() - 1
        if active is None:
            return
        if step < 0:
            self._begin(active)
        else:
            self._measure(active, step)
        if step < 0 or active.plant_changes_at(step):
            self._plants.append(arm.plant())
        if active.sensors:
            self._truth = np.concatenate(arm.readings())
            self._motion.add(step + 1, self._truth)

    def rows(self) -> list[dict[str, Any]]:
        """An entry for each disturbance: `name`, `asked`, and `delivered`, ready for JSON.

        Lists are in the order of q, of tau for inputs, and of q, then v for readings. None stands
        for what could not be seen, or was not finite.
        """
        rows, active = asked(self._disturbances), self._arm.active
        with np.errstate(all="ignore"):  # a diverged arm may hold anything
            if active is not None and active.sensors and self._arm.steps() == 0:
                self._read(active, 0)  # the run ended with the first readings
            for row, disturbance in zip(rows, self._disturbances, strict=True):
                signal, delivered = self._signals.get(row["name"]), {}
                if active is not None and signal is not None:
                    of = Measured(active.episode, signal, self._plants, self._unexplained)
                    delivered = disturbance.delivered(of)
                row["delivered"] = _finite(delivered)
        return rows

    def _begin(self, active: ActiveDisturbances) -> None:
        self._timestep = active.episode.timestep
        self._plants: list[Plant] = []  # whenever they changed, from the start on
        self._tau, self._motion = Record(self._timestep), Record(self._timestep)
        self._signals = {name: Record(self._timestep) for name, _ in active.plant_changes}
        self._last_read: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._truth = np.empty(0)
        self._unexplained = 0.0

    @np.errstate(all="ignore")
    def _measure(self, active: ActiveDisturbances, step: int) -> None:
        """What acted during a physics step, and the readings if it is the first of a period."""
        for name, share in active.shares.items():
            self._signals.setdefault(name, Record(self._timestep)).add(step, share)
        if active.forces:
            missing = np.abs(self._arm.added() - sum(active.shares.values()))
            self._unexplained = np.maximum(self._unexplained, np.max(missing))
        before, source = active.commanded, self._tau
        if active.actuators:
            source.add(step, before)
        for name, received in active.inputs.items():
            record = self._signals.setdefault(name, Record(self._timestep, source))
            record.add(step, received, before=before)
            before, source = received, record
        self._read(active, step)

    def _read(self, active: ActiveDisturbances, step: int) -> None:
        before, source = self._truth, self._motion
        for name, reading in active.readings.items():
            if reading is self._last_read.get(name):
                break  # the controller still goes by what it got earlier
            self._last_read[name], after = reading, np.concatenate(reading)
            record = self._signals.setdefault(name, Record(self._timestep, source))
            record.add(step, after, before=before)
            before, source = after, record


def asked(disturbances: Sequence[Disturbance]) -> list[dict[str, Any]]:
    """An entry for each disturbance, `name` and `asked`: the ledger before a run.

    Those that are not built in have `drawn` as well, see `octarm.disturbances.ledger`.
    """
    rows: list[dict[str, Any]] = []
    for disturbance, count in zip(disturbances, occurrences(disturbances), strict=True):
        fields = to_dict(disturbance)
        rows.append({"name": numbered(fields.pop("name"), count), "asked": fields})
        if type(disturbance) not in DISTURBANCES.values():
            rows[-1]["drawn"] = Drawn.of(disturbance).model_dump()
    return rows


def in_words(rows: Sequence[dict[str, Any]], code: Mapping[str, Code] = BUILT_IN) -> list[str]:
    """What was asked and what was delivered, a line a disturbance, for the terminal.

    `code` has the disturbances that are not built in, by name.
    """
    return [_line(from_entry(row, code), row["delivered"]) for row in rows]


def _line(disturbance: Disturbance, delivered: dict[str, Any]) -> str:
    parts: list[str] = []
    for name, value in delivered.items():
        if isinstance(value, dict):
            parts.append(_change(name, cast("dict[str, Any]", value)))
        elif name not in _NOT_IN_LINES:
            unit = "" if value is None else f" {disturbance.units.get(name, '')}".rstrip()
            parts.append(f"{name.replace('_', ' ')} {_number(value)}{unit}")
    return f"  {spelling(disturbance)} -> {'; '.join(parts) or 'nothing'}"


def _change(name: str, moments: dict[str, Any]) -> str:
    before, end, least, most = (moments[key] for key in ("undisturbed", "end", "least", "most"))
    change = f"{name} {_number(before)} -> {_number(end)}"
    if np.any(least < np.minimum(before, end)) or np.any(most > np.maximum(before, end)):
        return f"{change}, in between {_number(least)} to {_number(most)}"
    return change


def _number(value: Any) -> str:
    if isinstance(value, list):
        numbers = np.array(cast("list[Any]", value), dtype=np.float64)
        if numbers.size > _MOST_NUMBERS:
            return f"{np.nanmin(numbers):.3g} .. {np.nanmax(numbers):.3g}"
        return "(" + ", ".join(map(_number, cast("list[Any]", value))) + ")"
    return "unknown" if value is None else f"{value:.3g}"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in cast("dict[str, Any]", value).items()}
    if isinstance(value, np.ndarray | np.generic):
        return _finite(value.tolist())
    if isinstance(value, list):
        return [_finite(item) for item in cast("list[Any]", value)]
    return value if math.isfinite(value) else None


class Drawn(Model):
    """How a disturbance of one arm is drawn, what it says of itself.

    Of one that is not built in `run.json` remembers it: whoever looks at a run need not have, nor
    import, what a user wrote.

    Attributes:
        moments: times [s] and texts of its events.
        load: mass that the tip carries, and from when on [kg], [s].
        bound: on |tau| [N].
        tilt: of gravity [rad].
    """

    moments: Array[Moment] = ()
    load: Load | None = None
    bound: Number | Array[Number] | None = None
    tilt: Number = 0.0

    @classmethod
    def of(cls, disturbance: Disturbance) -> Drawn:
        """What a disturbance of one arm answers."""
        return cls(
            moments=tuple((float(at), text) for at, text in disturbance.events()),
            load=disturbance.carried(),
            bound=plain(disturbance.input_bound()),
            tilt=float(disturbance.gravity_angle()),
        )
