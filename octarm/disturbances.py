"""All disturbances: by name, on the command line, in `run.json`, and at work together.

On the command line a disturbance is NAME:VALUE[,KEY=VALUE]*, such as `payload:0.2,at=3`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from operator import is_
from typing import Any

import numpy as np

from octarm.effects.actuators import (
    ActuationDelay,
    DeadZone,
    Lag,
    LossOfEffectiveness,
    Saturation,
    SlewLimit,
)
from octarm.effects.episode import (
    ActuatorFault,
    ActuatorProcess,
    Disturbance,
    Episode,
    Force,
    ForceProcess,
    Plant,
    PlantChange,
    PlantProcess,
    SensorFault,
    SensorProcess,
    field_kinds,
)
from octarm.effects.fields import Amount, Quantity
from octarm.effects.forces import BandLimitedNoise, PulseForce, SineForce, StepForce
from octarm.effects.plant_changes import (
    CyclicDrift,
    Drift,
    GravityTilt,
    Mismatch,
    Payload,
    RandomMismatch,
)
from octarm.effects.sensors import MeasurementDelay, MeasurementNoise, Quantisation
from octarm.errors import closest
from octarm.parameters import ArmParameters

# In the order in which those of one family act, whatever the order in which they are listed.
DISTURBANCES: dict[str, type[Disturbance]] = {
    cls.name: cls
    for cls in (
        BandLimitedNoise,
        SineForce,
        PulseForce,
        StepForce,
        Mismatch,  # parameters of the bare arm, before it is loaded
        RandomMismatch,
        Drift,
        CyclicDrift,
        Payload,
        GravityTilt,
        ActuationDelay,  # from the controller to the plate: a line, a valve, a column
        DeadZone,
        Saturation,
        SlewLimit,
        Lag,
        LossOfEffectiveness,
        MeasurementDelay,  # reads the true motion
        MeasurementNoise,
        Quantisation,
    )
}

_SIMULATED = (1e-14, 1e14)  # masses [kg] and inertias [kg m^2]; beyond, MuJoCo divides by zero


def parse_disturbance(text: str) -> Disturbance:
    """A disturbance from its spelling on the command line.

    VALUE is that of the first field; a field that may differ between coordinates takes one number
    for each of them as well, separated by `/`, as in `loss:0/0/0.5/0/0/0`.

    Raises:
        ValueError: if a name or key is unknown or given twice, or a value missing or not allowed.
    """
    name, _, rest = text.partition(":")
    cls = _named(name)
    keys = _keys(cls)
    values: dict[str, Any] = {}
    for i, item in enumerate(rest.split(",") if rest else []):
        key, equals, value = item.partition("=")
        if not equals and i > 0:
            raise ValueError(f"{text!r} has {item!r}; it must read {_usage(cls)}")
        key, value = (key, value) if equals else (next(iter(keys)), item)
        if key not in keys:
            raise ValueError(f"{name} has no key {key!r}{closest(key, keys)}")
        if keys[key] in values:
            raise ValueError(f"{text!r} gives {key} twice")
        values[keys[key]] = _value(text, key, value, field_kinds(cls)[keys[key]])
    if not values or any(field not in values for field in _required(cls)):
        raise ValueError(f"{text!r} is incomplete; it must read {_usage(cls)}")
    return cls(**values)


def spelling(disturbance: Disturbance) -> str:
    """The inverse of `parse_disturbance`, for one arm; without the fields that have their defaults.

    Numbers have 6 digits.
    """
    main, *_ = keys = _keys(type(disturbance))
    defaults = {f.name: f.default for f in dataclasses.fields(disturbance)}  # pyright: ignore[reportArgumentType]
    values = {key: getattr(disturbance, field) for key, field in keys.items()}
    shown = [
        f"{key}={_spelt(value)}"
        for key, value in values.items()
        if value is not None and (key == main or np.ndim(value) > 0 or value != defaults[keys[key]])
    ]
    return f"{disturbance.name}:{','.join(shown).removeprefix(f'{main}=')}"


def to_dict(disturbance: Disturbance) -> dict[str, Any]:
    """Name and fields as words, numbers and lists, ready for JSON; infinity as a word."""
    fields = {f.name: getattr(disturbance, f.name) for f in dataclasses.fields(disturbance)}  # pyright: ignore[reportArgumentType]
    return {"name": disturbance.name, **{name: _plain(value) for name, value in fields.items()}}


def from_dict(description: Mapping[str, Any]) -> Disturbance:
    """The inverse of `to_dict`.

    Raises:
        ValueError: if the name or a field is unknown, missing or not allowed.
    """
    cls = _named(str(description.get("name")))
    fields = {key: value for key, value in description.items() if key != "name"}
    known = field_kinds(cls)
    for key in fields:
        if key not in known:
            raise ValueError(f"{cls.name} has no field {key!r}{closest(key, known)}")
    for key in _required(cls):
        if key not in fields:
            raise ValueError(f"{cls.name} needs the field {key!r}")
    return cls(**fields)


def describe() -> str:
    """How the disturbances are spelt and what they are, for `--help`."""
    lines = []
    for cls in DISTURBANCES.values():
        kinds = field_kinds(cls).values()
        units = [
            f"{key} [{kind.unit}]"
            for key, kind in zip(_keys(cls), kinds, strict=True)
            if isinstance(kind, Quantity)
        ]
        meaning = (cls.__doc__ or "").partition("\n")[0].rstrip(".:")
        lines += [_usage(cls), f"    {meaning}; {', '.join(units)}."]
    return "\n".join(lines)


class Acting:
    """The disturbances of one episode at work.

    Those of one family act in the order of `DISTURBANCES`. The second one of a class has streams
    and a name of its own, such as `noise-2`. Everything is asked for at every physics step from 0
    on, in order; asking again for the same step gives the same, but for `received`.

    Attributes:
        forces: names and processes, in order.
        plant_changes: likewise.
        actuators: likewise.
        sensors: likewise.
        shares: each force's own share of the last `force`, by name, shape (..., 2N) [N], [N m].
        inputs: what came out of each actuator fault in the last `received`, by name, shape
            (..., 2N) [N].
        readings: what came out of each sensor fault in the last `sensed`, by name.
        undisturbed: the arm as it is without plant changes.
    """

    def __init__(self, disturbances: Sequence[Disturbance], episode: Episode) -> None:
        """Starts them all.

        Raises:
            ValueError: if one does not suit the arm, the batch or the timestep, or two measurement
                delays are given.
        """
        self.forces: list[tuple[str, ForceProcess]] = []
        self.plant_changes: list[tuple[str, PlantProcess]] = []
        self.actuators: list[tuple[str, ActuatorProcess]] = []
        self.sensors: list[tuple[str, SensorProcess]] = []
        self.shares: dict[str, np.ndarray] = {}
        self.inputs: dict[str, np.ndarray] = {}
        self.readings: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._total = np.empty(0)
        self.undisturbed = Plant(episode.parameters)
        families = {
            Force: self.forces,
            PlantChange: self.plant_changes,
            ActuatorFault: self.actuators,
            SensorFault: self.sensors,
        }
        place = {cls: i for i, cls in enumerate(DISTURBANCES.values())}
        counts: dict[type, int] = {}
        for disturbance in sorted(disturbances, key=lambda d: place.get(type(d), len(place))):
            cls = type(disturbance)
            count = counts[cls] = counts.get(cls, 0) + 1
            if count > 1 and cls is MeasurementDelay:
                raise ValueError("measurement-delay is given twice; give the sum of both delays")
            name = disturbance.name if count == 1 else f"{disturbance.name}-{count}"
            process = disturbance.start(episode if count == 1 else episode.again(count))
            next(own for family, own in families.items() if issubclass(cls, family)).append(
                (name, process)
            )

    def received(self, step: int, tau: np.ndarray) -> np.ndarray:
        """The input forces that the plant receives at a physics step, shape (..., 2N) [N].

        Args:
            step: number of the physics step; each one is asked for once.
            tau: commanded input forces, shape (..., 2N) [N].
        """
        for name, process in self.actuators:
            self.inputs[name] = tau = process(step, tau)
        return tau

    def force(self, step: int, q: np.ndarray) -> np.ndarray:
        """The generalised force held over a physics step, shape (..., 2N) [N], [N m]; read-only.

        Args:
            step: number of the physics step.
            q: true coordinates at its start, shape (..., 2N) [m], [rad].
        """
        if not self.forces:
            return np.zeros_like(q)
        shares = {name: process(step, q) for name, process in self.forces}
        if not self.shares or not all(map(is_, shares.values(), self.shares.values())):
            self._total = _sum(list(shares.values()))
            self.shares = shares
        return self._total

    def plant(self, step: int) -> Plant | None:
        """The true arm from this physics step on; None when it is the one of the step before.

        At step 0 it is None only when nothing ever changes it.

        Raises:
            ValueError: at step 0, for an arm so light or so heavy that it cannot be simulated.
        """
        if not any([process.changes_at(step) for _, process in self.plant_changes]):
            return None
        plant = self.undisturbed
        for _, process in self.plant_changes:
            plant = process.apply(step, plant)
        if step == 0:
            _check_plant(plant.parameters)
        return plant

    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        """Shows the sensors the true motion: at step 0, and when `step` physics steps are done."""
        for _, process in self.sensors:
            process.record(step, q, v)

    def sensed(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the sensors report at a control instant, given the true motion.

        Args:
            step: number of the physics step that begins.
            q: true coordinates, shape (..., 2N) [m], [rad].
            v: true velocities, shape (..., 2N) [m/s], [rad/s].
        """
        for name, process in self.sensors:
            self.readings[name] = q, v = process(step, q, v)
        return q, v


