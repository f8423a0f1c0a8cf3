"""Forces on the arm: band-limited noise on the joints; sines, pulses and steps on joints or tip."""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from octarm.arm.kinematics import tip_force
from octarm.arrays import coordinate_names
from octarm.disturbances.episode import Episode, Force
from octarm.disturbances.fields import Amount, Quantity, Words
from octarm.disturbances.streams import HeldNoise, in_steps
from octarm.disturbances.waves import Box, Sine
from octarm.errors import OctarmError, closest

_TIP = {"tip-x": (1.0, 0.0), "tip-y": (0.0, 1.0)}  # directions in the base frame

_COORDINATES = Words(
    joined=("s1", "s2", "s3", "theta1", "theta2", "theta3"),
    alone=("all",),
    pattern=r"(s|theta)[1-9]\d*",
)
Size = Annotated[Amount, Quantity("N or N m", usual=(0.0, 5.0))]
Start = Annotated[Amount, Quantity("s", at_least=0.0)]
Length = Annotated[Amount, Quantity("s", above=0.0, unbounded=True)]
Place = Annotated[str, dataclasses.replace(_COORDINATES, alone=("all", *_TIP))]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class BandLimitedNoise(Force):
    """Band-limited white noise on the joints: normal numbers, each held for a while.

    The rms of each coordinate's force is `ratio` times the amplitude of its input signal, see
    `Episode.input_amplitude`, or `rms` itself. The spectrum is flat at first and has lost half of
    its density at 0.443 / correlation_time.

    Attributes:
        ratio: rms over input amplitude, broadcasts to shape (..., 2N) [1].
        correlation_time: how long a number is held, shape (...) [s].
        rms: instead of `ratio`, broadcasts to shape (..., 2N) [N], [N m].
        on: `all`, or coordinates such as `s1+theta2`; no force acts on the others.

    Raises:
        ValueError: if a value is out of range, or not exactly one of ratio and rms is given.
    """

    name: ClassVar[str] = "noise"
    ratio: Annotated[Amount | None, Quantity("1", at_least=0.0, each=True, usual=(0.0, 5.0))] = None
    correlation_time: Annotated[Amount, Quantity("s", above=0.0, key="time")] = 0.01
    rms: Annotated[Amount | None, Quantity("N or N m", at_least=0.0, each=True)] = None
    on: Annotated[str, _COORDINATES] = "all"

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.ratio is None) == (self.rms is None):
            raise OctarmError("noise needs either a ratio or an rms, and not both")

    def start(self, episode: Episode) -> _Noise:
        """The noise of one episode.

        Raises:
            ValueError: if a field does not suit the arm, the correlation time is shorter than a
                physics step, or it is to be a share of an input signal that does not vary.
        """
        time = episode.per_arm("time of noise", self.correlation_time)
        generators = episode.streams(self.name)
        held = HeldNoise(
            generators, episode.coordinates, time, episode.timestep, episode.batch_shape
        )
        return _Noise(held, np.asfortranarray(self._wanted(episode)))

    def _wanted(self, episode: Episode) -> np.ndarray:
        """The rms of each coordinate, shape (..., 2N) [N], [N m]."""
        if self.ratio is None:
            rms = episode.per_coordinate("rms of noise", np.asarray(self.rms))
            return np.where(_mask(self.on, episode), rms, 0.0)
        ratio = episode.per_coordinate("ratio of noise", self.ratio)
        ratio = np.where(_mask(self.on, episode), ratio, 0.0)
        rms = ratio * episode.input_amplitude
        if np.any(np.any(ratio > 0.0, axis=-1) & np.all(rms == 0.0, axis=-1)):
            raise OctarmError(
                "noise is a share of the input signal's amplitude, which is zero for this "
                "reference; give an rms instead"
            )
        return rms


