"""The analytic arm as an engine: one arm or many, behind the methods of MuJoCo's arms.

It is RK4 on the equations of `octarm.arm.lagrange`, and agrees with MuJoCo's RK4 to rounding. What
it computes consists of operations that IEEE 754 defines to the last bit, arm by arm: a step gives
the same bits whatever the batch, the threads and the processor.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from octarm.arm.actuation import Actuation
from octarm.arm.kinematics import tip_position
from octarm.arm.lagrange import equilibrium
from octarm.arm.limits import Limits
from octarm.arm.mjcf import physics_step
from octarm.arm.parameters import ArmParameters
from octarm.arrays import Entry
from octarm.disturbances.episode import Plant
from octarm.simulation.exclusive import Exclusive
from octarm.simulation.lagrange_kernel import LANES, rk4_step, work_space
from octarm.simulation.stepping import AnyPhysics

if TYPE_CHECKING:
    from octarm.simulation.physics import BatchPhysics


class LagrangePhysics(AnyPhysics):
    """Arms that follow eq (1). An arm of a batch gives bit for bit what it gives alone.

    An arm that leaves its limits stays where it is; the others go on.
    """

    _pool: ThreadPoolExecutor | None = None
    _others: BatchPhysics | None = None

    def __init__(
        self,
        parameters: ArmParameters,
        arms: int | None,
        actuation: Actuation,
        *,
        timestep: float | None = None,
        threads: int = 1,
    ) -> None:
        """Physics of one arm, or of a batch of `arms` with parameters of all or each of them.

        The timestep [s] is that of models/octarm.xml when None; results do not depend on the number
        of threads. Raises OctarmError if the timestep is not allowed, or an arm has no equilibrium.
        """
        n = parameters.modules
        self.batch_shape = () if arms is None else (arms,)
        self.actuation = actuation
        self._qpos, self._qvel, self._added = np.zeros((3, 2 * n, *self.batch_shape))
        self._qpos_index = self._qvel_index = np.arange(2 * n)
        self._ctrl = np.zeros((4 * n - 2, *self.batch_shape)).T
        self._fields = PlantRows(parameters)
        self._outside = np.zeros(arms or 1, dtype=bool)
        self._lost = 0
        self._work = [work_space(n) for _ in range(min(threads, -(-(arms or 1) // LANES)))]
        first = parameters.arm(0) if parameters.batch_shape else parameters
        self._describe(parameters, physics_step(timestep), equilibrium(first))
        if parameters.batch_shape:
            for i in range(1, len(self._rest)):
                self._rest[i] = equilibrium(parameters.arm(i))
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        hidden = ("_pool", "watch", "exclusive")
        return {name: value for name, value in self.__dict__.items() if name not in hidden}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.exclusive = Exclusive()

    def copy(self) -> LagrangePhysics:
        """Physics in the same state, with the same actuation, inputs and disturbances."""
        return copy.deepcopy(self)

    def reset(self) -> None:
        """All arms to zero, undisturbed and with no input."""
        with self.exclusive.anew():
            for array in (self._qpos, self._qvel, self._added, self._ctrl):
                array[...] = 0.0
            self._forget()

    def after_reset(self) -> None:
        """Nothing is derived from the state."""

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances by physics steps; see `AnyPhysics.step`."""
        with self.exclusive, np.errstate(all="ignore"):  # a lost arm may hold anything
            super().step(n_sub_steps)

    def hand_over(self, others: BatchPhysics) -> None:
        """Has the last arms of a batch stepped by MuJoCo, which has the same arms, undisturbed.

        They begin where MuJoCo has their rest. Nothing changes for the other arms.
        """
        self._others, self._own = others, len(self._outside) - others.arms
        self._rest[self._own :] = others.plant_rest()

    def set_motion(self, q: np.ndarray, v: np.ndarray) -> None:
        """Places the plants; see `AnyPhysics.set_motion`."""
        super().set_motion(q, v)
        if self._others is not None:
            self._others.set_motion(q[self._own :], v[self._own :])

    def tip_position(self) -> np.ndarray:
        """Tips in the world frame, shape (..., 3) [m]."""
        return tip_position(self.plant_q(), self._undisturbed.entries.tip_length)

    def plant(self) -> Plant:
        """The arms as they are."""
        return self._fields.plant

    def integration_state(self) -> np.ndarray:
        """All that the next step of one arm depends on: q, v and the time, shape (4N + 1,)."""
        return np.concatenate([self._qpos, self._qvel, [self.time()]])

    def _advance(self) -> None:
        if self._others is not None:
            lost = self._advance_others(self._others)
            self._lost = lost + self._step_arms(0, self._own, self._work[0])
            return
        arms, threads = len(self._outside), len(self._work)
        if threads == 1:
            self._lost = self._step_arms(0, arms, self._work[0])
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(threads)
        share = LANES * -(-arms // (LANES * threads))
        starts = range(0, arms, share)
        ends = [min(start + share, arms) for start in starts]
        self._lost = sum(self._pool.map(self._step_arms, starts, ends, self._work))

    def _step_arms(self, first: int, last: int, work: np.ndarray) -> int:
        """Steps some of the arms; how many of them have left their limits."""
        n = len(self._outside)
        q, v, ctrl, added = (
            x.reshape(-1, n) for x in (self._qpos, self._qvel, self._ctrl.T, self._added)
        )
        rows, gravity = self._fields.rows, self._fields.gravity
        alive = self._intact.reshape(n)
        return rk4_step(
            q, v, ctrl, added, rows, gravity, alive, self._outside, self._timestep, work, first,
            last,
        )  # fmt: skip

    def _advance_others(self, others: BatchPhysics) -> int:
        """Steps the last arms by MuJoCo; how many of them have left their limits."""
        last = slice(self._own, None)
        lost = others.driven(self._ctrl[last], self._added[:, last], self._intact[last])
        self._qpos[:, last], self._qvel[:, last] = others.plant_q().T, others.plant_v().T
        self._outside[last] = lost
        return int(np.count_nonzero(lost))

    def _write(self, plant: Plant | None) -> None:
        super()._write(plant)
        if plant is not None and self._others is not None:
            self._others._write(plant.last(self._own))

    def _check_limits(self) -> None:
        if self._lost:
            self.freeze(self._outside.reshape(self.batch_shape))

    def _follow_inertias(self) -> None:
        """Nothing is derived from them."""


class PlantRows:
    """The plants of arms as `rk4_step` takes them.

    Attributes:
        plant: that was written last.
        rows: of the modules, shape (N, PLANT_ROWS, n), n = 1 if all arms are the same.
        gravity: acceleration of the ground against gravity, shape (2, n) or (2, 1) [m/s^2].
    """

    plant: Plant
    rows: np.ndarray
    gravity: np.ndarray

    def __init__(self, undisturbed: ArmParameters) -> None:
        """Rows of the undisturbed arms, whose limits stay."""
        limits = Limits.of(undisturbed)
        n = undisturbed.modules
        self._limits = [
            bound[j : j + n] for bound in (limits.low, limits.high, limits.speed) for j in (0, n)
        ]
        self.write(undisturbed)

    def write(self, p: ArmParameters, gravity_angle: np.ndarray | float = 0.0) -> bool:
        """Writes the parameters, of all arms or with batch axis (n,).

        The angle by which gravity turns has shape () or (n,) [rad]. False: no constants have to
        follow.
        """
        self.plant, of = Plant(p, gravity_angle), p.entries
        half = of.half_width

        def module(i: int) -> list[Entry]:
            (k1, k2), (c1, c2) = ([x[i] for x in pair] for pair in (of.stiffness, of.damping))
            springs, dampers = _columns(k1, k2, half[i]), _columns(c1, c2, half[i])
            bounds = [bound[i] for bound in self._limits]
            return [
                of.mass[i], of.inertia[i],
                *(a + b for a, b in zip(springs, _backbone(of.backbone_stiffness, i), strict=True)),
                *(a + b for a, b in zip(dampers, _backbone(of.backbone_damping, i), strict=True)),
                of.rest_length[i], of.rest_angle[i], half[i], *bounds,
            ]  # fmt: skip

        rows = np.stack([_stacked(module(i)) for i in range(p.modules)], axis=0)
        self.rows = np.ascontiguousarray(rows)
        angle, g = np.asarray(gravity_angle), np.asarray(p.gravity)
        self.gravity = _stacked([-g * np.cos(angle), -g * np.sin(angle)])
        return False


def _columns(first: Entry, second: Entry, half: Entry) -> tuple[Entry, Entry, Entry]:
    """What two columns do to s, to s by theta, and to theta; half their distance is given."""
    both, odd = first + second, half * (first - second)
    return both, odd, half * half * both


def _backbone(of: tuple[Sequence[Entry], Sequence[Entry]], i: int) -> tuple[Entry, Entry, Entry]:
    """The same of what a module has beside its columns."""
    return of[0][i], 0.0, of[1][i]


def _stacked(entries: list[Entry]) -> np.ndarray:
    """Numbers or arrays of shape (n,) as rows, shape (k, n) or (k, 1)."""
    return np.stack(np.broadcast_arrays(*(np.atleast_1d(x) for x in entries)))
