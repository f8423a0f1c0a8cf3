"""The references that have a name: each suits its arm, unless its numbers are given.

Where a size is not given, it is the nominal arm's times what `Hanging` says of the arm. One that is
given is that of the first coordinate that moves; the others keep their proportion to it.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from octarm.arm.lagrange import equilibrium, stiffness_matrix
from octarm.arm.modes import rates
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import reach
from octarm.errors import OctarmError
from octarm.fields import Quantity
from octarm.interfaces import Motion
from octarm.references.motions import Chirp, MultiSine, SetPoint, SetPoints, Sine, SmoothStep

BEND = Quantity("rad", at_least=-np.pi, at_most=np.pi)
BENDS = dataclasses.replace(BEND, each=True)
SLIDE = Quantity("m", at_least=-1.0, at_most=1.0)
FREQUENCY = Quantity("Hz", above=0.0, at_most=100.0)
TIME = Quantity("s", above=0.0, at_most=3600.0)
LATER = Quantity("s", at_least=0.0, at_most=3600.0)
Sizes = Mapping[str, float | np.ndarray]

# Amplitudes, lengths and frequencies are declared for arms like the nominal one: modules of 120 mm
# that can be held at twice these sizes, and whose lowest mode is no slower.
_NOMINAL_BEND = 1.0  # [rad]
_NOMINAL_SLIDE, _STRAIN = 0.06, 0.5  # [m], of a rest length [1]
_LOWEST = 2.4  # [Hz]


class Hanging(NamedTuple):
    """An arm, or arms side by side, as references begin with it.

    Attributes:
        rest: the pose in which it hangs, shape (..., 2N) [m], [rad].
        arm: its parameters, with the batch axes of `rest` or none; when None, all sizes are those
            of the nominal arm.
    """

    rest: np.ndarray
    arm: ArmParameters | None = None

    @property
    def modules(self) -> int:
        """Number of modules N."""
        return self.rest.shape[-1] // 2

    def bend(self) -> np.ndarray:
        """The size of bends, relative to the nominal arm's, shape () or (..., 1) [1].

        Half of the bend at which all modules can be held alike, and 1 rad at most.
        """
        held = self._each(lambda arm: np.min(np.abs(reach(arm).alike)))
        return np.minimum(1.0, held / (2.0 * _NOMINAL_BEND))

    def slide(self) -> np.ndarray:
        """The size of each slide, relative to the nominal arm's, shape () or (..., N) [1].

        Half of what its inputs stretch a module by, and half of its rest length at most.
        """
        if self.arm is None:
            return np.ones(())
        strain = np.minimum(_STRAIN, 0.5 * self._each(_held_strain))
        return self.arm.rest_length * strain / _NOMINAL_SLIDE

    def pace(self) -> np.ndarray:
        """The size of frequencies near the lowest mode, shape () or (..., 1) [1]; 1 at most."""
        slowest = self._each(lambda arm: np.min(np.abs(rates(arm, equilibrium(arm)))))
        return np.minimum(1.0, slowest / (2.0 * np.pi) / _LOWEST)

    def parameters(self) -> ArmParameters:
        """Those of one arm, the nominal ones when none are given; OctarmError for other arms."""
        from octarm.arm.mjcf import nominal_parameters  # which imports MuJoCo

        arm = nominal_parameters() if self.arm is None else self.arm
        if arm.batch_shape or self.rest.shape != (arm.coordinates,):
            raise OctarmError(
                f"the pose at rest has shape {self.rest.shape}; a path of the tip needs one arm, "
                "or several that are alike, and its parameters"
            )
        return arm

    def _each(self, function: Callable[[ArmParameters], Any]) -> np.ndarray:
        """A function of each arm, shape (), or (..., k); infinity without parameters."""
        if self.arm is None:
            return np.array(np.inf)
        if not self.arm.batch_shape:
            return np.asarray(function(self.arm))
        rows = [np.atleast_1d(function(self.arm.arm(i))) for i in range(len(self.rest))]
        return np.stack(rows)


def _held_strain(arm: ArmParameters) -> np.ndarray:
    """By how much both columns of each module stretch or shorten it, shape (N,) [1]."""
    force = np.max(np.abs(arm.input_bounds(())), axis=0).reshape(-1, 2).sum(axis=-1)
    axial = np.diagonal(stiffness_matrix(arm))[: arm.modules]
    return force / (axial * arm.rest_length)


@dataclasses.dataclass(frozen=True, kw_only=True)
class NamedReference(abc.ABC):
    """A desired motion that is yet to begin, whose fields declare what they may be.

    Attributes:
        nominal: what fields are on the nominal arm that suit the arm when they are None.
    """

    nominal: ClassVar[Sizes] = {}

    @abc.abstractmethod
    def start(self, arm: Hanging) -> Motion:
        """The motion about the pose in which an arm hangs; OctarmError if it cannot do that."""


def poses(
    arm: Hanging,
    *,
    bends: Sequence[float] = (),
    slides: Sequence[float] = (),
    bend: float | None = None,
    slide: float | None = None,
) -> np.ndarray:
    """How far the first modules move from rest, shape (..., 2N) [m], [rad].

    By bends [rad] and slides [m] of the nominal arm, from the first module on, with the bend and
    slide of the first module that are given, or that suit the arm when None.
    """
    out, n = np.zeros_like(arm.rest, dtype=np.float64), arm.modules
    if bends:
        size = arm.bend() if bend is None else np.asarray(bend / bends[0])
        out[..., n : n + len(bends[:n])] = np.array(bends[:n]) * size
    if slides:
        size = arm.slide() if slide is None else np.asarray(slide / slides[0])
        k = len(slides[:n])
        out[..., :k] = np.array(slides[:n]) * (size[..., :k] if size.ndim else size)
    return out


@dataclasses.dataclass(frozen=True, kw_only=True)
class BendSine(NamedReference):
    """Sine of theta1 and, 5/7 as large, of theta2: the paper's first two joints."""

    nominal: ClassVar[Sizes] = {"amplitude": 0.35}
    amplitude: Annotated[float | None, BEND] = None
    frequency: Annotated[float, FREQUENCY] = 0.5

    def start(self, arm: Hanging) -> Sine:
        amplitude = poses(arm, bends=(0.35, 0.25), bend=self.amplitude)
        return Sine(center=arm.rest, amplitude=amplitude, frequency=self.frequency)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SlideSine(NamedReference):
    """Sine of s1 and, 3/4 as large, of s2: the literal reading of "first two links"."""

    nominal: ClassVar[Sizes] = {"amplitude": 0.02}
    amplitude: Annotated[float | None, SLIDE] = None
    frequency: Annotated[float, FREQUENCY] = 0.5

    def start(self, arm: Hanging) -> Sine:
        amplitude = poses(arm, slides=(0.02, 0.015), slide=self.amplitude)
        return Sine(center=arm.rest, amplitude=amplitude, frequency=self.frequency)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ThreeTones(NamedReference):
    """Three tones of theta1, theta2, s1 and s2, at 1, sqrt(2) and sqrt(5) times the frequency."""

    nominal: ClassVar[Sizes] = {"amplitude": 0.2, "slide": 0.008}
    amplitude: Annotated[float | None, BEND] = None
    slide: Annotated[float | None, SLIDE] = None
    frequency: Annotated[float, FREQUENCY] = 0.3

    def start(self, arm: Hanging) -> MultiSine:
        big = poses(
            arm, bends=(0.20, 0.15), slides=(0.008, 0.006), bend=self.amplitude, slide=self.slide
        )
        tones = (1.0, 1.0, 0.0), (0.5, 2**0.5, 1.0), (0.25, 5**0.5, 2.0)
        return _together(arm, big, self.frequency, tones)


