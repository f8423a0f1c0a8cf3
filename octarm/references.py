"""Desired motions: pure functions of time with matched derivatives.

Coordinates are on the last axis in the order q = [s1..sN, theta1..thetaN]; batch axes may stand
before it. `REFERENCES` names the ones that the command line offers; one of your own is given as
MODULE:NAME or FILE.py:NAME, see `octarm.declared`.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from octarm.arrays import read_only
from octarm.declared import Declared
from octarm.errors import OctarmError, quoted
from octarm.interfaces import Motion, Reference

REAL = "fiu"  # NumPy's kinds of real numbers


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class _Fields:
    """Makes the fields of a motion read-only float arrays.

    Raises:
        OctarmError: if a field is not finite.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = read_only(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SetPoint(_Fields):
    """Rest at one place: q_d = q.

    Attributes:
        q: shape (..., 2N) [m], [rad].
    """

    q: np.ndarray

    def __call__(self, t: float) -> Reference:
        """The same at every time t [s]."""
        del t
        rest = np.zeros_like(self.q)
        return Reference(self.q, rest, rest)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Sine(_Fields):
    """q_d = center + amplitude sin(2 pi frequency t + phase), coordinate by coordinate.

    Attributes:
        center: shape (..., 2N) [m], [rad].
        amplitude: shape (..., 2N) [m], [rad]; zero for the coordinates that rest.
        frequency: broadcasts to (..., 2N) [Hz].
        phase: broadcasts to (..., 2N) [rad].
    """

    center: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray | float
    phase: np.ndarray | float = 0.0

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        omega, speed, stiffness = self._factors
        angle = omega * t + self.phase
        sine = self.amplitude * np.sin(angle)
        return Reference(self.center + sine, speed * np.cos(angle), stiffness * sine)

    @functools.cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """omega, amplitude omega and -omega^2."""
        omega = 2.0 * np.pi * np.asarray(self.frequency)
        return omega, self.amplitude * omega, np.asarray(-omega * omega)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class MultiSine:
    """The sum of several sines.

    Attributes:
        tones: at least one; their centers add up too.

    Raises:
        OctarmError: if there are none.
    """

    tones: tuple[Sine, ...]

    def __post_init__(self) -> None:
        if not self.tones:
            raise OctarmError("a multi-sine has no tones; it needs at least one")

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        total = self.tones[0](t)
        for tone in self.tones[1:]:
            part = tone(t)
            total = Reference(total.q + part.q, total.v + part.v, total.a + part.a)
        return total


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SmoothStep(_Fields):
    """From start to goal on the minimum-jerk quintic; at rest before and after.

    q_d = start + (goal - start) (10 x^3 - 15 x^4 + 6 x^5) with x = (t - begin) / duration. Its
    velocity and acceleration are continuous and vanish at both ends.

    Attributes:
        start: shape (..., 2N) [m], [rad].
        goal: shape (..., 2N) [m], [rad].
        begin: when the motion begins, broadcasts to (..., 2N) [s].
        duration: how long it takes, positive, broadcasts to (..., 2N) [s].

    Raises:
        OctarmError: if the duration is not positive.
    """

    start: np.ndarray
    goal: np.ndarray
    begin: np.ndarray | float = 0.0
    duration: np.ndarray | float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all(np.asarray(self.duration) > 0.0):
            raise OctarmError(f"duration is {self.duration} s; a step takes a positive time")

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        T = self.duration
        x = np.clip((t - self.begin) / T, 0.0, 1.0)
        way = self.goal - self.start
        return Reference(
            self.start + way * (x * x * x * (10.0 + x * (-15.0 + 6.0 * x))),
            way * (30.0 * x * x * (1.0 - x) * (1.0 - x)) / T,
            way * (60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)) / (T * T),
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Spline(_Fields):
    """Through given points at given times; at rest before the first and after the last.

    A spline of degree 5, whose velocity and acceleration are smooth: for a motion that is known as
    samples, such as the inverse kinematics of a path of the tip.

    Attributes:
        times: rising, at least 6 of them, shape (K,) [s].
        points: coordinates at these times, shape (K, 2N) [m], [rad].

    Raises:
        OctarmError: if a field has a wrong shape, or the times do not rise.
    """

    times: np.ndarray
    points: np.ndarray

    def __post_init__(self) -> None:
        super().__post_init__()
        times, points = self.times, self.points
        if times.ndim != 1 or len(times) < 6 or not np.all(np.diff(times) > 0.0):
            raise OctarmError(
                f"times have shape {times.shape}; they must be at least 6, one after another"
            )
        if points.ndim != 2 or len(points) != len(times):
            raise OctarmError(
                f"points have shape {points.shape}; they must be ({len(times)}, 2N) for as many "
                "times"
            )

    @functools.cached_property
    def _motion(self) -> list[Callable[[float], np.ndarray]]:
        """The coordinates as a function of time, and its first two derivatives."""
        from scipy.interpolate import make_interp_spline  # which takes half a second

        path: Any = make_interp_spline(self.times, self.points, k=5)
        return [path.derivative(order) if order else path for order in range(3)]

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        moving = self.times[0] <= t <= self.times[-1]
        now = min(max(t, float(self.times[0])), float(self.times[-1]))
        q, v, a = (part(now) for part in self._motion)
        return Reference(q, v if moving else 0.0 * v, a if moving else 0.0 * a)


def _paper_sine(rest: np.ndarray) -> Sine:
    """The paper's sine on the first two joints, read as theta1 and theta2."""
    return Sine(center=rest, amplitude=_first_two(rest, bends=(0.35, 0.25)), frequency=0.5)


def _slide_sine(rest: np.ndarray) -> Sine:
    """The literal reading of "first two links": the sine on s1 and s2."""
    return Sine(center=rest, amplitude=_first_two(rest, slides=(0.02, 0.015)), frequency=0.5)


def _multi_sine(rest: np.ndarray) -> MultiSine:
    """Three incommensurate tones on the first two modules, slides and bends."""
    big = _first_two(rest, slides=(0.008, 0.006), bends=(0.20, 0.15))
    tones = ((rest, 1.0, 0.3, 0.0), (0.0 * rest, 0.5, 0.3 * 2**0.5, 1.0),
             (0.0 * rest, 0.25, 0.3 * 5**0.5, 2.0))  # fmt: skip
    return MultiSine(
        tones=tuple(
            Sine(center=center, amplitude=share * big, frequency=frequency, phase=phase)
            for center, share, frequency, phase in tones
        )
    )


def _fast_sine(rest: np.ndarray) -> MultiSine:
    """Two tones near the lowest mode of the nominal arm, large: inertia counts in all coordinates.

    Inertial and Coriolis forces are more than 20 % of each coordinate's Q there, in rms.
    """
    big = _first_two(rest, slides=(0.015, 0.012), bends=(0.6, 0.5))
    return MultiSine(
        tones=(
            Sine(center=rest, amplitude=big, frequency=1.6),
            Sine(center=0.0 * rest, amplitude=0.5 * big, frequency=1.6 * 2**0.5, phase=1.0),
        )
    )


def _smooth_step(rest: np.ndarray) -> SmoothStep:
    """From rest to a bent and stretched pose within 1 s, beginning at 0.5 s."""
    goal = rest + _first_two(rest, slides=(0.01, 0.01), bends=(0.35, 0.25))
    return SmoothStep(start=rest, goal=goal, begin=0.5, duration=1.0)


def _set_point(rest: np.ndarray) -> SetPoint:
    """A bent pose at once, from rest: a step response."""
    return SetPoint(q=rest + _first_two(rest, bends=(0.2, 0.15)))


def _lacks(thing: Any) -> str:
    """What an object of a user lacks of a reference; empty if nothing."""
    try:
        inspect.signature(thing).bind(np.zeros(2))
    except (TypeError, ValueError):
        return (
            "cannot be called with one array, the pose at rest of shape (..., 2N), to return a "
            "motion as octarm.interfaces.Motion says"
        )
    return ""


# What makes a motion, given the pose `rest` about which it goes, shape (..., 2N) [m], [rad].
_BUILT_IN: dict[str, Callable[[np.ndarray], Motion]] = {
    "sine": _paper_sine,
    "sine-slides": _slide_sine,
    "multi-sine": _multi_sine,
    "fast-sine": _fast_sine,
    "smooth-step": _smooth_step,
    "set-point": _set_point,
}
REFERENCES = Declared("reference", _BUILT_IN, _lacks)


def wanted(motion: Motion, t: float, shape: tuple[int, ...]) -> Reference:
    """What a desired motion wants, which may be a function of the user's.

    Args:
        motion: the desired motion.
        t: the time [s].
        shape: of the coordinates, (..., 2N), to which the answer must broadcast.

    Raises:
        OctarmError: unless the answer is a Reference of three arrays of finite numbers.
    """
    answer: Any = motion(t)
    if _plainly_right(answer, shape):
        return answer
    if type(answer) is not Reference:
        raise OctarmError(
            f"the reference answers {quoted(answer)} at t = {t:g} s; it must be a Reference of "
            "arrays q, v and a"
        )
    for name, part in zip(("q", "v", "a"), answer, strict=True):
        if type(part) is not np.ndarray or part.dtype.kind not in REAL:
            wrong = f"is {quoted(part)}; it must be an array of real numbers"
        elif part.shape != shape and not _broadcasts(part.shape, shape):
            wrong = f"has shape {part.shape}; it must be {shape}"
        elif not np.isfinite(part).all():
            wrong = f"holds {part[~np.isfinite(part)].flat[0]:g}; it must be finite"
        else:
            continue
        raise OctarmError(f"the reference's {name} at t = {t:g} s {wrong}")
    return answer


def _plainly_right(answer: Any, shape: tuple[int, ...]) -> bool:
    """Whether an answer for one arm is right at a glance, which costs a microsecond."""
    if type(answer) is not Reference or len(shape) != 1:
        return False
    total = 0.0
    for part in answer:
        if type(part) is not np.ndarray or part.dtype.char != "d" or part.shape != shape:
            return False
        total += sum(part.tolist())
    return math.isfinite(total)


def _broadcasts(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether arms may share coordinates of this shape; an arm has all of its coordinates."""
    arms = zip(reversed(shape[:-1]), reversed(wanted[:-1]), strict=False)
    return (
        shape[-1:] == wanted[-1:]
        and len(shape) <= len(wanted)
        and all(n in (1, m) for n, m in arms)
    )


def named_reference(name: str, rest: np.ndarray) -> Motion:
    """A reference by name, MODULE:NAME or FILE.py:NAME, about the pose `rest`.

    The pose has shape (..., 2N) [m], [rad].

    Raises:
        OctarmError: for an unknown name, with the known ones, or if what it names makes no motion.
    """
    motion: Any = REFERENCES[name](rest)
    if not callable(motion):
        raise OctarmError(
            f"the reference {quoted(name)} makes {quoted(motion)}; it must make a function of "
            "time, as octarm.interfaces.Motion says"
        )
    return cast(Motion, motion)


def _first_two(
    rest: np.ndarray, slides: tuple[float, ...] = (), bends: tuple[float, ...] = ()
) -> np.ndarray:
    """Values for the first modules of an arm, zero elsewhere, shape (..., 2N)."""
    n = rest.shape[-1] // 2
    out = np.zeros_like(rest)
    out[..., : len(slides[:n])] = slides[:n]
    out[..., n : n + len(bends[:n])] = bends[:n]
    return out
