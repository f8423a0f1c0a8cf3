"""The disturbances of one episode, all of them active."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from operator import is_
from typing import Any

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import (
    ActuatorFault,
    ActuatorProcess,
    Disturbance,
    Episode,
    Force,
    ForceProcess,
    Plant,
    PlantChange,
    PlantProcess,
    SensorFault,
    SensorProcess,
    numbered,
    occurrences,
)
from octarm.disturbances.forces import TipProcess
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError

_SIMULATED = (1e-14, 1e14)  # masses [kg] and inertias [kg m^2]; beyond, MuJoCo divides by zero
_COMBINATIONS = 256  # of extremes; of more, the plant is checked when it changes


class ActiveDisturbances:
    """The disturbances that act during one episode.

    Those of one family act in the order of `DISTURBANCES`. The second one of a class has streams
    and a name of its own, such as `noise-2`. Everything is asked for at every physics step from 0
    on, in order; asking again for the same step gives the same, except for `received`.

    Attributes:
        forces: names and processes, in order; likewise `plant_changes`, `actuators` and `sensors`.
        shares: each force's own share of the last `force`, by name, shape (..., 2N) [N], [N m]; of
            a force on the tip of a plant of more modules, what is nearest to it.
        inputs: what came out of each actuator fault in the last `received`, by name, shape (...,
            2N) [N].
        commanded: the input forces tau that the last `received` was given, shape (..., 2N) [N].
        measured_force: the last `force` as far as it is measured, the sum of `shares`, likewise.
        readings: what came out of each sensor fault in the last `sensed`, by name.
        input_bounds: what |tau| is limited to by disturbances, each broadcasts to (..., 2N) [N].
    """

    def __init__(self, disturbances: Sequence[Disturbance], episode: Episode) -> None:
        """Starts them all; `OctarmError` if one does not suit the episode or another one."""
        self.episode = episode
        bounds = (disturbance.input_bound() for disturbance in disturbances)
        self.input_bounds = [bound for bound in bounds if bound is not None]
        self.shares: dict[str, np.ndarray] = {}
        self._each: dict[str, np.ndarray] = {}  # what the forces gave, a tip's on the plant
        self.inputs: dict[str, np.ndarray] = {}
        self.commanded = np.empty(0)
        self.readings: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._total = self.measured_force = np.empty(0)
        families = (Force, PlantChange, ActuatorFault, SensorFault)
        started: dict[str, list[tuple[str, Any]]] = {cls.family: [] for cls in families}
        place = {cls: i for i, cls in enumerate(DISTURBANCES.values())}
        listed = zip(disturbances, occurrences(disturbances), strict=True)
        for disturbance, count in sorted(listed, key=lambda x: place.get(type(x[0]), len(place))):
            name = disturbance.name
            if count > 1 and disturbance.instead_of_two:
                raise OctarmError(f"{name} is given twice; {disturbance.instead_of_two}")
            nth = episode if count == 1 else episode.changed(occurrence=count)
            process = disturbance.start(nth)
            started[disturbance.family].append((numbered(name, count), process))
        self.forces: list[tuple[str, ForceProcess]] = started[Force.family]
        self._tips = {name for name, process in self.forces if isinstance(process, TipProcess)}
        self.plant_changes: list[tuple[str, PlantProcess]] = started[PlantChange.family]
        self.actuators: list[tuple[str, ActuatorProcess]] = started[ActuatorFault.family]
        self.sensors: list[tuple[str, SensorProcess]] = started[SensorFault.family]
        ranges = [process.extremes for _, process in self.plant_changes]
        self._surveyed = all(ranges) and math.prod(map(len, ranges)) <= _COMBINATIONS
        if self._surveyed:
            for changes in itertools.product(*ranges):
                plant = Plant(self.episode.plant)
                for change in changes:
                    plant = change(plant)
                self._check(plant)
        elif (plant := self._changed_plant(0)) is not None:
            self._check(plant)

    def received(self, step: int, tau: np.ndarray) -> np.ndarray:
        """What the plant receives of the input forces tau at a physics step, shapes (..., 2N) [N].

        Each step is asked for once.
        """
        self.commanded = tau
        for name, process in self.actuators:
            self.inputs[name] = tau = process(step, tau)
        return tau

    def force(self, step: int, q: np.ndarray, plant_q: np.ndarray | None = None) -> np.ndarray:
        """The generalised force held over a physics step, shape (..., 2N) [N], [N m]; read-only.

        It is given the true coordinates at its middle, shape (..., 2N) [m], [rad], and those of all
        modules of the plant, which the force is on, where it has more.
        """
        if not self.forces:
            return np.zeros_like(q)
        groups, tips = (None, set[str]()) if plant_q is None else (self.episode.groups, self._tips)
        each = {
            name: process(step, q if plant_q is None or name not in tips else plant_q)
            for name, process in self.forces
        }
        if not self._each or not all(map(is_, each.values(), self._each.values())):
            self._each = self.shares = each
            forces = list(each.values())
            if groups is not None:  # by virtual work; a tip is pushed where it is
                self.shares = each | {name: groups.mean_force(each[name]) for name in tips}
                forces = [f if name in tips else groups.force(f) for name, f in each.items()]
            self._total = sum(forces, start=np.zeros(()))  # 0.0, never -0.0
            self._total.setflags(write=False)
            self.measured_force = self._total
            if groups is not None:
                self.measured_force = sum(self.shares.values(), start=np.zeros(()))
        return self._total

    def plant_changes_at(self, step: int) -> bool:
        """Whether `plant` at this physics step differs from the one before it."""
        return any([process.changes_at(step) for _, process in self.plant_changes])

    def plant(self, step: int) -> Plant | None:
        """The true arm from this physics step on; None when it is the one of the step before.

        At step 0 it is None only when nothing ever changes it. Raises OctarmError for an arm that
        cannot be simulated, so light or so heavy, or with modes too fast for the physics step.
        """
        plant = self._changed_plant(step)
        if plant is None:
            return None
        if step == 0 and (beyond := _beyond(plant.parameters)):
            raise OctarmError(beyond)
        if not self._surveyed:
            self._check(plant)
        return plant

    def _changed_plant(self, step: int) -> Plant | None:
        if not self.plant_changes_at(step):
            return None
        plant = Plant(self.episode.plant)
        for _, process in self.plant_changes:
            plant = process.apply(step, plant)
        return plant

    def _check(self, plant: Plant) -> None:
        if not _beyond(plant.parameters):
            self.episode.check_arm(plant.parameters)

    def record(self, step: int, q: np.ndarray, v: np.ndarray) -> None:
        """Shows the sensors the true q and v, shapes (..., 2N), when `step` steps are done."""
        for _, process in self.sensors:
            process.record(step, q, v)

    def sensed(self, step: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is read of the true q and v, shapes (..., 2N), when a physics step begins."""
        for name, process in self.sensors:
            self.readings[name] = q, v = process(step, q, v)
        return q, v


def _beyond(p: ArmParameters) -> str:
    """Which mass or inertia cannot be simulated, a sentence; empty if all can."""
    low, high = _SIMULATED
    for name, unit, values in (("mass", "kg", p.mass), ("inertia", "kg m^2", p.inertia)):
        bad = ~((values >= low) & (values <= high))
        if np.any(bad):
            return (
                f"the disturbed arm has a module with {name} {values[bad].flat[0]:g} {unit}; "
                f"it must be between {low:g} and {high:g} {unit}"
            )
    return ""