def _together(
    arm: Hanging,
    amplitude: np.ndarray,
    frequency: float | np.ndarray,
    tones: Sequence[tuple[float, float, float]],
) -> MultiSine:
    """Tones about rest, with shares of an amplitude, multiples of a frequency, and phases [rad]."""
    sines: list[Sine] = []
    for share, ratio, phase in tones:
        center = 0.0 * arm.rest if sines else arm.rest
        part, rate = share * amplitude, frequency * ratio
        sines.append(Sine(center=center, amplitude=part, frequency=rate, phase=phase))
    return MultiSine(tones=tuple(sines))


@dataclasses.dataclass(frozen=True, kw_only=True)
class FastSine(NamedReference):
    """Two large tones of theta1, theta2, s1 and s2, sqrt(2) apart, near the lowest mode.

    Inertial and Coriolis forces are more than 20 % of each coordinate's Q there, in rms, on the
    nominal arm.
    """

    nominal: ClassVar[Sizes] = {"amplitude": 0.6, "slide": 0.015, "frequency": 1.6}
    amplitude: Annotated[float | None, BEND] = None
    slide: Annotated[float | None, SLIDE] = None
    frequency: Annotated[float | None, FREQUENCY] = None

    def start(self, arm: Hanging) -> MultiSine:
        big = poses(
            arm, bends=(0.6, 0.5), slides=(0.015, 0.012), bend=self.amplitude, slide=self.slide
        )
        frequency = 1.6 * arm.pace() if self.frequency is None else self.frequency
        return _together(arm, big, frequency, [(1.0, 1.0, 0.0), (0.5, 2**0.5, 1.0)])


