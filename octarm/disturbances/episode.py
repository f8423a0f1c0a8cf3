"""What a disturbance is: a frozen description that starts a fresh process for each episode.

There are four families, by what they act on: the forces on the arm, the plant's parameters, the
input forces on their way to the plant, and the readings on their way to the controller.

A disturbance is a frozen dataclass of numbers with units. Its fields may differ from arm to arm:
a number for each arm has the shape of the batch, one for each coordinate broadcasts to the batch
and 2N. `start` returns what changes during one episode, and nothing else does. Processes count
physics steps, never seconds: step k begins at k times the timestep.

What holds for all of them: an arm alone and its row of a batch get the same bits, and a neutral
value (a ratio of 0, 0 kg, a factor of 1) leaves what it acts on exactly as it was.
"""

from __future__ import annotations

import abc
import copy
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, get_type_hints

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.disturbances.amplitude import input_amplitude
from octarm.disturbances.fields import Amount, Quantity, Words
from octarm.disturbances.streams import stream
from octarm.errors import OctarmError
from octarm.interfaces import Motion


class Plant(NamedTuple):
    """The true arm at one instant.

    Attributes:
        parameters: with or without batch axes.
        gravity_angle: by which gravity is turned in the arm's plane, from the x axis of the base
            frame, along the hanging arm, towards its y axis, shape () or the batch's [rad].
    """

    parameters: ArmParameters
    gravity_angle: Amount = 0.0


class Event(NamedTuple):
    """A moment at which a disturbance begins or ends.

    Attributes:
        at: when [s].
        text: what begins, such as `payload 0.1`; empty when it ends.
    """

    at: float
    text: str


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """All that a disturbance may know when an episode starts.

    Attributes:
        parameters: the undisturbed true arm.
        timestep: physics step [s].
        reference: the desired motion.
        seeds: one for each arm; a single one for a single arm.
        batch_shape: () for one arm, (n,) for a batch.
        occurrence: 1, or which one of several disturbances of the same class is started.

    Raises:
        ValueError: if the number of seeds is not that of the arms.
    """

    parameters: ArmParameters
    timestep: float
    reference: Motion
    seeds: np.random.SeedSequence | Sequence[np.random.SeedSequence]
    batch_shape: tuple[int, ...] = ()
    occurrence: int = 1

    def __post_init__(self) -> None:
        arms = int(np.prod(self.batch_shape, dtype=int))
        if len(self.batch_shape) > 1 or len(self._seeds) != arms:
            raise OctarmError(
                f"{len(self._seeds)} seeds were given for arms of batch shape {self.batch_shape}"
            )

    @property
    def _seeds(self) -> Sequence[np.random.SeedSequence]:
        one = isinstance(self.seeds, np.random.SeedSequence)
        return [self.seeds] if one else self.seeds  # pyright: ignore

    @property
    def coordinates(self) -> int:
        """Number of coordinates 2N."""
        return self.parameters.coordinates

    def again(self, occurrence: int) -> Episode:
        """The same episode for a further disturbance of the same class."""
        other = copy.copy(self)
        object.__setattr__(other, "occurrence", occurrence)
        return other

    def streams(self, name: str) -> list[np.random.Generator]:
        """The random streams of this name, one for each arm; see `stream`."""
        name = name if self.occurrence == 1 else f"{name}-{self.occurrence}"
        return [stream(seed, name) for seed in self._seeds]

    def per_arm(self, name: str, value: Amount) -> Amount:
        """A number, or one for each arm, shape () or the batch's.

        Raises:
            ValueError: if the shape is another one; `name` says whose it is.
        """
        arms = f", or one for each of the {self.batch_shape[0]} arms" if self.batch_shape else ""
        value = self._fitting(name, value, self.batch_shape, f"one number{arms}")
        return np.broadcast_to(value, self.batch_shape) if np.ndim(value) else value

    def per_coordinate(self, name: str, value: Amount) -> np.ndarray:
        """Numbers for each coordinate, broadcast to shape (..., 2N).

        Raises:
            ValueError: if the shape does not fit; `name` says whose it is.
        """
        shape = (*self.batch_shape, self.coordinates)
        arms = (
            f", for each of the {self.batch_shape[0]} arms or for all" if self.batch_shape else ""
        )
        wanted = f"one number, or {self.coordinates}, one for each coordinate{arms}"
        return np.broadcast_to(self._fitting(name, value, shape, wanted), shape)

    @functools.cached_property
    def input_amplitude(self) -> np.ndarray:
        """The amplitude of the input signal, the same for every controller, shape (..., 2N).

        sqrt(2) times the standard deviation over time of each generalised force that the
        undisturbed arm needs to follow the reference exactly, D a_d + (C + B) v_d + G [N], [N m].
        """
        arms = int(np.prod(self.batch_shape, dtype=int))
        return input_amplitude(self.parameters, self.reference, arms)

    def _fitting(self, name: str, value: Amount, shape: tuple[int, ...], wanted: str) -> Amount:
        try:
            fits = np.broadcast_shapes(np.shape(value), shape) == shape
        except ValueError:
            fits = False
        if not fits:
            raise OctarmError(f"{name} has shape {np.shape(value)}; it must be {wanted}")
        return value


