"""Changes of the true arm that the controller does not know: loads, wrong parameters, a tilt.

They act one after another on the undisturbed plant, each time that one of them changes, so that
nothing accumulates.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from octarm.disturbances.episode import Episode, Event, Plant, PlantChange, PlantProcess
from octarm.disturbances.streams import NEVER, first_step, periods_begun
from octarm.fields import PHASE, Amount, Quantity, Words
from octarm.units import MISMATCH

# The parameters that have factors, and how many axes each has after the batch axes.
SCALABLE = {"mass": 1, "inertia": 1, "stiffness": 2, "damping": 2, "rest_length": 1}

_GRID = 0.01  # [s]; parameters that drift stay as they are for so long, whatever the physics step

Factor = Annotated[Amount, Quantity("1", above=0.0, at_most=1e6)]
Share = Annotated[Amount, Quantity("1", at_least=0.0, below=1.0, usual=(0.0, 0.95))]
Angle = Annotated[Amount, Quantity("rad", at_least=-np.pi, at_most=np.pi, usual=(0.0, 1.5))]
Of = Annotated[str, Words(joined=tuple(SCALABLE))]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Mismatch(PlantChange):
    """A true arm with other parameters, from the start.

    By `mismatch` mass, inertia and damping are multiplied by 1 + mismatch, stiffness by 1 +
    mismatch/2, as in `ArmParameters.mismatched`. The other fields are further factors, and the
    angle by which gravity is turned, see `Plant`.
    """

    name: ClassVar[str] = "mismatch"
    mismatch: Annotated[Amount, Quantity(**vars(MISMATCH), usual=(0.0, 3.0))] = 0.0
    mass: Factor = 1.0
    inertia: Factor = 1.0
    stiffness: Factor = 1.0
    damping: Annotated[Amount, Quantity("1", at_least=0.0, at_most=1e6)] = 1.0
    rest_length: Factor = 1.0
    tilt: Angle = 0.0

    def start(self, episode: Episode) -> PlantProcess:
        value = episode.values(self)
        full, half = 1.0 + value["mismatch"], 1.0 + value["mismatch"] / 2.0
        common = {"mass": full, "inertia": full, "stiffness": half, "damping": full}
        factors = {n: _spread(n, common.get(n, 1.0) * value[n]) for n in SCALABLE}
        return _from_the_start(factors, value["tilt"])

    def gravity_angle(self) -> float:
        return 0.0 if np.ndim(self.tilt) else float(self.tilt)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class RandomMismatch(PlantChange):
    """A true arm with parameters drawn at random, every module and column on its own.

    Each parameter is multiplied by 1 + share u with u uniform in -1 .. 1, rest lengths by a share
    of their own, and gravity is turned by the tilt times such a u. The draws are the same for any
    share. All modules of a group of a finer plant have the draws of the module that the group
    stands for.
    """

    name: ClassVar[str] = "random-mismatch"
    share: Share
    rest_length: Share = 0.0
    tilt: Annotated[Amount, Quantity("rad", at_least=0.0, at_most=np.pi)] = 0.0

    def start(self, episode: Episode) -> PlantProcess:
        n, batch = episode.parameters.modules, episode.batch_shape
        shapes = {name: (2, n)[2 - axes :] for name, axes in SCALABLE.items()} | {"tilt": ()}
        drawn: dict[str, list[np.ndarray]] = {name: [] for name in shapes}
        for generator in episode.streams(self.name):
            for name, shape in shapes.items():
                drawn[name].append(2.0 * np.asarray(generator.random(shape)) - 1.0)
        u = {name: np.stack(rows).reshape((*batch, *rows[0].shape)) for name, rows in drawn.items()}
        value = episode.values(self)
        shares = dict.fromkeys(SCALABLE, value["share"]) | {"rest_length": value["rest_length"]}
        factors = {
            name: episode.each_module(1.0 + _spread(name, share) * u[name])
            for name, share in shares.items()
        }
        return _from_the_start(factors, value["tilt"] * u["tilt"])


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class GravityTilt(PlantChange):
    """Gravity turned in the arm's plane, as on a base that is not level."""

    name: ClassVar[str] = "tilt"
    angle: Angle

    def start(self, episode: Episode) -> PlantProcess:
        return _from_the_start({}, episode.value(self, "angle"))

    def gravity_angle(self) -> float:
        return 0.0 if np.ndim(self.angle) else float(self.angle)


def _from_the_start(factors: Mapping[str, Amount], tilt: Amount) -> PlantProcess:
    """Factors on parameters, by name, and a turn of gravity, shape (...) [rad]."""
    changed = functools.partial(_changed, factors, tilt)
    return PlantProcess(operator.not_, changed, [functools.partial(changed, 0)])


