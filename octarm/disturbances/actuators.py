"""Actuators that are weak, sticky, limited, slow or late.

What is asked passes through them to the plant: input forces tau, shape (..., 2N) [N], in the
column order of eq (2). No input acts before the start of an episode. Every process is called once
a physics step, so that nothing depends on the control period.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from octarm.disturbances.delays import DelayLine
from octarm.disturbances.episode import ActuatorFault, Episode
from octarm.disturbances.fields import Amount, Quantity
from octarm.disturbances.streams import first_step


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LossOfEffectiveness(ActuatorFault):
    """Columns that lose a share of their force: (1 - share) tau from the time `at` on.

    Attributes:
        share: lost, broadcasts to shape (..., 2N), one value a column [1].
        at: when it is lost, shape (...) [s].
    """

    name: ClassVar[str] = "loss"
    share: Annotated[Amount, Quantity("1", at_least=0.0, at_most=1.0, each=True, usual=(0.0, 1.0))]
    at: Annotated[Amount, Quantity("s", at_least=0.0, at_most=1e9)] = 0.0

    def start(self, episode: Episode) -> _Loss:
        """The loss in one episode.

        Raises:
            ValueError: if a field does not suit the arm.
        """
        onset = first_step(episode.per_arm("at of loss", self.at), episode.timestep)
        return _Loss(1.0 - _columns("share of loss", self.share, episode), onset[..., None])


class _Loss:
    def __init__(self, kept: np.ndarray, onset: np.ndarray) -> None:
        self._kept, self._onset = kept, onset

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        return tau * np.where(self._onset <= step, self._kept, 1.0)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class DeadZone(ActuatorFault):
    """No force below the width, and that much less beyond it: tau - clip(tau, +-width).

    Attributes:
        width: largest |tau| without effect, broadcasts to shape (..., 2N) [N].
    """

    name: ClassVar[str] = "dead-zone"
    width: Annotated[Amount, Quantity("N", at_least=0.0, each=True, usual=(0.0, 5.0))]

    def start(self, episode: Episode) -> _DeadZone:
        """The dead zone in one episode.

        Raises:
            ValueError: if the width does not suit the arm.
        """
        return _DeadZone(_columns("width of dead-zone", self.width, episode))


class _DeadZone:
    def __init__(self, width: np.ndarray) -> None:
        self._width, self._active = width, width > 0.0

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        del step
        beyond = tau - _clip(tau, -self._width, self._width)
        return np.where(self._active, beyond, tau)  # for a width of 0 the sign of 0 stays too


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Saturation(ActuatorFault):
    """No more force than the limit: clip(tau, -limit, limit).

    Attributes:
        limit: largest |tau|, may be infinite, broadcasts to shape (..., 2N) [N].
    """

    name: ClassVar[str] = "saturation"
    limit: Annotated[Amount, Quantity("N", at_least=0.0, each=True, unbounded=True)]

    def start(self, episode: Episode) -> _Saturation:
        """The saturation in one episode.

        Raises:
            ValueError: if the limit does not suit the arm.
        """
        return _Saturation(_columns("limit of saturation", self.limit, episode))


class _Saturation:
    def __init__(self, limit: np.ndarray) -> None:
        self._limit = limit

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        del step
        return _clip(tau, -self._limit, self._limit)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Lag(ActuatorFault):
    """A first-order lag, T y' + y = tau with y = 0 at the start.

    The plant receives over each physics step the value of y at the step's end, exact for an input
    held over the step: y <- tau + exp(-dt / T) (y - tau).

    Attributes:
        time_constant: T, broadcasts to shape (..., 2N) [s].
    """

    name: ClassVar[str] = "lag"
    time_constant: Annotated[
        Amount, Quantity("s", at_least=0.0, each=True, key="time", usual=(0.0, 0.2))
    ]

    def start(self, episode: Episode) -> _Lag:
        """The lag in one episode.

        Raises:
            ValueError: if the time constant does not suit the arm.
        """
        T = _columns("time of lag", self.time_constant, episode)
        with np.errstate(divide="ignore", over="ignore"):  # exp(-inf) = 0: no lag
            return _Lag(np.exp(-(episode.timestep / T)))


class _Lag:
    def __init__(self, decay: np.ndarray) -> None:
        self._decay, self._active = decay, decay > 0.0
        self._applied: np.ndarray | None = None

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        del step
        y = np.zeros_like(tau) if self._applied is None else self._applied
        self._applied = np.where(self._active, tau + self._decay * (y - tau), tau)
        return self._applied


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SlewLimit(ActuatorFault):
    """A force that follows tau no faster than the rate, from 0 at the start.

    Attributes:
        rate: largest change in time, may be infinite, broadcasts to shape (..., 2N) [N/s].
    """

    name: ClassVar[str] = "slew"
    rate: Annotated[Amount, Quantity("N/s", above=0.0, each=True, unbounded=True)]

    def start(self, episode: Episode) -> _SlewLimit:
        """The slew limit in one episode.

        Raises:
            ValueError: if the rate does not suit the arm.
        """
        return _SlewLimit(_columns("rate of slew", self.rate, episode) * episode.timestep)


class _SlewLimit:
    def __init__(self, most: np.ndarray) -> None:
        self._most = most  # change in a physics step [N]
        self._applied: np.ndarray | None = None

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        del step
        y = np.zeros_like(tau) if self._applied is None else self._applied
        self._applied = _clip(tau, y - self._most, y + self._most)
        return self._applied


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ActuationDelay(ActuatorFault):
    """Input forces that arrive late; none, until the delay has passed once.

    Attributes:
        delay: rounded to whole physics steps, which need not be whole control periods, shape (...)
            [s].
    """

    name: ClassVar[str] = "actuation-delay"
    delay: Annotated[Amount, Quantity("s", at_least=0.0, at_most=10.0, usual=(0.0, 0.05))]

    def start(self, episode: Episode) -> _ActuationDelay:
        """The delay in one episode; its attribute `delay` is what it really is.

        Raises:
            ValueError: if the delay does not suit the batch.
        """
        return _ActuationDelay(DelayLine("delay of actuation-delay", self.delay, episode))


class _ActuationDelay:
    """The inputs of a while ago.

    Attributes:
        delay: of each arm, whole physics steps, shape (...) [s].
    """

    def __init__(self, line: DelayLine) -> None:
        self.delay, self._line = line.delay, line

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        self._line.put(step, tau)
        (late,) = self._line.take(step - self._line.steps)
        return late


def _columns(name: str, value: Amount, episode: Episode) -> np.ndarray:
    """One value a column, shape (..., 2N), contiguous along the arms."""
    return np.asfortranarray(episode.per_coordinate(name, value))


def _clip(x: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """np.clip, in a fraction of its time for one arm."""
    return np.minimum(np.maximum(x, low), high)
