"""Sensors that are late, noisy or coarse.

What the arm really does passes through them to the controller. Noise and resolution are given as
shares of one scale a coordinate: the rest length of the module on slides, 1 rad on bends. A
velocity is taken as derived from the coordinate by a filter of bandwidth `rate` [1/s], so its
noise and resolution are `rate` times those of the coordinate.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, ClassVar

import numpy as np

from octarm.disturbances.actuators import Delay
from octarm.disturbances.delivered import Measured
from octarm.disturbances.episode import Episode, SensorFault, SensorProcess
from octarm.disturbances.streams import DelayLine, HeldNoise
from octarm.fields import Amount, Quantity

Share = Annotated[Amount, Quantity("1", at_least=0.0, plausible=2.0, each=True, usual=(0.0, 0.05))]
Rate = Annotated[Amount, Quantity("1/s", at_least=0.0)]

_FINEST = 1e-18  # [m], [rad] and per second: steps finer than this are beyond a float anyway


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementDelay(Delay, SensorFault):
    """Readings that show the arm as it was a while ago; at first, as it was at the start.

    It reads the true motion, so it has to be the first of several sensor faults. Between two
    physics steps q is the cubic that has their coordinates and velocities, and v is its rate.
    """

    name: ClassVar[str] = "measurement-delay"
    instead_of_two: ClassVar[str] = "give the sum of both delays"

    def start(self, episode: Episode) -> _LateReadings:
        return _LateReadings(episode.value(self, "delay"), episode.timestep, episode.batch_shape)


class _LateReadings(DelayLine):
    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        self.put(step, q, v)

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        del q, v
        then = step - self.steps
        then_q, then_v = self.take(np.maximum(then, 0))
        if not self.fractions:
            return then_q, then_v
        before_q, before_v = self.take(np.maximum(then - 1, 0))
        between = ((self.rest > 0.0) & (then > 0))[..., None]
        late_q, late_v = _cubic(
            1.0 - self.rest[..., None], self.timestep, before_q, before_v, then_q, then_v
        )
        return np.where(between, late_q, then_q), np.where(between, late_v, then_v)


def _cubic(
    x: np.ndarray, h: float, q: np.ndarray, v: np.ndarray, q_end: np.ndarray, v_end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """q and its rate at a share x of the way through a time h [s], from those at both ends."""
    y, way = 1.0 - x, q_end - q
    late_q = q + x * x * (3.0 - 2.0 * x) * way + h * (x * y) * (y * v - x * v_end)
    late_v = 6.0 * (x * y) * (way / h) + y * (1.0 - 3.0 * x) * v + x * (3.0 * x - 2.0) * v_end
    return late_q, late_v


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementNoise(SensorFault):
    """Normal numbers on the readings, a share of the rest length or of 1 rad, held for a while.

    All coordinates and velocities have their own, independent of one another.
    The realisation belongs to the arm's random stream and to time, see `HeldNoise`: it does not
    depend on when, or how often, the arm is measured. `rms` is that of the coordinates, and `rate`
    that of the velocities over it.
    """

    name: ClassVar[str] = "measurement-noise"
    rms: Share
    rate: Rate = 100.0
    correlation_time: Annotated[Amount, Quantity("s", above=0.0, key="time")] = 0.001

    def start(self, episode: Episode) -> _Noise:
        scales = np.concatenate(_scaled(self, "rms", episode), axis=-1)
        return _Noise(episode.noise(self, scales))

    def delivered(self, measured: Measured) -> dict[str, Any]:
        """The rms that was asked for, of q and then of v, and how much the readings changed."""
        asked = {"rms_asked": np.concatenate(_scaled(self, "rms", measured.episode))}
        return asked | measured.signal.sizes()


class _Noise(SensorProcess):
    def __init__(self, held: HeldNoise) -> None:
        self._held = held
        self.rms_q, self.rms_v = np.split(held.scale, 2, axis=-1)

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        on_q, on_v = np.split(self._held(step), 2, axis=-1)
        return np.where(self.rms_q > 0.0, q + on_q, q), np.where(self.rms_v > 0.0, v + on_v, v)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Quantisation(SensorFault):
    """Readings rounded to the nearest multiple of a share of the rest length or of 1 rad.

    `rate` is the resolution of the velocities over that of the coordinates: that of an encoder
    whose counts are differenced over a time h is 1/h, and 0 leaves velocities exact.
    """

    name: ClassVar[str] = "quantisation"
    resolution: Share
    rate: Rate = 100.0

    def start(self, episode: Episode) -> _Rounding:
        return _Rounding(*_scaled(self, "resolution", episode))


class _Rounding(SensorProcess):
    def __init__(self, step_q: np.ndarray, step_v: np.ndarray) -> None:
        self.step_q, self.step_v = (np.where(x > _FINEST, x, 0.0) for x in (step_q, step_v))

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        del step
        return _rounded(q, self.step_q), _rounded(v, self.step_v)


def _scaled(
    fault: MeasurementNoise | Quantisation, field: str, episode: Episode
) -> tuple[np.ndarray, np.ndarray]:
    """What a share of the scale is on q and on v, shapes (..., 2N), contiguous along the arms."""
    on_q = episode.value(fault, field) * episode.model.scale
    on_v = on_q * np.asarray(episode.value(fault, "rate"))[..., None]
    return np.asfortranarray(on_q), np.asfortranarray(on_v)


def _rounded(x: np.ndarray, step: np.ndarray) -> np.ndarray:
    active = step > 0.0
    return np.where(active, np.rint(x / np.where(active, step, 1.0)) * step, x)