class ForceProcess(Protocol):
    """A force that acts on the arm."""

    def __call__(self, step: int, q: np.ndarray) -> np.ndarray:
        """The generalised force held over a physics step, shape (..., 2N) [N], [N m].

        Args:
            step: number of the physics step.
            q: true coordinates at its start, shape (..., 2N) [m], [rad].
        """
        ...


class PlantProcess(Protocol):
    """A change of the arm itself."""

    def changes_at(self, step: int) -> bool:
        """Whether `apply` at this physics step differs from the one before it."""
        ...

    def apply(self, step: int, plant: Plant) -> Plant:
        """The plant from this physics step on, given what it would be without this process."""
        ...


class ActuatorProcess(Protocol):
    """Something between the commanded input forces and the plant."""

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        """The input forces that the plant receives at a physics step, shape (..., 2N) [N].

        Called once at every physics step, in order.

        Args:
            step: number of the physics step.
            tau: input forces that are asked for, shape (..., 2N) [N].
        """
        ...


class SensorProcess(Protocol):
    """Something between the true motion and what the controller reads."""

    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        """Takes note of the true motion, at step 0 and after every physics step, in order.

        Args:
            step: number of physics steps that are done.
            q: true coordinates, shape (..., 2N) [m], [rad].
            v: true velocities, shape (..., 2N) [m/s], [rad/s].
        """
        ...

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The readings at a control instant.

        Args:
            step: number of the physics step that begins.
            q: coordinates as read so far, shape (..., 2N) [m], [rad].
            v: velocities as read so far, shape (..., 2N) [m/s], [rad/s].

        Returns:
            q and v as the controller gets them, of the same shapes and units.
        """
        ...


class Disturbance(abc.ABC):
    """Something that acts on the arm and that the controller does not know.

    Subclasses are frozen, keyword-only dataclasses without `eq`, since fields may be arrays. Every
    field is annotated with a `Quantity` or `Words`, by which it is checked; numbers become floats
    or read-only arrays. The command line takes the first field without a key.

    Attributes:
        name: as the command line, `run.json` and the random streams spell it.

    Raises:
        ValueError: if a field is not of its kind.
    """

    name: ClassVar[str]
    family: ClassVar[str]  # heading in the help

    def __post_init__(self) -> None:
        optional = {f.name for f in dataclasses.fields(self) if f.default is None}  # pyright: ignore
        for name, kind in field_kinds(type(self)).items():
            value = getattr(self, name)
            if not (value is None and name in optional):
                checked = kind.check(f"{kind.key or name} of {self.name}", value)
                object.__setattr__(self, name, checked)

    @abc.abstractmethod
    def start(self, episode: Episode) -> Any:
        """A fresh process for one episode.

        Raises:
            ValueError: if a field does not suit the arm, the batch or the timestep.
        """

    def events(self) -> Sequence[Event]:
        """The moments at which it begins and ends, to be marked in pictures; of one arm."""
        return ()

    def carried(self) -> tuple[float, float] | None:
        """The mass that the tip carries and from when on [kg], [s], to be drawn; None if none."""
        return None

    def input_bound(self) -> Amount | None:
        """Bound on |tau| to be drawn, broadcasts to (2N,) [N]; None if it sets none."""
        return None

    def gravity_angle(self) -> float:
        """By how much it turns gravity, to be drawn [rad]."""
        return 0.0


class Force(Disturbance):
    """A disturbance that pushes the arm."""

    family: ClassVar[str] = "forces"

    @abc.abstractmethod
    def start(self, episode: Episode) -> ForceProcess: ...  # noqa: D102


class PlantChange(Disturbance):
    """A disturbance that makes the arm another one."""

    family: ClassVar[str] = "the arm"

    @abc.abstractmethod
    def start(self, episode: Episode) -> PlantProcess: ...  # noqa: D102


class ActuatorFault(Disturbance):
    """A disturbance of the input forces on their way to the plant."""

    family: ClassVar[str] = "the inputs"

    @abc.abstractmethod
    def start(self, episode: Episode) -> ActuatorProcess: ...  # noqa: D102


class SensorFault(Disturbance):
    """A disturbance of the readings on their way to the controller."""

    family: ClassVar[str] = "the readings"

    @abc.abstractmethod
    def start(self, episode: Episode) -> SensorProcess: ...  # noqa: D102


@functools.cache
def field_kinds(cls: type[Disturbance]) -> dict[str, Quantity | Words]:
    """What the fields of a disturbance may be, by name, in their order."""
    hints = get_type_hints(cls, include_extras=True)
    return {f.name: hints[f.name].__metadata__[0] for f in dataclasses.fields(cls)}  # pyright: ignore
