"""Parameters of the true arm that change while it moves, without the controller's knowledge."""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from octarm.disturbances.episode import Episode, Plant, PlantChange
from octarm.disturbances.fields import Amount, Quantity, Words
from octarm.disturbances.plant import SCALABLE, Share, spread
from octarm.disturbances.streams import periods_begun

_GRID = 0.01  # [s]; parameters stay as they are for so long, whatever the physics step

Of = Annotated[str, Words(tuple(SCALABLE))]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Drift(PlantChange):
    """Parameters that change steadily until they have changed by a limit.

    They are multiplied by 1 + rate t, which stays within 1 - limit and 1 + limit. They change
    every 10 ms.

    Attributes:
        rate: shape (...) [1/s].
        of: what drifts, such as `stiffness` or `stiffness+damping`.
        limit: shape (...) [1].

    Raises:
        ValueError: if a value is out of range, or `of` is unknown.
    """

    name: ClassVar[str] = "drift"
    rate: Annotated[Amount, Quantity("1/s", usual=(0.0, 0.5))]
    of: Of = "stiffness"
    limit: Share = 0.5

    def start(self, episode: Episode) -> _Drift:
        """The drift of one episode.

        Raises:
            ValueError: if a field does not suit the batch.
        """
        rate = episode.per_arm("rate of drift", self.rate)
        limit = episode.per_arm("limit of drift", self.limit)
        return _Drift(_Ramp(rate, limit), self.of, episode.timestep)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class CyclicDrift(PlantChange):
    """Parameters that swing about their values.

    They are multiplied by 1 + share sin(2 pi t / period + phase). They change every 10 ms.

    Attributes:
        share: shape (...) [1].
        period: shape (...) [s].
        phase: shape (...) [rad].
        of: what drifts, such as `stiffness` or `stiffness+damping`.

    Raises:
        ValueError: if a value is out of range, or `of` is unknown.
    """

    name: ClassVar[str] = "cyclic-drift"
    share: Share
    period: Annotated[Amount, Quantity("s", at_least=10.0 * _GRID)] = 10.0
    phase: Annotated[Amount, Quantity("rad")] = 0.0
    of: Of = "stiffness"

    def start(self, episode: Episode) -> _Drift:
        """The drift of one episode.

        Raises:
            ValueError: if a field does not suit the batch.
        """
        share, period, phase = (
            episode.per_arm(f"{n} of cyclic-drift", getattr(self, n))
            for n in ("share", "period", "phase")
        )
        return _Drift(_Swing(share, 2.0 * np.pi / period, phase), self.of, episode.timestep)


@dataclasses.dataclass(frozen=True)
class _Ramp:
    """1 + rate t, within 1 +- limit."""

    rate: Amount
    limit: Amount

    def __call__(self, t: float) -> np.ndarray:
        return 1.0 + np.clip(self.rate * t, -np.asarray(self.limit), self.limit)


@dataclasses.dataclass(frozen=True)
class _Swing:
    """1 + share sin(omega t + phase)."""

    share: Amount
    omega: Amount
    phase: Amount

    def __call__(self, t: float) -> np.ndarray:
        return 1.0 + self.share * np.sin(self.omega * t + self.phase)


@dataclasses.dataclass(frozen=True)
class _Drift:
    """A factor on some parameters that follows time on a grid of its own."""

    factor: _Ramp | _Swing
    of: str
    timestep: float

    def changes_at(self, step: int) -> bool:
        return step == 0 or self._grid(step) != self._grid(step - 1)

    def apply(self, step: int, plant: Plant) -> Plant:
        factor = self.factor(self._grid(step) * _GRID)
        factors = {name: spread(name, factor) for name in self.of.split("+")}
        return plant._replace(parameters=plant.parameters.scaled(**factors))

    def _grid(self, step: int) -> int:
        return int(periods_begun(step, self.timestep, _GRID))