class _Noise:
    """Held normal numbers times their rms.

    Attributes:
        rms: of each coordinate's force, shape (..., 2N) [N], [N m].
    """

    def __init__(self, held: HeldNoise, rms: np.ndarray) -> None:
        self.rms = rms
        self._held = held
        self._normal = self._force = np.empty(0)

    def __call__(self, step: int, q: np.ndarray) -> np.ndarray:
        del q
        normal = self._held(step)
        if normal is not self._normal:
            self._normal, self._force = normal, _kept(self.rms * normal)
        return self._force


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SineForce(Force):
    """A sine, amplitude sin(2 pi frequency (t - at) + phase), from the time `at` on.

    Over a physics step it is what it is at its start.

    Attributes:
        amplitude: shape (...) [N], or [N m] on a bend.
        frequency: shape (...), below half of the physics rate [Hz].
        phase: shape (...) [rad].
        at: when it begins, shape (...) [s].
        length: for how long, may be infinite, shape (...) [s].
        on: coordinates such as `theta1` or `s1+s2`, `all`, or `tip-x`, `tip-y`, a force on the tip
            along an axis of the base frame, x along the hanging arm.

    Raises:
        ValueError: if a value is out of range, or `on` is unknown.
    """

    name: ClassVar[str] = "sine"
    amplitude: Size
    frequency: Annotated[Amount, Quantity("Hz", above=0.0)] = 1.0
    phase: Annotated[Amount, Quantity("rad")] = 0.0
    at: Start = 0.0
    length: Length = np.inf
    on: Place = "theta1"

    def start(self, episode: Episode) -> _Push:
        """The force of one episode.

        Raises:
            ValueError: if a field does not suit the arm, or the physics step is too long for the
                frequency.
        """
        highest, half_rate = float(np.max(self.frequency)), 0.5 / episode.timestep
        if not highest < half_rate:
            raise OctarmError(
                f"frequency of sine is {highest:g} Hz; it must be below half of the physics rate, "
                f"{half_rate:g} Hz"
            )
        box = _box(self, self.length, episode)
        frequency, phase, at = (
            episode.per_arm(f"{name} of sine", getattr(self, name))
            for name in ("frequency", "phase", "at")
        )
        wave = Sine(box, 2.0 * np.pi * frequency, phase, at, episode.timestep)
        return _Push(wave, self.on, episode)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PulseForce(Force):
    """A constant force from the time `at` on, for a while.

    A physics step that it covers in part gets that part of the force, so that the impulse is
    amplitude times length for any timestep.

    Attributes:
        amplitude: shape (...) [N], or [N m] on a bend.
        at: when it begins, shape (...) [s].
        length: for how long, may be infinite, shape (...) [s].
        on: as for `SineForce`.

    Raises:
        ValueError: if a value is out of range, or `on` is unknown.
    """

    name: ClassVar[str] = "pulse"
    amplitude: Size
    at: Start = 0.0
    length: Length = 0.1
    on: Place = "theta1"

    def start(self, episode: Episode) -> _Push:
        """The force of one episode.

        Raises:
            ValueError: if a field does not suit the arm.
        """
        return _Push(_box(self, self.length, episode), self.on, episode)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class StepForce(Force):
    """A constant force from the time `at` on, to the end.

    Attributes:
        amplitude: shape (...) [N], or [N m] on a bend.
        at: when it begins, shape (...) [s].
        on: as for `SineForce`.

    Raises:
        ValueError: if a value is out of range, or `on` is unknown.
    """

    name: ClassVar[str] = "step"
    amplitude: Size
    at: Start = 0.0
    on: Place = "theta1"

    def start(self, episode: Episode) -> _Push:
        """The force of one episode.

        Raises:
            ValueError: if a field does not suit the arm.
        """
        return _Push(_box(self, np.inf, episode), self.on, episode)


class _Push:
    """A force of changing size on coordinates or on the tip."""

    def __init__(self, size: Box | Sine, on: str, episode: Episode) -> None:
        self._size = size
        self._tip = _TIP.get(on)
        self._mask = None if on in _TIP else np.flatnonzero(_mask(on, episode)).tolist()
        self._shape = (*episode.batch_shape, episode.coordinates)
        self._last: Amount | None = None
        self._force = np.empty(0)

    def __call__(self, step: int, q: np.ndarray) -> np.ndarray:
        size = self._size(step)
        if self._tip is not None:
            return tip_force(q, size * self._tip[0], size * self._tip[1])
        if size is not self._last:
            force = np.zeros(self._shape, order="F")
            force[..., self._mask] = np.asarray(size)[..., None]
            self._last, self._force = size, _kept(force)
        return self._force


def _box(force: SineForce | PulseForce | StepForce, length: Amount, episode: Episode) -> Box:
    """The force's amplitude from its beginning on, for a while."""
    amplitude, at, length = (
        episode.per_arm(f"{name} of {force.name}", value)
        for name, value in (("amplitude", force.amplitude), ("at", force.at), ("length", length))
    )
    begin, end = in_steps(at, episode.timestep), in_steps(at + length, episode.timestep)
    return Box(amplitude, begin, end)


def _mask(on: str, episode: Episode) -> np.ndarray:
    """Which coordinates a force acts on, shape (2N,)."""
    known = coordinate_names(episode.parameters.modules)
    wanted = known if on == "all" else on.split("+")
    for name in wanted:
        if name not in known:
            raise OctarmError(f"unknown coordinate {name!r}{closest(name, known)}")
    return np.array([name in wanted for name in known])


def _kept(force: np.ndarray) -> np.ndarray:
    """The same array, read-only, as it is handed out again."""
    force.setflags(write=False)
    return force
