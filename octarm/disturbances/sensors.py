"""Sensors that are late, noisy or coarse.

What the arm really does passes through them to the controller. Noise and resolution are given as
shares of one scale a coordinate: the rest length of the module on slides, 1 rad on bends. A
velocity is taken as derived from the coordinate by a filter of bandwidth `rate` [1/s], so its
noise and resolution are `rate` times those of the coordinate.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from octarm.disturbances.delays import DelayLine
from octarm.disturbances.episode import Episode, SensorFault
from octarm.disturbances.fields import Amount, Quantity
from octarm.disturbances.streams import HeldNoise

Rate = Annotated[Amount, Quantity("1/s", at_least=0.0)]

_FINEST = 1e-18  # [m], [rad] and per second: steps finer than this are beyond a float anyway


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementDelay(SensorFault):
    """Readings that show the arm as it was a while ago; at first, as it was at the start.

    It reads the true motion, so it has to be the first of several sensor faults.

    Attributes:
        delay: rounded to whole physics steps, which need not be whole control periods, shape (...)
            [s].
    """

    name: ClassVar[str] = "measurement-delay"
    delay: Annotated[Amount, Quantity("s", at_least=0.0, at_most=10.0, usual=(0.0, 0.05))]

    def start(self, episode: Episode) -> _MeasurementDelay:
        """The delay in one episode; its attribute `delay` is what it really is.

        Raises:
            ValueError: if the delay does not suit the batch.
        """
        return _MeasurementDelay(DelayLine("delay of measurement-delay", self.delay, episode))


class _MeasurementDelay:
    """The motion of a while ago.

    Attributes:
        delay: of each arm, whole physics steps, shape (...) [s].
    """

    def __init__(self, line: DelayLine) -> None:
        self.delay, self._line = line.delay, line

    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        self._line.put(step, q, v)

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        del q, v
        then_q, then_v = self._line.take(np.maximum(step - self._line.steps, 0))
        return then_q, then_v


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementNoise(SensorFault):
    """Normal numbers on the readings, a share of the rest length or of 1 rad, held for a while.

    All coordinates and velocities have their own, independent of one another.
    The realisation belongs to the arm's random stream and to time, see `HeldNoise`: it does not
    depend on when, or how often, the arm is measured.

    Attributes:
        rms: of the coordinates, a share of the scale, broadcasts to shape (..., 2N) [1].
        rate: rms of the velocities over that of the coordinates, shape (...) [1/s].
        correlation_time: how long a number is held, shape (...) [s].
    """

    name: ClassVar[str] = "measurement-noise"
    rms: Annotated[Amount, Quantity("1", at_least=0.0, each=True, usual=(0.0, 0.05))]
    rate: Rate = 100.0
    correlation_time: Annotated[Amount, Quantity("s", above=0.0, key="time")] = 0.001

    def start(self, episode: Episode) -> _MeasurementNoise:
        """The noise of one episode; `rms_q` and `rms_v` are its rms in SI units.

        Raises:
            ValueError: if a field does not suit the arm, or the correlation time is shorter than a
                physics step.
        """
        rms_q, rms_v = _scaled("rms", self.rms, self.rate, self.name, episode)
        time = episode.per_arm("time of measurement-noise", self.correlation_time)
        held = HeldNoise(
            episode.streams(self.name),
            2 * episode.coordinates,
            time,
            episode.timestep,
            episode.batch_shape,
        )
        return _MeasurementNoise(held, rms_q, rms_v)


class _MeasurementNoise:
    """Held numbers times a scale, the first half of them on q and the second on v.

    Attributes:
        rms_q: of the coordinates, shape (..., 2N) [m], [rad].
        rms_v: of the velocities, shape (..., 2N) [m/s], [rad/s].
    """

    def __init__(self, held: HeldNoise, rms_q: np.ndarray, rms_v: np.ndarray) -> None:
        self.rms_q, self.rms_v = rms_q, rms_v
        self._held = held
        self._normal = self._on_q = self._on_v = np.empty(0)

    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        """Nothing is remembered."""

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal, n = self._held(step), q.shape[-1]
        if normal is not self._normal:
            self._normal = normal
            self._on_q, self._on_v = self.rms_q * normal[..., :n], self.rms_v * normal[..., n:]
        return (
            np.where(self.rms_q > 0.0, q + self._on_q, q),
            np.where(self.rms_v > 0.0, v + self._on_v, v),
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Quantisation(SensorFault):
    """Readings rounded to the nearest multiple of a share of the rest length or of 1 rad.

    Attributes:
        resolution: of the coordinates, a share of the scale, broadcasts to shape (..., 2N) [1].
        rate: resolution of the velocities over that of the coordinates, shape (...) [1/s]; that of
            an encoder whose counts are differenced over a time h is 1/h, and 0 leaves them exact.
    """

    name: ClassVar[str] = "quantisation"
    resolution: Annotated[Amount, Quantity("1", at_least=0.0, each=True, usual=(0.0, 0.05))]
    rate: Rate = 100.0

    def start(self, episode: Episode) -> _Quantisation:
        """The rounding in one episode; `step_q` and `step_v` are its steps in SI units.

        Raises:
            ValueError: if a field does not suit the arm.
        """
        return _Quantisation(*_scaled("resolution", self.resolution, self.rate, self.name, episode))


class _Quantisation:
    """Rounding to nearest.

    Attributes:
        step_q: of the coordinates, shape (..., 2N) [m], [rad].
        step_v: of the velocities, shape (..., 2N) [m/s], [rad/s].
    """

    def __init__(self, step_q: np.ndarray, step_v: np.ndarray) -> None:
        self.step_q, self.step_v = (np.where(x > _FINEST, x, 0.0) for x in (step_q, step_v))

    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        """Nothing is remembered."""

    def __call__(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        del step
        return _rounded(q, self.step_q), _rounded(v, self.step_v)


def _scaled(
    name: str, share: Amount, rate: Amount, of: str, episode: Episode
) -> tuple[np.ndarray, np.ndarray]:
    """What a share of the scale is on q and on v, shapes (..., 2N), contiguous along the arms."""
    rest = episode.parameters.rest_length
    scale = np.concatenate([rest, np.ones_like(rest)], axis=-1)
    on_q = episode.per_coordinate(f"{name} of {of}", share) * scale
    on_v = on_q * np.asarray(episode.per_arm(f"rate of {of}", rate))[..., None]
    return np.asfortranarray(on_q), np.asfortranarray(on_v)


def _rounded(x: np.ndarray, step: np.ndarray) -> np.ndarray:
    active = step > 0.0
    return np.where(active, np.rint(x / np.where(active, step, 1.0)) * step, x)
