"""What the physics of one arm and that of a batch of arms have in common.

There are two classes because a physics step of a batch of one arm takes three times as long as that
of an arm alone, which dm_control can draw besides.
"""
# pyright: reportAttributeAccessIssue=false, reportIncompatibleMethodOverride=false
# pyright: reportUnknownMemberType=false
# (mujoco ships no type stubs, dm_control few annotations)

from __future__ import annotations

import abc
import contextlib
from collections.abc import Callable, Generator, Sequence

import mujoco
import numpy as np
from dm_control.rl import control

from octarm.arm import plates
from octarm.arm.actuation import Actuation
from octarm.arm.groups import SUMS, Groups
from octarm.arm.limits import Limits
from octarm.arm.mjcf import PlantFields, paper_order, rest_of
from octarm.arm.parameters import ArmParameters
from octarm.arrays import Coordinates, planar_coordinates, stacked
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Plant
from octarm.errors import OctarmError, quoted
from octarm.simulation.exclusive import Exclusive


class AnyPhysics(control.Physics):
    """One arm or a batch of arms, driven by the paper's input forces tau; all that the loop needs.

    Arrays of coordinates have shape (..., 2N), where ... is the batch shape: () for one arm, (n,)
    for a batch. Those of a batch are contiguous along the arms: a column of coordinate j is one run
    of memory. Every method returns copies. A plant of more modules is driven and measured through
    its groups: its own coordinates are those of the methods `plant_..` and of `set_motion`.

    Attributes:
        limits: beyond which an arm has diverged; `plant_limits` are those of each module of the
            plant.
        groups: through which a plant of more modules is seen; None where every module is measured.
        active: the disturbances of this episode; None before the first one.
        plant_tips: whether instants have the tips of a plant of more modules, which cost a seventh
            of its step.
        watch: called when an episode begins, and after every physics step.
        exclusive: by which `reset`, `set_control` and `step` refuse a second user.
    """

    batch_shape: tuple[int, ...] = ()
    coordinates: Coordinates
    actuation: Actuation
    limits: Limits
    groups: Groups | None = None
    plant_tips: bool = True
    plant_limits: Limits
    active: ActiveDisturbances | None = None
    watch: Callable[[AnyPhysics], object] | None = None
    exclusive: Exclusive

    def _attach(
        self,
        model: mujoco.MjModel,
        state: Callable[[str], np.ndarray],
        field: Callable[[str], np.ndarray],
        undisturbed: ArmParameters,
    ) -> None:
        """Connects to MuJoCo's memory: arrays of states and model fields by its names."""
        self._qpos_index, self._qvel_index = paper_order(model)
        # Views of MuJoCo's memory, kept because looking them up costs as much as a small product;
        # of those that are read the coordinate is the first axis.
        self._qpos, self._qvel = state("qpos").T, state("qvel").T
        self._ctrl, self._added = state("ctrl"), state("qfrc_applied").T
        self._fields = PlantFields(model, field)
        self._describe(undisturbed, float(model.opt.timestep), rest_of(model))

    def _describe(self, undisturbed: ArmParameters, timestep: float, rest: np.ndarray) -> None:
        """Takes what is the same in every episode; an arm hangs at `rest`, shape (2N,)."""
        self._timestep, self._undisturbed = timestep, undisturbed
        self.plant_limits = Limits.of(undisturbed)
        self._rest = self._alike(rest)
        self.exclusive = Exclusive()
        self._look_at(undisturbed)

    def see_through(self, groups: Groups) -> None:
        """Measures and drives the plant, which is that of these groups, through them."""
        self.groups = groups
        self._look_at(groups.arm)

    def _look_at(self, arm: ArmParameters) -> None:
        """Takes the coordinates, limits and inputs of what is measured; the arm is undisturbed."""
        self.coordinates = planar_coordinates(arm.modules)
        self.limits = Limits.of(arm)
        self._input_range = arm.input_bounds(self.batch_shape)
        self._zero = self._alike(np.zeros(arm.coordinates))
        self._zero.setflags(write=False)
        self._forget()

    @abc.abstractmethod
    def _advance(self) -> None:
        """One physics step of all arms within their limits."""

    @abc.abstractmethod
    def _check_limits(self) -> None:
        """Freezes arms whose state is outside their limits."""

    @abc.abstractmethod
    def _follow_inertias(self) -> None:
        """Makes MuJoCo's constants follow inertias that were written."""

    def divergence(self) -> str:
        """How an arm alone has left its limits and when; empty if it has not, and for a batch."""
        if self.batch_shape:
            return ""
        violation = self.limits.violation(self.q(), self.v())
        if not violation and self.groups is not None:
            violation = self.plant_limits.violation(self.plant_q(), self.plant_v())
            violation = violation and f"the plant's {violation}"
        return violation and f"diverged at t = {self.time():.6g} s: {violation}"

    def q(self) -> np.ndarray:
        """Generalised coordinates, shape (..., 2N) [m], [rad]."""
        q = self.plant_q()
        return q if self.groups is None else self.groups.measured(q)

    def v(self) -> np.ndarray:
        """Generalised velocities, shape (..., 2N) [m/s], [rad/s]."""
        v = self.plant_v()
        return v if self.groups is None else self.groups.rates(v)

    def readings(self) -> tuple[np.ndarray, np.ndarray]:
        """`q` and `v` as sensors without faults read them, each of shape (..., 2N)."""
        q, v = self.plant_q(), self.plant_v()
        return (q, v) if self.groups is None else plates.readings(self.groups, q, v)

    def reads_truth(self) -> bool:
        """Whether what is read is `q` and `v`."""
        faulty = self.active is not None and bool(self.active.sensors)
        return not faulty and (self.groups is None or self.groups.sensing == SUMS)

    def plant_q(self) -> np.ndarray:
        """Coordinates of all modules of the plant, shape (..., 2N) [m], [rad]."""
        return self._qpos.take(self._qpos_index, 0).T

    def plant_v(self) -> np.ndarray:
        """Velocities of all modules of the plant, shape (..., 2N) [m/s], [rad/s]."""
        return self._qvel.take(self._qvel_index, 0).T

    def plant_place(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """`plant_q` and `plant_tip` of an `Instant`, shapes (..., 2K) and (..., 2) [m], [rad]."""
        if self.groups is None:
            return None, None
        q = self.plant_q()
        return q, self.groups.tip(q) if self.plant_tips else None

    def tau(self) -> np.ndarray:
        """The input forces being held, shape (..., 2N) [N]."""
        return self._tau.copy(order="K")

    def received(self) -> np.ndarray:
        """The input forces that reached the arms in the last physics step, shape (..., 2N) [N]."""
        return self._received.copy(order="K")

    def within(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """The m > 1 physics steps of the last `step`; those that no arm was left for are alike.

        They are `q`, `received` and `plant_tip` of an `octarm.interfaces.Within`, shapes (m, ...,
        2N), (m, ..., 2N) and (m, ..., 2).
        """
        q, received, *tip = self._within
        return q, received, tip[0] if tip else None

    def reachable_inputs(self) -> tuple[np.ndarray, np.ndarray]:
        """The input range, narrowed by this episode's disturbances, each of shape (..., 2N) [N]."""
        low, high = self.input_range()
        for bound in () if self.active is None else self.active.input_bounds:
            low, high = np.maximum(low, -np.asarray(bound)), np.minimum(high, bound)
        return low, high

    def added(self) -> np.ndarray:
        """Generalised force that MuJoCo was given in the last physics step, shape (..., 2N)."""
        added = self._added.take(self._qvel_index, 0).T
        return added if self.groups is None else self.groups.mean_force(added)

    def disturbance(self) -> np.ndarray:
        """Generalised force that was added, mean over the last `step`, shape (..., 2N)."""
        return self._disturbance.copy(order="K")

    def input_range(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest input forces, each of shape (..., 2N) [N]."""
        low, high = self._input_range
        return low.copy(order="K"), high.copy(order="K")

    def hanging(self) -> np.ndarray:
        """The loaded equilibrium of the undisturbed arms, shape (..., 2N) [m], [rad]."""
        return self.plant_rest() if self.groups is None else self.groups.measured(self._rest)

    def plant_rest(self) -> np.ndarray:
        """The same of all modules of the plants, shape (..., 2N) [m], [rad]."""
        return self._rest.copy(order="K")

    def intact(self) -> np.ndarray:
        """Which arms are still within their limits, shape (...) of bool."""
        return self._intact.copy()

    def all_intact(self) -> bool:
        """Whether every arm is still within its limits."""
        return self._all_intact

    def all_lost(self) -> bool:
        """Whether no arm is within its limits any more."""
        return not (self._all_intact or self._intact.any())

    def diverged_at(self) -> np.ndarray:
        """When arms left their limits, shape (...) [s]; NaN for those that have not."""
        return self._diverged_at.copy()

    def steps(self) -> int:
        """Number of physics steps since the start."""
        return self._steps

    def time(self) -> float:
        """Time since the start [s]: the number of steps times their length."""
        return self._steps * self._timestep

    def timestep(self) -> float:
        """Physics step [s]."""
        return self._timestep

    def set_motion(self, q: np.ndarray, v: np.ndarray) -> None:
        """Places the plants at q, shape (..., 2N) [m], [rad], moving with v [m/s], [rad/s]."""
        self._qpos[self._qpos_index] = q.T
        self._qvel[self._qvel_index] = v.T

    def set_control(self, control: np.ndarray) -> None:
        """Holds tau, shape (..., 2N) [N], until the next call; OctarmError for another shape."""
        with self.exclusive:
            shape = self._zero.shape
            try:
                tau = np.array(control, dtype=np.float64)
            except (TypeError, ValueError):
                what = f"the action is {quoted(control)}; it must be an array of numbers"
                raise OctarmError(what) from None
            if tau.shape != shape:
                raise OctarmError(f"the action has shape {tau.shape}; it must be {shape}")
            self._tau, self._possible = tau, self._within_range(tau)

    @contextlib.contextmanager
    def reset_context(self) -> Generator[AnyPhysics]:
        """Around the start of an episode; see dm_control's Physics."""
        with self.exclusive.anew(), super().reset_context():
            yield self

    def begin(self, active: ActiveDisturbances) -> None:
        """Starts an episode under these disturbances, the arms standing where they were placed."""
        self.active = active
        self._write(active.plant(self._steps))
        active.record(0, *self.readings())
        if self.watch is not None:
            self.watch(self)

    def freeze(self, arms: np.ndarray | bool) -> None:
        """Marks arms, shape (...) of bool, as diverged: they stay as they are."""
        lost = self._intact & arms
        if np.count_nonzero(lost):
            self._diverged_at[lost] = self.time()
            self._intact[lost] = False
            self._all_intact = False

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances by physics steps under Q = F(q) tau, q being the true coordinates at any time.

        An arm stops at its first state outside the limits. It ends early when no arm is left.
        """
        self._disturbance = self._zero
        within: Sequence[np.ndarray] = ()
        seen: np.ndarray | None = None  # q, where it was computed already
        if n_sub_steps > 1:
            within = self._within = self._memory(n_sub_steps)
        for i in range(n_sub_steps):
            self._receive(n_sub_steps)
            if within:
                within[0][i] = self.q() if seen is None else seen
                within[1][i] = self._received
                if self.groups is not None and self.plant_tips:
                    within[2][i] = self.groups.tip(self.plant_q())
            self._advance()
            self._steps += 1
            if self.active is not None and self.active.sensors:
                self.active.record(self._steps, *self.readings())
            if self.watch is not None:
                self.watch(self)
            self._check_limits()
            if self.groups is not None:
                seen = self.q()
                q, v = np.atleast_2d(seen, self.v())
                self.freeze(~self.limits.holding(q, v).reshape(self.batch_shape))
            if self.all_lost():
                for rows in within:
                    rows[i + 1 :] = rows[i]
                return

    def _memory(self, steps: int) -> list[np.ndarray]:
        tips = self.groups is not None and self.plant_tips
        like = [self._zero] * 2 + [self._zero[..., :2]] * tips
        return [stacked(row, steps) for row in like]

    def _receive(self, nstep: int) -> None:
        received, active = self._possible, self.active
        middle = q = self._zero
        if self.groups is not None or (active is not None and active.forces):
            middle = self._middle()
            q = middle if self.groups is None else self.groups.measured(middle)
        if active is not None:
            self._write(active.plant(self._steps))
            if active.actuators:
                received = self._within_range(active.received(self._steps, received))
            if active.forces:
                self._added[self._qvel_index] = active.force(self._steps, q, middle).T
                mean = active.measured_force / nstep
                if not self._all_intact:
                    mean = np.where(self._intact[..., None], mean, 0.0)
                self._disturbance = self._disturbance + mean
        self._received = received
        if self.groups is None:
            self._ctrl[...] = self.actuation.ctrl(received)
        else:
            self._ctrl[...] = self.groups.ctrl(self.actuation.force(q, received))

    def _middle(self) -> np.ndarray:
        """Where the plants will be in the middle of a step, shape (..., 2N) [m], [rad]."""
        # Taken at its start, forces that depend on q would be late: of first order in the step.
        return self.plant_q() + (0.5 * self._timestep) * self.plant_v()

    def _within_range(self, tau: np.ndarray) -> np.ndarray:
        low, high = self._input_range
        return np.minimum(np.maximum(tau, low), high)

    def _write(self, plant: Plant | None) -> None:
        """Makes the plants these, if they have changed."""
        if plant is not None and self._fields.write(plant.parameters, plant.gravity_angle):
            self._follow_inertias()

    def _forget(self) -> None:
        """Undoes what the last episode has changed, MuJoCo's own state aside."""
        if self.active is not None and self.active.plant_changes:
            self._write(Plant(self._undisturbed))
        self.active = None
        self._tau = self._possible = self._received = self._disturbance = self._zero
        self._within = self._memory(1)
        self._steps = 0
        self._intact = np.ones(self.batch_shape, dtype=bool)
        self._diverged_at = np.full(self.batch_shape, np.nan)
        self._all_intact = True

    def _alike(self, row: np.ndarray) -> np.ndarray:
        """The same row for every arm, shape (..., k), contiguous along the arms."""
        shape = (len(row), *self.batch_shape)
        return np.broadcast_to(row.reshape(-1, *[1] * len(self.batch_shape)), shape).copy().T
