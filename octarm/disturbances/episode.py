"""What a disturbance is: a frozen description that starts a fresh process for each episode.

There are four families, by what they act on: the forces on the arm, the plant's parameters, the
input forces on their way to the plant, and the readings on their way to the controller.

A disturbance is a frozen dataclass of numbers with units. Its fields may differ from arm to arm: a
number for each arm has the shape of the batch, one for each coordinate broadcasts to the batch and
2N. `start` returns what changes during one episode, and nothing else does. Processes count physics
steps, never seconds: step k begins at k times the timestep. An arm alone and its row of a batch get
the same bits, and a neutral value (a ratio of 0, 0 kg, a factor of 1) leaves what it acts on
exactly as it was.
"""

from __future__ import annotations

import abc
import copy
import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from octarm.arm.groups import Groups
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.delivered import Measured
from octarm.disturbances.streams import HeldNoise, episode_seed, stream
from octarm.errors import OctarmError, closest, quoted
from octarm.fields import Amount, Quantity, field_defaults, field_kinds
from octarm.interfaces import Motion
from octarm.references import wanted

# The input amplitude is measured on this grid, whatever the physics step.
_WINDOW = 10.0  # [s]
_SAMPLES = 1000
_AT_ONCE = 20_000  # arms times instants


class Plant(NamedTuple):
    """The true arm at one instant, with or without batch axes.

    Attributes:
        gravity_angle: by which gravity is turned in the arm's plane, from the x axis of the base
            frame, along the hanging arm, towards its y axis, shape () or the batch's [rad].
    """

    parameters: ArmParameters
    gravity_angle: Amount = 0.0

    def last(self, first: int) -> Plant:
        """Those of the arms from this number on."""
        p, angle = self
        p = p.arm(slice(first, None)) if p.batch_shape else p
        return Plant(p, angle[first:] if isinstance(angle, np.ndarray) and angle.ndim else angle)


class Event(NamedTuple):
    """A moment [s] at which a disturbance begins, or ends, with an empty text."""

    at: float
    text: str


