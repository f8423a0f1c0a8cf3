"""Desired motions: pure functions of time with matched derivatives, and what they want.

Coordinates are on the last axis in the order q = [s1..sN, theta1..thetaN]; batch axes may stand
before it.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from octarm.arrays import read_only
from octarm.errors import OctarmError, quoted
from octarm.interfaces import Motion, Reference

REAL = "fiu"  # NumPy's kinds of real numbers


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Fields:
    """Makes the fields of a motion read-only float arrays; OctarmError if one is not finite."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = read_only(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SetPoint(Fields):
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
class Sine(Fields):
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
    """The sum of several sines, whose centers add up too; OctarmError if there are none."""

    tones: tuple[Sine, ...]

    def __post_init__(self) -> None:
        if not self.tones:
            raise OctarmError("a multi-sine has no tones; it needs at least one")

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        return Reference(*(functools.reduce(np.add, part) for part in self._together(t)))

    @functools.cached_property
    def _together(self) -> Sine:
        """The tones as one, the first axis of whose arrays they are."""
        fields = [(tone.center, tone.amplitude, tone.frequency, tone.phase) for tone in self.tones]
        shape = np.broadcast_shapes(*(np.shape(x) for tone in fields for x in tone))
        center, amplitude, frequency, phase = (
            np.array([np.broadcast_to(x, shape) for x in each])
            for each in zip(*fields, strict=True)
        )
        return Sine(center=center, amplitude=amplitude, frequency=frequency, phase=phase)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SmoothStep(Fields):
    """From start to goal on the minimum-jerk quintic; at rest before and after.

    q_d = start + (goal - start) (10 x^3 - 15 x^4 + 6 x^5) with x = (t - begin) / duration. Its
    velocity and acceleration are continuous and vanish at both ends.

    Attributes:
        start: shape (..., 2N) [m], [rad].
        goal: shape (..., 2N) [m], [rad].
        begin: when the motion begins, broadcasts to (..., 2N) [s].
        duration: how long it takes, broadcasts to (..., 2N) [s]; OctarmError unless positive.
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
class SetPoints(Fields):
    """From place to place on minimum-jerk quintics, at rest in each; see `SmoothStep`.

    Attributes:
        points: the places, the first one being where it begins, shape (K + 1, ..., 2N) [m], [rad].
        begin: when the first motion begins, shape () [s].
        duration: how long each takes, positive, shape () [s].
        pause: rest between two of them, shape () [s].
    """

    points: np.ndarray
    begin: np.ndarray | float = 0.0
    duration: np.ndarray | float = 1.0
    pause: np.ndarray | float = 0.0

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        stride = float(self.duration) + float(self.pause)
        k = min(max(int((t - float(self.begin)) // stride), 0), len(self.points) - 2)
        return self._steps[k](t)

    @functools.cached_property
    def _steps(self) -> list[SmoothStep]:
        stride = float(self.duration) + float(self.pause)
        return [
            SmoothStep(
                start=self.points[k],
                goal=self.points[k + 1],
                begin=float(self.begin) + k * stride,
                duration=self.duration,
            )
            for k in range(len(self.points) - 1)
        ]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Chirp(Fields):
    """A sine whose frequency rises or falls evenly, and then stays: a linear chirp.

    q_d = center + amplitude sin(phi) with phi' = 2 pi (start + (end - start) t / duration) until
    the duration is over, and phi' = 2 pi end from then on.

    Attributes:
        center: shape (..., 2N) [m], [rad].
        amplitude: shape (..., 2N) [m], [rad]; zero for the coordinates that rest.
        start: frequency at the beginning, broadcasts to (..., 2N) [Hz].
        end: frequency from `duration` on, broadcasts to (..., 2N) [Hz].
        duration: how long the frequency changes, positive, shape () [s].
    """

    center: np.ndarray
    amplitude: np.ndarray
    start: np.ndarray | float
    end: np.ndarray | float
    duration: np.ndarray | float

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        T = float(self.duration)
        change = 2.0 * np.pi * (self.end - self.start) / T
        now = min(t, T)
        rate = 2.0 * np.pi * self.start + change * now
        angle = 2.0 * np.pi * self.start * now + 0.5 * change * now * now + rate * (t - now)
        rise = change if t < T else 0.0
        sine, cosine = np.sin(angle), np.cos(angle)
        return Reference(
            self.center + self.amplitude * sine,
            self.amplitude * (rate * cosine),
            self.amplitude * (rise * cosine - rate * rate * sine),
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Spline(Fields):
    """Through given points at given times; at rest before the first and after the last.

    For a motion that is known as samples. The velocity and the acceleration of a spline of degree 5
    are smooth; one of degree 3 has an acceleration that is continuous. Raises OctarmError if a
    field has a wrong shape, or the times do not rise.

    Attributes:
        times: rising, one more of them than the degree at least, shape (K,) [s].
        points: coordinates at these times, shape (K, 2N) [m], [rad].
        degree: 5, or 3, shape ().
    """

    times: np.ndarray
    points: np.ndarray
    degree: np.ndarray | int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        times, points = self.times, self.points
        least = int(self.degree) + 1
        if times.ndim != 1 or len(times) < least or not np.all(np.diff(times) > 0.0):
            raise OctarmError(
                f"times have shape {times.shape}; they must be at least {least}, one after another"
            )
        if points.ndim != 2 or len(points) != len(times):
            raise OctarmError(
                f"points have shape {points.shape}; they must be ({len(times)}, 2N) for as many "
                "times"
            )

    @functools.cached_property
    def _motion(self) -> list[Callable[[float], np.ndarray]]:
        """The way from the first point as a function of time, and its first two derivatives."""
        from scipy.interpolate import make_interp_spline  # which takes half a second

        # From the first point on, so that coordinates that do not move rest without rounding.
        way = self.points - self.points[0]
        path: Any = make_interp_spline(self.times, way, k=int(self.degree))
        return [path.derivative(order) if order else path for order in range(3)]

    def __call__(self, t: float) -> Reference:
        """Desired motion at time t [s]."""
        moving = self.times[0] <= t <= self.times[-1]
        now = min(max(t, float(self.times[0])), float(self.times[-1]))
        q, v, a = (part(now) for part in self._motion)
        q = self.points[0] + q
        return Reference(q, v if moving else 0.0 * v, a if moving else 0.0 * a)


def wanted(motion: Motion, t: float, shape: tuple[int, ...]) -> Reference:
    """What a desired motion, which may be a function of the user's, wants at a time t [s].

    Raises OctarmError unless the answer is a Reference of three arrays of finite numbers that
    broadcast to the shape of the coordinates, (..., 2N).
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
    """Whether an answer for one arm, or for all alike, is right at a glance: it costs 1 us."""
    if type(answer) is not Reference:
        return False
    total = 0.0
    for part in answer:
        if type(part) is not np.ndarray or part.dtype.char != "d" or part.shape != shape[-1:]:
            return False
        total += sum(part.tolist())
    return math.isfinite(total)


def _broadcasts(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether arms may share coordinates of this shape; an arm has all of its coordinates."""
    try:
        return shape[-1:] == wanted[-1:] and np.broadcast_shapes(shape, wanted) == wanted
    except ValueError:
        return False