@dataclasses.dataclass(frozen=True, kw_only=True)
class Step(NamedReference):
    """From rest to a bent and stretched pose on a minimum-jerk quintic, and rest there."""

    nominal: ClassVar[Sizes] = {"amplitude": 0.35, "slide": 0.01}
    amplitude: Annotated[float | None, BEND] = None
    slide: Annotated[float | None, SLIDE] = None
    begin: Annotated[float, LATER] = 0.5
    duration: Annotated[float, TIME] = 1.0

    def start(self, arm: Hanging) -> SmoothStep:
        way = poses(
            arm, bends=(0.35, 0.25), slides=(0.01, 0.01), bend=self.amplitude, slide=self.slide
        )
        goal = arm.rest + way
        return SmoothStep(start=arm.rest, goal=goal, begin=self.begin, duration=self.duration)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Jump(NamedReference):
    """A bent pose at once, from rest: a step response."""

    nominal: ClassVar[Sizes] = {"amplitude": 0.2}
    amplitude: Annotated[float | None, BEND] = None

    def start(self, arm: Hanging) -> SetPoint:
        return SetPoint(q=arm.rest + poses(arm, bends=(0.2, 0.15), bend=self.amplitude))


@dataclasses.dataclass(frozen=True, kw_only=True)
class RisingSine(NamedReference):
    """Chirp of theta1 and theta2, whose frequency changes evenly and then stays."""

    nominal: ClassVar[Sizes] = {"amplitude": 0.35, "start_frequency": 0.1, "end_frequency": 1.6}
    amplitude: Annotated[float | None, BEND] = None
    start_frequency: Annotated[float | None, dataclasses.replace(FREQUENCY, key="from")] = None
    end_frequency: Annotated[float | None, dataclasses.replace(FREQUENCY, key="to")] = None
    duration: Annotated[float, TIME] = 8.0

    def start(self, arm: Hanging) -> Chirp:
        first, last = self.start_frequency, self.end_frequency
        return Chirp(
            center=arm.rest,
            amplitude=poses(arm, bends=(0.35, 0.25), bend=self.amplitude),
            start=0.1 * arm.pace() if first is None else first,
            end=1.6 * arm.pace() if last is None else last,
            duration=self.duration,
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class MinimumJerk(NamedReference):
    """Set-points of theta1, and 5/7 of them of theta2, from rest to rest on minimum-jerk quintics.

    The points are separated by `/` in a spelling; duration and pause are those of each.
    """

    nominal: ClassVar[Sizes] = {"points": np.array([0.35, -0.35, 0.0])}
    points: Annotated[float | np.ndarray | None, BENDS] = None
    begin: Annotated[float, LATER] = 0.5
    duration: Annotated[float, TIME] = 1.0
    pause: Annotated[float, LATER] = 0.5

    def start(self, arm: Hanging) -> SetPoints:
        ways = [np.zeros_like(arm.rest)]
        if self.points is None:
            ways += [factor * poses(arm, bends=(0.35, 0.25)) for factor in (1.0, -1.0, 0.0)]
        else:
            given = np.atleast_1d(self.points).tolist()
            ways += [poses(arm, bends=(0.35, 0.25), bend=point) for point in given]
        return SetPoints(
            points=arm.rest + np.stack(ways),
            begin=self.begin,
            duration=self.duration,
            pause=self.pause,
        )