def any_arm(arm: ArmParameters) -> None:
    """Refuses no arm."""
    del arm


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """All that a disturbance may know when an episode starts.

    Attributes:
        parameters: the undisturbed true arm, as it is measured.
        timestep: physics step [s].
        seeds: of this episode, one for each arm; a single one for a single arm.
        batch_shape: () for one arm, (n,) for a batch.
        index: which one of the environment's episodes it is, from 0.
        occurrence: 1, or which one of several disturbances of the same class is started.
        check_arm: raises OctarmError for an arm that cannot be simulated, of those it may become.
        groups: of a plant of more modules; None where the plant is the arm itself.
    """

    parameters: ArmParameters
    timestep: float
    reference: Motion
    seeds: np.random.SeedSequence | Sequence[np.random.SeedSequence]
    batch_shape: tuple[int, ...] = ()
    index: int = 0
    occurrence: int = 1
    check_arm: Callable[[ArmParameters], object] = any_arm
    groups: Groups | None = None

    @property
    def _seeds(self) -> Sequence[np.random.SeedSequence]:
        return [self.seeds] if isinstance(self.seeds, np.random.SeedSequence) else self.seeds

    @property
    def plant(self) -> ArmParameters:
        """The undisturbed plant."""
        return self.parameters if self.groups is None else self.groups.plant

    def each_module(self, values: np.ndarray) -> np.ndarray:
        """Values for the modules of the arm, shape (..., N), for those of the plant."""
        return values if self.groups is None else self.groups.each_module(values)

    @property
    def coordinates(self) -> int:
        """Number of coordinates 2N."""
        return self.parameters.coordinates

    @property
    def model(self) -> LagrangeModel:
        """The analytic model of the undisturbed arm: names, scales and equations of motion."""
        return LagrangeModel(self.parameters)

    def selected(self, names: str) -> np.ndarray:
        """Whether a coordinate is named in `names`, such as `s1+theta2` or `all`, shape (2N,)."""
        known = self.model.names
        wanted = known if names == "all" else names.split("+")
        for name in wanted:
            if name not in known:
                raise OctarmError(f"unknown coordinate {quoted(name)}{closest(name, known)}")
        return np.array([name in wanted for name in known])

    def later(self, index: int) -> Episode:
        """The episode of this number, given episode 0: all that is random is drawn anew."""
        return self.changed(index=index, seeds=[episode_seed(seed, index) for seed in self._seeds])

    def changed(self, **fields: Any) -> Episode:
        """The same with other fields."""
        other = copy.copy(self)  # with the input amplitude, if it is known already
        vars(other).update(fields)
        return other

    def streams(self, name: str) -> list[np.random.Generator]:
        """The random streams of this name, one for each arm; see `stream`."""
        name = numbered(name, self.occurrence)
        return [stream(seed, name) for seed in self._seeds]

    def noise(self, disturbance: Disturbance, scale: np.ndarray) -> HeldNoise:
        """Noise of a disturbance with a field `correlation_time`, times a scale, shape (..., k)."""
        time = self.value(disturbance, "correlation_time")
        return HeldNoise(self.streams(disturbance.name), scale, time, self.timestep)

    def value(self, disturbance: Disturbance, field: str) -> Amount:
        """A field of numbers for the arms of this episode, whose shape must suit them.

        It has shape (..., 2N) if coordinates may have values of their own, else () or the batch's.
        """
        kind = field_kinds(type(disturbance))[field]
        each = isinstance(kind, Quantity) and kind.each
        value = getattr(disturbance, field)
        shape = (*self.batch_shape, self.coordinates) if each else self.batch_shape
        try:
            return np.broadcast_to(value, shape) if each or np.ndim(value) else value
        except ValueError:
            wanted, arms = "one number", f"each of the {sum(self.batch_shape)} arms"
            if each:
                wanted += f", or {self.coordinates}, one for each coordinate"
            if self.batch_shape:
                wanted += f", for {arms} or for all" if each else f", or one for {arms}"
            name = f"{kind.key or field} of {disturbance.name}"
            raise OctarmError(f"{name} has shape {np.shape(value)}; it must be {wanted}") from None

    def values(self, disturbance: Disturbance) -> dict[str, Amount]:
        """All fields of numbers by name, as `value` gives them, shapes (...) or (..., 2N)."""
        kinds = field_kinds(type(disturbance)).items()
        return {n: self.value(disturbance, n) for n, kind in kinds if isinstance(kind, Quantity)}

    @functools.cached_property
    def input_amplitude(self) -> np.ndarray:
        """The amplitude of the input signal, the same for every controller, shape (..., 2N).

        sqrt(2) times the standard deviation over time of each generalised force that the
        undisturbed arm needs to follow the reference exactly, D a_d + (C + B) v_d + G [N], [N m].
        Differences from the first value are added instant by instant: no cancellation, and the same
        bits for any batch.
        """
        first = total = square = np.zeros(())
        shape = (*self.batch_shape, self.coordinates)
        size = max(1, _AT_ONCE // len(self._seeds))  # instants that are computed at once
        for k in range(0, _SAMPLES, size):
            grid = range(k, min(k + size, _SAMPLES))
            times = [i * (_WINDOW / _SAMPLES) for i in grid]
            instants = [wanted(self.reference, t, shape) for t in times]
            parts = [np.stack(part) for part in zip(*instants, strict=True)]
            if self.parameters.batch_shape:  # after the axis of time
                parts = [part[:, None] if part.ndim == 2 else part for part in parts]
            forces = self.model.inverse_dynamics(*parts)
            first = forces[0] if k == 0 else first
            for force in forces:
                change = force - first
                total, square = total + change, square + change * change
        mean = total / _SAMPLES
        variance = square / _SAMPLES - mean * mean
        return np.sqrt(2.0 * np.maximum(variance, 0.0))


class Disturbance(abc.ABC):
    """Something that acts on the arm and that the controller does not know.

    Subclasses are frozen, keyword-only dataclasses without `eq`, since fields may be arrays. Every
    field is annotated with a `Quantity` or `Words`, by which it is checked; numbers become floats
    or read-only arrays. The command line takes the first field without a key. The first line of the
    docstring stands in the help.

    Attributes:
        name: as the command line, `run.json` and the random streams spell it.
        family: what it acts on; a heading in the help.
        instead_of_two: what to give instead of two of this class; empty if two may act together.
        units: of what `delivered` returns, where there is one unit for all coordinates.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    instead_of_two: ClassVar[str] = ""
    units: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        for name, kind in field_kinds(type(self)).items():
            value, optional = getattr(self, name), field_defaults(type(self)).get(name, ...) is None
            if not (optional and value is None):
                checked = kind.check(f"{kind.key or name} of {self.name}", value)
                object.__setattr__(self, name, checked)

    @abc.abstractmethod
    def start(self, episode: Episode) -> Any:
        """A fresh process for one episode, of the kind of its family.

        It raises an `OctarmError` if a field does not suit the arm, the batch or the timestep.
        """

    def delivered(self, measured: Measured) -> dict[str, Any]:
        """What the ledger states of an episode of one arm: numbers and arrays by name."""
        return measured.signal.sizes()

    def events(self) -> Sequence[Event]:
        """The moments at which it begins and ends, to be marked in pictures; of one arm."""
        return ()

    def carried(self) -> tuple[float, float] | None:
        """The mass that the tip carries and from when on [kg], [s], to be drawn; None if none."""
        return None

    def input_bound(self) -> Amount | None:
        """Bound on |tau|, broadcasts to (..., 2N) [N]; None if it sets none."""
        return None

    def gravity_angle(self) -> float:
        """By how much it turns gravity, to be drawn [rad]."""
        return 0.0

    def span(self, at: Amount, length: Amount = np.inf) -> list[Event]:
        """The events of one arm's disturbance that begins at a time [s] and lasts for a length [s].

        There are none if these are arrays of shape (n,), and no end if the length is infinite.
        """
        if np.ndim(at) or np.ndim(length):
            return []
        size = getattr(self, next(iter(field_kinds(type(self)))))
        text = f"{self.name} {size:g}" if isinstance(size, float) else self.name
        events = [Event(float(at), text), Event(float(at + length), "")]
        return events if np.isfinite(length) else events[:1]


# What `start` of a `Force` and of an `ActuatorFault` returns.
ForceProcess = ActuatorProcess = Callable[[int, np.ndarray], np.ndarray]


class PlantProcess(NamedTuple):
    """A change of the arm itself.

    Attributes:
        changes_at: whether `apply` at a physics step differs from the one before it.
        apply: the plant from a physics step on, given what it would be without this process.
        extremes: the same at the ends of the range that it goes through; when none are given, the
            plant is checked each time that it changes.
    """

    changes_at: Callable[[int], bool]
    apply: Callable[[int, Plant], Plant]
    extremes: Sequence[Callable[[Plant], Plant]] = ()


class SensorProcess(Protocol):
    """Something between the true motion and what the controller reads."""

    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        """Takes note of the true q and v, shapes (..., 2N), at step 0 and after each step."""

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is read of q and v as read so far, shapes (..., 2N), as a physics step begins."""
        ...


class Force(Disturbance):
    """A disturbance that pushes the arm.

    Its process gives the generalised force held over a physics step, shape (..., 2N) [N], [N m],
    from the number of the step and the true coordinates at its middle, as the velocities at its
    start predict them, shape (..., 2N) [m], [rad]: a run is of second order in the step.
    """

    family: ClassVar[str] = "forces"
    units: ClassVar[Mapping[str, str]] = {"from": "s", "until": "s"}

    def delivered(self, measured: Measured) -> dict[str, Any]:
        """How strong it was, when it acted, and the largest force that no disturbance explains."""
        sizes = measured.signal.sizes() | measured.signal.presence()
        return sizes | {"unexplained": measured.unexplained}


class PlantChange(Disturbance):
    """A disturbance that makes the arm another one; its process is a `PlantProcess`."""

    family: ClassVar[str] = "the arm"

    def delivered(self, measured: Measured) -> dict[str, Any]:
        """The parameters of the arm that were not always what they are undisturbed."""
        return measured.changes()


class ActuatorFault(Disturbance):
    """A disturbance of the input forces on their way to the plant.

    Its process is called once at every physics step, in order, with its number and the input forces
    that are asked for, shape (..., 2N) [N]. It returns those that the plant receives.
    """

    family: ClassVar[str] = "the inputs"


class SensorFault(Disturbance):
    """A disturbance of the readings; its process is a `SensorProcess`."""

    family: ClassVar[str] = "the readings"


def occurrences(disturbances: Iterable[Disturbance]) -> list[int]:
    """For each disturbance, which one of its name it is: 1, 2 and so on."""
    names = [disturbance.name for disturbance in disturbances]
    return [names[: i + 1].count(name) for i, name in enumerate(names)]


def numbered(name: str, occurrence: int) -> str:
    """The name itself of the first one, then `noise-2` and so on."""
    return name if occurrence == 1 else f"{name}-{occurrence}"
