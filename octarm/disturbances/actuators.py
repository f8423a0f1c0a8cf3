"""Actuators that are weak, sticky, limited, slow or late.

What is asked passes through them to the plant: input forces tau, shape (..., 2N) [N], in the
column order of eq (2). No input acts before the start of an episode. Every process is called once
a physics step, so that nothing depends on the control period.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np

from octarm.disturbances.delivered import Measured
from octarm.disturbances.episode import ActuatorFault, ActuatorProcess, Disturbance, Episode, Event
from octarm.disturbances.streams import DelayLine, first_step
from octarm.fields import Amount, Quantity


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Delay(Disturbance):
    """What passes arrives late, by a delay that need not be whole control periods or steps."""

    units: ClassVar[Mapping[str, str]] = {"delay": "s"}
    delay: Annotated[Amount, Quantity("s", at_least=0.0, at_most=10.0, usual=(0.0, 0.05))]

    def delivered(self, measured: Measured) -> dict[str, Any]:
        """How much it changed what passes, and how late this arrived."""
        return measured.signal.sizes() | {"delay": measured.signal.delay(float(self.delay))}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ActuationDelay(Delay, ActuatorFault):
    """Input forces that arrive late; none, until the delay has passed once.

    Inputs that change within a physics step act in it by their mean: what the arm receives is right
    to the instant in its integral over time, and the motion is of second order in the step.
    """

    name: ClassVar[str] = "actuation-delay"

    def start(self, episode: Episode) -> _LateInputs:
        return _LateInputs(episode.value(self, "delay"), episode.timestep, episode.batch_shape)


class _LateInputs(DelayLine):
    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        self.put(step, tau)
        (late,) = self.take(step - self.steps)
        if not self.fractions:
            return late
        (earlier,), rest = self.take(step - self.steps - 1), self.rest[..., None]
        return np.where(rest > 0.0, late + rest * (earlier - late), late)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class DeadZone(ActuatorFault):
    """No force below the width, and that much less beyond it: tau - clip(tau, +-width)."""

    name: ClassVar[str] = "dead-zone"
    width: Annotated[
        Amount, Quantity("N", at_least=0.0, plausible=1e4, each=True, usual=(0.0, 5.0))
    ]

    def start(self, episode: Episode) -> ActuatorProcess:
        return functools.partial(_beyond, _columns(self, "width", episode))


def _beyond(width: np.ndarray, step: int, tau: np.ndarray) -> np.ndarray:
    del step
    beyond = tau - _clip(tau, -width, width)
    return np.where(width > 0.0, beyond, tau)  # for a width of 0 the sign of 0 stays too


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Saturation(ActuatorFault):
    """No more force than the limit: clip(tau, -limit, limit)."""

    name: ClassVar[str] = "saturation"
    limit: Annotated[Amount, Quantity("N", at_least=0.0, plausible=1e6, each=True, unbounded=True)]

    def start(self, episode: Episode) -> ActuatorProcess:
        return functools.partial(_limited, _columns(self, "limit", episode))

    def input_bound(self) -> Amount:
        return self.limit


def _limited(limit: np.ndarray, step: int, tau: np.ndarray) -> np.ndarray:
    del step
    return _clip(tau, -limit, limit)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SlewLimit(ActuatorFault):
    """A force that follows tau no faster than the rate, from 0 at the start."""

    name: ClassVar[str] = "slew"
    rate: Annotated[Amount, Quantity("N/s", above=0.0, plausible=1e8, each=True, unbounded=True)]

    def start(self, episode: Episode) -> ActuatorProcess:
        most = _columns(self, "rate", episode) * episode.timestep  # change in a physics step [N]
        return _Follower(functools.partial(_slewed, most))


def _slewed(most: np.ndarray, y: np.ndarray, tau: np.ndarray) -> np.ndarray:
    return _clip(tau, y - most, y + most)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Lag(ActuatorFault):
    """A first-order lag, T y' + y = tau with y = 0 at the start.

    The plant receives over each physics step the value of y at the step's end, exact for an input
    held over the step: y <- tau + exp(-dt / T) (y - tau).
    """

    name: ClassVar[str] = "lag"
    time_constant: Annotated[
        Amount, Quantity("s", at_least=0.0, plausible=10.0, each=True, key="time", usual=(0.0, 0.2))
    ]

    def start(self, episode: Episode) -> ActuatorProcess:
        T = _columns(self, "time_constant", episode)
        with np.errstate(divide="ignore", over="ignore"):  # exp(-inf) = 0: no lag
            decay = np.exp(-(episode.timestep / T))
        return _Follower(functools.partial(_lagged, decay))


def _lagged(decay: np.ndarray, y: np.ndarray, tau: np.ndarray) -> np.ndarray:
    return np.where(decay > 0.0, tau + decay * (y - tau), tau)


class _Follower:
    """A force y that follows tau: what comes next depends on y and tau, and y is 0 at first."""

    def __init__(self, follow: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        self._follow = follow
        self._applied: np.ndarray | None = None

    def __call__(self, step: int, tau: np.ndarray) -> np.ndarray:
        del step
        y = np.zeros_like(tau) if self._applied is None else self._applied
        self._applied = self._follow(y, tau)
        return self._applied


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LossOfEffectiveness(ActuatorFault):
    """Columns that lose a share of their force: (1 - share) tau from the time `at` on."""

    name: ClassVar[str] = "loss"
    share: Annotated[Amount, Quantity("1", at_least=0.0, at_most=1.0, each=True, usual=(0.0, 1.0))]
    at: Annotated[Amount, Quantity("s", at_least=0.0, at_most=1e9)] = 0.0

    def start(self, episode: Episode) -> ActuatorProcess:
        onset = first_step(episode.value(self, "at"), episode.timestep)[..., None]
        return functools.partial(_weakened, 1.0 - _columns(self, "share", episode), onset)

    def events(self) -> Sequence[Event]:
        return self.span(self.at)


def _weakened(kept: np.ndarray, onset: np.ndarray, step: int, tau: np.ndarray) -> np.ndarray:
    return tau * np.where(onset <= step, kept, 1.0)


def _columns(fault: ActuatorFault, field: str, episode: Episode) -> np.ndarray:
    return np.asfortranarray(episode.value(fault, field))


def _clip(x: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """np.clip, in a fraction of its time for one arm."""
    return np.minimum(np.maximum(x, low), high)
