"""Forces on the arm: band-limited noise on the joints; sines, pulses and steps on joints or tip."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np

from octarm.arm.kinematics import tip_force
from octarm.arrays import entry
from octarm.disturbances.delivered import Measured
from octarm.disturbances.episode import Episode, Event, Force, ForceProcess
from octarm.disturbances.streams import NEVER, HeldNoise, in_steps
from octarm.errors import OctarmError
from octarm.fields import PHASE, Amount, Quantity, Words

_TIP = {"tip-x": (1.0, 0.0), "tip-y": (0.0, 1.0)}  # directions in the base frame

Size = Annotated[Amount, Quantity("N or N m", plausible=1e4, usual=(0.0, 5.0))]
Start = Annotated[Amount, Quantity("s", at_least=0.0, plausible=3600.0)]
Length = Annotated[Amount, Quantity("s", above=0.0, plausible=3600.0, unbounded=True)]
Place = Annotated[str, Words(alone=("all", *_TIP), coordinates=True)]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class BandLimitedNoise(Force):
    """Band-limited white noise on the joints, a ratio of the input amplitude or of a given rms.

    Normal numbers, each held for a while. The rms of each coordinate's force is `ratio` times the
    amplitude of its input signal, see `Episode.input_amplitude`, or `rms` itself. The spectrum is
    flat at first and has lost half of its density at 0.443 / correlation_time. It acts `on` all
    coordinates, or on some such as `s1+theta2`.
    """

    name: ClassVar[str] = "noise"
    units: ClassVar[Mapping[str, str]] = {"hold": "s", "corner": "Hz"}
    ratio: Annotated[
        Amount | None, Quantity("1", at_least=0.0, plausible=20.0, each=True, usual=(0.0, 5.0))
    ] = None
    correlation_time: Annotated[Amount, Quantity("s", above=0.0, plausible=10.0, key="time")] = 0.01
    rms: Annotated[Amount | None, Quantity("N or N m", at_least=0.0, plausible=1e4, each=True)] = (
        None
    )
    on: Annotated[str, Words(alone=("all",), coordinates=True)] = "all"

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.ratio is None) == (self.rms is None):
            raise OctarmError("noise needs either a ratio or an rms, and not both")

    def start(self, episode: Episode) -> ForceProcess:
        return functools.partial(_held, episode.noise(self, self._wanted(episode)))

    def delivered(self, measured: Measured) -> dict[str, Any]:
        """The rms of each coordinate that was asked for and that was there, and the band."""
        sizes = {"rms_asked": self._wanted(measured.episode)} | measured.signal.sizes()
        return sizes | measured.signal.band() | {"unexplained": measured.unexplained}

    def _wanted(self, episode: Episode) -> np.ndarray:
        field = "rms" if self.ratio is None else "ratio"
        value = np.where(episode.selected(self.on), episode.value(self, field), 0.0)
        if self.ratio is None:
            return value
        rms = value * episode.input_amplitude
        if np.any(np.any(value > 0.0, axis=-1) & np.all(rms == 0.0, axis=-1)):
            raise OctarmError(
                "noise is a share of the input signal's amplitude, which is zero for this "
                "reference; give an rms instead"
            )
        return rms


def _held(noise: HeldNoise, step: int, q: np.ndarray) -> np.ndarray:
    del q
    return noise(step)


class _PushForce(Force):
    """A force whose size depends on time alone: from `at` on for a length, which may be infinite.

    It acts `on` coordinates such as `theta1` or `s1+s2`, on `all`, or on `tip-x` or `tip-y`, the
    tip along an axis of the base frame, x along the hanging arm.
    """

    amplitude: Amount
    at: Amount
    length: Amount = np.inf
    on: str

    def start(self, episode: Episode) -> ForceProcess:
        size = self._size(episode.values(self), episode.timestep)
        if self.on not in _TIP:
            return _Push(size, self.on, episode)
        return TipProcess(size, _TIP[self.on], episode.plant.entries.tip_length)

    def events(self) -> Sequence[Event]:
        return self.span(self.at, self.length)

    def _size(self, values: Mapping[str, Amount], timestep: float) -> Callable[[int], Amount]:
        """The size at a step, of shape () or (n,); one object as long as it stays."""
        at, length = values["at"], values.get("length", np.inf)
        return _Box(values["amplitude"], in_steps(at, timestep), in_steps(at + length, timestep))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SineForce(_PushForce):
    """A sine on joints or tip, amplitude sin(2 pi frequency (t - at) + phase).

    Over a physics step it is what it is at its start: a run is of first order in the step. The
    frequency must be below half of the physics rate.
    """

    name: ClassVar[str] = "sine"
    units: ClassVar[Mapping[str, str]] = {"frequency": "Hz"}
    amplitude: Size
    frequency: Annotated[Amount, Quantity("Hz", above=0.0)] = 1.0
    phase: Annotated[Amount, PHASE] = 0.0
    at: Start = 0.0
    length: Length = np.inf
    on: Place = "theta1"

    def _size(self, values: Mapping[str, Amount], timestep: float) -> Callable[[int], Amount]:
        highest, half_rate = float(np.max(self.frequency)), 0.5 / timestep
        if not highest < half_rate:
            raise OctarmError(
                f"frequency of sine is {highest:g} Hz; it must be below half of the physics rate, "
                f"{half_rate:g} Hz"
            )
        values = {**values, "omega": 2.0 * np.pi * values["frequency"]}
        return functools.partial(_sine, super()._size(values, timestep), values, timestep)

    def delivered(self, measured: Measured) -> dict[str, Any]:
        """How strong it was, its frequency and how pure it was."""
        sizes = measured.signal.sizes() | measured.signal.line()
        return sizes | {"unexplained": measured.unexplained}


def _sine(
    box: Callable[[int], Amount], values: Mapping[str, Amount], timestep: float, step: int
) -> Amount:
    """A box times sin(omega t + phase) at the beginning of a step, t counted from `at` [s]."""
    amplitude = box(step)
    if isinstance(amplitude, float) and amplitude == 0.0:
        return amplitude
    angle = values["omega"] * (step * timestep - values["at"]) + values["phase"]
    return entry(amplitude * np.sin(angle) + 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PulseForce(_PushForce):
    """A constant force on joints or tip from the time `at` on, for a while.

    A physics step that it covers in part gets that part of the force, so that the impulse is
    amplitude times length for any timestep.
    """

    name: ClassVar[str] = "pulse"
    amplitude: Size
    at: Start = 0.0
    length: Length = 0.1
    on: Place = "theta1"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class StepForce(_PushForce):
    """A constant force on joints or tip from the time `at` on, to the end."""

    name: ClassVar[str] = "step"
    amplitude: Size
    at: Start = 0.0
    on: Place = "theta1"


class TipProcess:
    """A force on the tip, wherever that is: a `ForceProcess` that needs the plant's coordinates.

    Its size at a physics step has shape () or (n,) [N], its direction is (x, y) in the base frame,
    the plant's tip length has shape () or (n,) [m].
    """

    def __init__(
        self, size: Callable[[int], Amount], direction: tuple[float, float], tip_length: Amount
    ) -> None:
        self._size, self._direction, self._tip_length = size, direction, tip_length

    def __call__(self, step: int, q: np.ndarray) -> np.ndarray:
        """The generalised force of a step, q being that of all modules, shapes (..., 2N)."""
        size, (x, y) = self._size(step), self._direction
        return tip_force(q, size * x, size * y, self._tip_length)


class _Push:
    def __init__(self, size: Callable[[int], Amount], on: str, episode: Episode) -> None:
        self._size = size
        self._places = np.flatnonzero(episode.selected(on)).tolist()
        self._shape = (*episode.batch_shape, episode.coordinates)
        self._last: Amount | None = None
        self._force = np.empty(0)

    def __call__(self, step: int, q: np.ndarray) -> np.ndarray:
        del q
        size = self._size(step)
        if size is not self._last:
            force = np.zeros(self._shape, order="F")
            force[..., self._places] = np.asarray(size)[..., None]
            force.setflags(write=False)  # it is handed out again
            self._last, self._force = size, force
        return self._force


class _Box:
    """A height during a span of time, and 0 outside; constant between a few steps.

    A step that lies in the span in part has that part of the height.
    """

    def __init__(self, height: Amount, begin: np.ndarray, end: np.ndarray) -> None:
        """A height of shape () or (n,), from `begin` to `end`, shapes () or (n,) [steps]."""
        self._height, self._begin, self._end = height, begin, end
        ends = np.minimum(np.concatenate([np.zeros(1), np.ravel(begin), np.ravel(end)]), NEVER)
        self._edges = np.unique(np.concatenate([np.floor(ends), np.ceil(ends)]).astype(np.int64))
        self._from, self._until, self._size = 0, 0, 0.0

    def __call__(self, step: int) -> Amount:
        if not self._from <= step < self._until:
            place = int(np.searchsorted(self._edges, step, side="right"))
            self._from = int(self._edges[place - 1])
            self._until = int(self._edges[place]) if place < len(self._edges) else NEVER
            ended, begun = (np.clip(x - step, 0.0, 1.0) for x in (self._end, self._begin))
            self._size = entry((ended - begun) * self._height + 0.0)  # 0.0 rather than -0.0
        return self._size
