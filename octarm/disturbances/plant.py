"""Changes of the true arm that the controller does not know: loads, wrong parameters, a tilt.

They act one after another on the undisturbed plant, each time that one of them changes, so that
nothing accumulates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np

from octarm.disturbances.episode import Episode, Plant, PlantChange
from octarm.disturbances.fields import Amount, Quantity
from octarm.disturbances.streams import first_step

# The parameters that have factors, and how many axes each has after the batch axes.
SCALABLE = {"mass": 1, "inertia": 1, "stiffness": 2, "damping": 2, "rest_length": 1}

Factor = Annotated[Amount, Quantity("1", above=0.0, at_most=1e6)]
Share = Annotated[Amount, Quantity("1", at_least=0.0, below=1.0, usual=(0.0, 0.95))]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Mismatch(PlantChange):
    """A true arm with other parameters, from the start.

    Attributes:
        mismatch: mass, inertia and damping are multiplied by 1 + mismatch, stiffness by
            1 + mismatch/2, as in `ArmParameters.mismatched`, shape (...) [1].
        mass: further factor, shape (...) [1].
        inertia: further factor, shape (...) [1].
        stiffness: further factor, shape (...) [1].
        damping: further factor, shape (...) [1].
        rest_length: factor, shape (...) [1].
        tilt: angle by which gravity is turned, see `Plant`, shape (...) [rad].

    Raises:
        ValueError: if a value is out of range.
    """

    name: ClassVar[str] = "mismatch"
    mismatch: Annotated[Amount, Quantity("1", above=-1.0, at_most=1e6, usual=(0.0, 3.0))] = 0.0
    mass: Factor = 1.0
    inertia: Factor = 1.0
    stiffness: Factor = 1.0
    damping: Annotated[Amount, Quantity("1", at_least=0.0, at_most=1e6)] = 1.0
    rest_length: Factor = 1.0
    tilt: Annotated[Amount, Quantity("rad")] = 0.0

    def start(self, episode: Episode) -> _Fixed:
        """The change of one episode.

        Raises:
            ValueError: if a field does not suit the batch.
        """
        fields = [field.name for field in dataclasses.fields(self)]
        value = {n: episode.per_arm(f"{n} of mismatch", getattr(self, n)) for n in fields}
        full, half = 1.0 + value["mismatch"], 1.0 + value["mismatch"] / 2.0
        common = {"mass": full, "inertia": full, "stiffness": half, "damping": full}
        factors = {n: spread(n, common.get(n, 1.0) * value[n]) for n in SCALABLE}
        return _Fixed(factors, value["tilt"])


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class RandomMismatch(PlantChange):
    """A true arm with parameters drawn at random, every module and column on its own.

    Each parameter is multiplied by 1 + share u with u uniform in -1 .. 1. The draws are the same
    for any share.

    Attributes:
        share: of mass, inertia, stiffness and damping, shape (...) [1].
        rest_length: share of the rest lengths, shape (...) [1].
        tilt: gravity is turned by at most this angle, shape (...) [rad].

    Raises:
        ValueError: if a value is out of range.
    """

    name: ClassVar[str] = "random-mismatch"
    share: Share
    rest_length: Share = 0.0
    tilt: Annotated[Amount, Quantity("rad", at_least=0.0)] = 0.0

    def start(self, episode: Episode) -> _Fixed:
        """The arms of one episode.

        Raises:
            ValueError: if a field does not suit the batch.
        """
        share, rest_length, tilt = (
            episode.per_arm(f"{n} of random-mismatch", getattr(self, n))
            for n in ("share", "rest_length", "tilt")
        )
        n, batch = episode.parameters.modules, episode.batch_shape
        shapes = {name: (2, n)[2 - axes :] for name, axes in SCALABLE.items()}
        drawn: dict[str, list[np.ndarray]] = {name: [] for name in (*shapes, "tilt")}
        for generator in episode.streams(self.name):
            for name, shape in (*shapes.items(), ("tilt", ())):
                drawn[name].append(2.0 * np.asarray(generator.random(shape)) - 1.0)
        u = {name: np.stack(rows).reshape((*batch, *rows[0].shape)) for name, rows in drawn.items()}
        factors = {
            name: 1.0 + spread(name, rest_length if name == "rest_length" else share) * u[name]
            for name in shapes
        }
        return _Fixed(factors, tilt * u["tilt"])


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class GravityTilt(PlantChange):
    """Gravity turned in the arm's plane, as on a base that is not level.

    Attributes:
        angle: from the x axis of the base frame towards its y axis, shape (...) [rad].

    Raises:
        ValueError: if it is not a finite number.
    """

    name: ClassVar[str] = "tilt"
    angle: Annotated[Amount, Quantity("rad", usual=(0.0, 1.5))]

    def start(self, episode: Episode) -> _Fixed:
        """The change of one episode.

        Raises:
            ValueError: if the angle does not suit the batch.
        """
        return _Fixed({}, episode.per_arm("angle of tilt", self.angle))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Payload(PlantChange):
    """A point mass at the tip, from a given time on.

    It has the tip's velocity when it is picked up: there is no impact.

    Attributes:
        mass: shape (...) [kg].
        at: when it is picked up, shape (...) [s].

    Raises:
        ValueError: if a value is negative.
    """

    name: ClassVar[str] = "payload"
    mass: Annotated[Amount, Quantity("kg", at_least=0.0, usual=(0.0, 1.0))]
    at: Annotated[Amount, Quantity("s", at_least=0.0)] = 0.0

    def start(self, episode: Episode) -> _Payload:
        """The load of one episode.

        Raises:
            ValueError: if a field does not suit the batch.
        """
        mass = episode.per_arm("mass of payload", self.mass)
        at = episode.per_arm("at of payload", self.at)
        first = first_step(at, episode.timestep)
        return _Payload(mass, first, frozenset([0, *np.ravel(first).tolist()]))


@dataclasses.dataclass(frozen=True)
class _Fixed:
    """Factors on parameters, and a turn of gravity, from the start."""

    factors: Mapping[str, Amount]
    tilt: Amount

    def changes_at(self, step: int) -> bool:
        return step == 0

    def apply(self, step: int, plant: Plant) -> Plant:
        del step
        scaled = plant.parameters.scaled(**self.factors) if self.factors else plant.parameters
        return Plant(scaled, plant.gravity_angle + self.tilt)


@dataclasses.dataclass(frozen=True)
class _Payload:
    """A mass at the tip, which is the last body's place, from a step on."""

    mass: Amount
    first: np.ndarray
    changes: frozenset[int]

    def changes_at(self, step: int) -> bool:
        return step in self.changes

    def apply(self, step: int, plant: Plant) -> Plant:
        p = plant.parameters
        added = np.where(step >= self.first, self.mass, 0.0)
        batch = np.broadcast_shapes(p.mass.shape[:-1], added.shape)
        mass = np.array(np.broadcast_to(p.mass, (*batch, p.modules)))
        mass[..., -1] += added
        return plant._replace(parameters=dataclasses.replace(p, mass=mass))


def spread(name: str, factor: Amount) -> Amount:
    """A factor for each arm, shape (...), with the further axes of the parameter of this name."""
    return np.asarray(factor)[(..., *(None,) * SCALABLE[name])]