def _check_plant(p: ArmParameters) -> None:
    low, high = _SIMULATED
    for name, unit, values in (("mass", "kg", p.mass), ("inertia", "kg m^2", p.inertia)):
        good = (values >= low) & (values <= high)
        if not np.all(good):
            raise ValueError(
                f"the disturbed arm has a module with {name} {values[~good].flat[0]:g} {unit}; "
                f"it must be between {low:g} and {high:g} {unit}"
            )


def _sum(shares: Sequence[np.ndarray]) -> np.ndarray:
    """Forces added in their order; 0.0 where nothing acts, never -0.0."""
    total = 0.0 + shares[0]
    for share in shares[1:]:
        total = total + share
    total.setflags(write=False)
    return total


def _named(name: str) -> type[Disturbance]:
    if name not in DISTURBANCES:
        raise ValueError(f"unknown disturbance {name!r}{closest(name, DISTURBANCES)}")
    return DISTURBANCES[name]


def _keys(cls: type[Disturbance]) -> dict[str, str]:
    """The spelling of each field, to its name."""
    return {kind.key or name: name for name, kind in field_kinds(cls).items()}


def _required(cls: type[Disturbance]) -> list[str]:
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    return [field.name for field in fields if field.default is dataclasses.MISSING]


def _usage(cls: type[Disturbance]) -> str:
    """The spelling with all keys: NAME:VALUE,KEY=default and so on."""
    defaults = {f.name: f.default for f in dataclasses.fields(cls)}  # pyright: ignore[reportArgumentType]
    main, *others = _keys(cls)
    parts = [f"{cls.name}:{main.upper()}"]
    for key in others:
        default = defaults[_keys(cls)[key]]
        shown = f"{default:g}" if isinstance(default, float) else default or key.upper()
        parts.append(f"{key}={shown}")
    return ",".join(parts)


def _value(text: str, key: str, value: str, kind: Any) -> Amount | str:
    if not isinstance(kind, Quantity):
        return value
    try:
        numbers = [float(part) for part in value.split("/")]
    except ValueError:
        raise ValueError(f"{text!r} gives {key} the value {value!r}; it must be a number") from None
    if len(numbers) > 1 and not kind.each:
        raise ValueError(f"{text!r} gives {key} {len(numbers)} numbers; it takes one")
    return numbers[0] if len(numbers) == 1 else np.array(numbers)


def _spelt(value: Any) -> str:
    numbers = value.tolist() if isinstance(value, np.ndarray) else [value]
    return "/".join(x if isinstance(x, str) else f"{x:g}" for x in numbers)


def _plain(value: Any) -> Any:
    """Numbers and lists; infinity, which JSON lacks, as a word that `from_dict` understands."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, float) and not np.isfinite(value) else value