def _changed(factors: Mapping[str, Amount], tilt: Amount, step: int, plant: Plant) -> Plant:
    del step
    scaled = plant.parameters.scaled(**factors) if factors else plant.parameters
    return Plant(scaled, plant.gravity_angle + tilt)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Payload(PlantChange):
    """A point mass at the last plate, from a given time on; the tip unless a rigid piece follows.

    It has the tip's velocity when it is picked up: there is no impact.
    """

    name: ClassVar[str] = "payload"
    mass: Annotated[Amount, Quantity("kg", at_least=0.0, plausible=20.0, usual=(0.0, 1.0))]
    at: Annotated[Amount, Quantity("s", at_least=0.0, plausible=3600.0)] = 0.0

    def start(self, episode: Episode) -> PlantProcess:
        value = episode.values(self)
        first = first_step(value["at"], episode.timestep)
        changes = frozenset([0, *np.ravel(first).tolist()])
        loaded = functools.partial(_loaded, value["mass"], first)
        ends = functools.partial(loaded, -1), functools.partial(loaded, NEVER)
        return PlantProcess(changes.__contains__, loaded, ends)

    def events(self) -> Sequence[Event]:
        return self.span(self.at)

    def carried(self) -> tuple[float, float] | None:
        if np.ndim(self.mass) or np.ndim(self.at):
            return None
        return float(self.mass), float(self.at)


def _loaded(mass: Amount, first: np.ndarray, step: int, plant: Plant) -> Plant:
    p = plant.parameters
    added = np.where(step >= first, mass, 0.0)
    batch = np.broadcast_shapes(p.mass.shape[:-1], added.shape)
    masses = np.array(np.broadcast_to(p.mass, (*batch, p.modules)))
    masses[..., -1] += added
    return plant._replace(parameters=dataclasses.replace(p, mass=masses))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Drift(PlantChange):
    """Parameters that change steadily until they have changed by a limit.

    Those `of`, such as `stiffness+damping`, are multiplied by 1 + rate t, which stays within 1 -
    limit and 1 + limit. They change every 10 ms.
    """

    name: ClassVar[str] = "drift"
    rate: Annotated[Amount, Quantity("1/s", plausible=10.0, usual=(0.0, 0.5))]
    of: Of = "stiffness"
    limit: Share = 0.5

    def start(self, episode: Episode) -> PlantProcess:
        value = episode.values(self)
        drifting = _Drifting(functools.partial(_ramp, **value), self.of, episode.timestep)
        return drifting.process(np.ones(()), 1.0 + np.sign(value["rate"]) * value["limit"])


def _ramp(t: float, rate: Amount, limit: Amount) -> np.ndarray:
    return 1.0 + np.clip(rate * t, -np.asarray(limit), limit)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class CyclicDrift(PlantChange):
    """Parameters that swing about their values.

    Those `of`, such as `stiffness+damping`, are multiplied by 1 + share sin(2 pi t / period +
    phase). They change every 10 ms.
    """

    name: ClassVar[str] = "cyclic-drift"
    share: Share
    period: Annotated[Amount, Quantity("s", at_least=10.0 * _GRID, plausible=3600.0)] = 10.0
    phase: Annotated[Amount, PHASE] = 0.0
    of: Of = "stiffness"

    def start(self, episode: Episode) -> PlantProcess:
        value = episode.values(self)
        drifting = _Drifting(functools.partial(_swing, **value), self.of, episode.timestep)
        return drifting.process(np.asarray(1.0 - value["share"]), np.asarray(1.0 + value["share"]))


def _swing(t: float, share: Amount, period: Amount, phase: Amount) -> np.ndarray:
    return 1.0 + share * np.sin(2.0 * np.pi / period * t + phase)


class _Drifting(NamedTuple):
    """A factor, shape (...), on the parameters `of`, that follows time [s] on a grid of its own."""

    factor: Callable[[float], np.ndarray]
    of: str
    timestep: float

    def process(self, *ends: np.ndarray) -> PlantProcess:
        """The process of a factor that stays between these ends."""
        return PlantProcess(
            self._moves, self._moved, [functools.partial(self._scaled, by) for by in ends]
        )

    def _moves(self, step: int) -> bool:
        return step == 0 or self._grid(step) != self._grid(step - 1)

    def _moved(self, step: int, plant: Plant) -> Plant:
        return self._scaled(self.factor(self._grid(step) * _GRID), plant)

    def _scaled(self, by: np.ndarray, plant: Plant) -> Plant:
        factors = {name: _spread(name, by) for name in self.of.split("+")}
        return plant._replace(parameters=plant.parameters.scaled(**factors))

    def _grid(self, step: int) -> int:
        return int(periods_begun(step, self.timestep, _GRID))


def _spread(name: str, factor: Amount) -> np.ndarray:
    """A factor for each arm, shape (...), with the further axes of the parameter of this name."""
    return np.asarray(factor)[(..., *(None,) * SCALABLE[name])]
