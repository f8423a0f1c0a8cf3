"""Many arms as MuJoCo steps them on threads, behind the methods of the single arm."""
# pyright: reportAttributeAccessIssue=false, reportIncompatibleMethodOverride=false
# (mujoco ships no type stubs, dm_control few annotations)

from __future__ import annotations

import contextlib
from collections.abc import Generator

import mujoco
import numpy as np
from dm_control.rl import control
from mujoco.batch import Batch

from octarm.arm.actuation import Actuation
from octarm.arm.kinematics import plate_entries
from octarm.arm.limits import Limits
from octarm.arm.mjcf import PlantFields, build_model, paper_order
from octarm.arm.parameters import ArmParameters
from octarm.arrays import Entry, split
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Plant


class BatchPhysics(control.Physics):
    """n arms, each of which gives bit for bit what it gives alone.

    Arrays of coordinates have shape (n, 2N), and the arms' axis is contiguous in memory: a column
    of coordinate j is one run of memory. An arm that leaves its limits is frozen where it is; the
    others go on.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        arms: int,
        actuation: Actuation,
        *,
        parameters: ArmParameters | None = None,
        threads: int = 1,
    ) -> None:
        """Physics for a model of `build_model`.

        Args:
            model: of the arms.
            arms: their number n.
            actuation: how inputs act on them.
            parameters: the arms' own, with batch axis (n,), where they differ from the model's.
            threads: number of threads; results do not depend on it.
        """
        own = parameters if parameters is not None and parameters.batch_shape else None
        self.batch = Batch(model, arms, threads)
        self._undisturbed = own or ArmParameters.from_model(model)
        self.limits = Limits.of(self._undisturbed)
        self.actuation = actuation
        self.acting: ActiveDisturbances | None = None
        self._qpos_index, self._qvel_index = paper_order(model)
        self._qpos, self._qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self._ctrl, self._added = self.batch.bind("ctrl"), self.batch.bind("qfrc_applied")
        self._fields = PlantFields(model, self.batch.expand)
        self._timestep = float(model.opt.timestep)
        self._input_limit = _columns(arms, model.actuator_ctrlrange[:, 1])
        self._rest = _columns(arms, _rest(model))
        if own is not None:
            self._fields.write(own)
            self.batch.set_const()
            for i in range(arms):
                self._rest[i] = _rest(build_model(own.arm(i), self._timestep))
        self.reset()

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Batch axes of the arrays: (n,)."""
        return (self.arms,)

    @property
    def arms(self) -> int:
        """Number of arms n."""
        return self.batch.nsim

    def q(self) -> np.ndarray:
        """Generalised coordinates, shape (n, 2N) [m], [rad]; a copy."""
        return self._q.copy(order="K")

    def v(self) -> np.ndarray:
        """Generalised velocities, shape (n, 2N) [m/s], [rad/s]; a copy."""
        return self._v.copy(order="K")

    def tau(self) -> np.ndarray:
        """The input forces being held, shape (n, 2N) [N]; a copy."""
        return self._tau.copy(order="K")

    def received(self) -> np.ndarray:
        """The input forces that reached the arms in the last physics step, shape (n, 2N) [N]."""
        return self._received.copy(order="K")

    def disturbance(self) -> np.ndarray:
        """Generalised force that was added, mean over the last `step`, shape (n, 2N)."""
        return self._disturbance.copy(order="K")

    def tip_position(self) -> np.ndarray:
        """Tips in the world frame, shape (n, 3) [m]; a copy."""
        return tip_position(self._q)

    def input_limit(self) -> np.ndarray:
        """Bound on the absolute input forces tau, shape (n, 2N) [N]."""
        return self._input_limit.copy(order="K")

    def hanging(self) -> np.ndarray:
        """The loaded equilibrium of the model, shape (n, 2N) [m], [rad]; a copy."""
        return self._rest.copy(order="K")

    def set_motion(self, q: np.ndarray, v: np.ndarray) -> None:
        """Places the arms at q, shape (n, 2N) [m], [rad], moving with v [m/s], [rad/s]."""
        self._qpos[:, self._qpos_index] = q
        self._qvel[:, self._qvel_index] = v
        self._read_state()

    def set_control(self, control: np.ndarray) -> None:
        """Holds the input forces tau, shape (n, 2N) [N], until the next call."""
        self._tau = control.copy(order="K")

    def begin(self, acting: ActiveDisturbances) -> None:
        """Starts an episode under these disturbances, the arms standing where they were placed."""
        self.acting = acting
        self._change(acting)
        acting.record(0, self._q, self._v)

    def freeze(self, arms: np.ndarray) -> None:
        """Marks arms, shape (n,) of bool, as diverged: they stay as they are."""
        self._diverged_at[arms & self._intact] = self.time()
        self._intact &= ~arms

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances by physics steps under Q = F(q) tau, q being the true coordinates."""
        self._disturbance = np.zeros_like(self._tau)
        with np.errstate(all="ignore"):  # a frozen arm may hold anything
            for _ in range(n_sub_steps):
                self._receive(self._q, n_sub_steps)
                self.batch.step(None if self._intact.all() else np.flatnonzero(self._intact))
                self._steps += 1
                self._read_state()
                if self.acting is not None:
                    self.acting.record(self._steps, self._q, self._v)
                self.freeze(~self.limits.holding(self._q, self._v))
        if self.batch.warning.any():  # MuJoCo refused a state or an input of some arms
            self.freeze(np.any(self.batch.warning, axis=(1, 2)))

    def intact(self) -> np.ndarray:
        """Which arms are still within their limits, shape (n,) of bool; a copy."""
        return self._intact.copy()

    def divergence(self) -> str:
        """Empty: arms of a batch diverge one by one, see `intact`."""
        return ""

    def wildest(self) -> str:
        """Empty, as above."""
        return ""

    def diverged_at(self) -> np.ndarray:
        """When arms left their limits, shape (n,) [s]; NaN for those that have not."""
        return self._diverged_at.copy()

    def steps(self) -> int:
        """Number of physics steps since the start."""
        return self._steps

    def time(self) -> float:
        """Time since the start [s]."""
        return self._steps * self._timestep

    def timestep(self) -> float:
        """Physics step [s]."""
        return self._timestep

    def reset(self) -> None:
        """All arms to the undisturbed model's defaults, with no input."""
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        if self.acting is not None and self.acting.plant_changes:
            self._write(Plant(self._undisturbed))
        self.acting = None
        self._tau = self._received = np.zeros_like(self._rest)
        self._disturbance = np.zeros_like(self._rest)
        self._intact = np.ones(self.arms, dtype=bool)
        self._diverged_at = np.full(self.arms, np.nan)
        self._steps = 0
        self._read_state()

    def after_reset(self) -> None:
        """Nothing is derived from the state."""

    @contextlib.contextmanager
    def reset_context(self) -> Generator[BatchPhysics]:
        """Resets, and lets the block place the arms."""
        self.reset()
        yield self

    def _read_state(self) -> None:
        """Takes the coordinates and velocities over from MuJoCo."""
        self._q = self._qpos.T.take(self._qpos_index, axis=0).T
        self._v = self._qvel.T.take(self._qvel_index, axis=0).T
        for array in (self._q, self._v):
            array.setflags(write=False)

    def _receive(self, q: np.ndarray, nstep: int) -> None:
        """What acts during the next physics step, q being the coordinates at its start."""
        self._received, acting = self._tau, self.acting
        if acting is not None:
            self._change(acting)
            self._received = acting.received(self._steps, self._tau)
            if acting.forces:
                force = acting.force(self._steps, q)
                self._added[:, self._qvel_index] = force
                added = force / nstep
                if not self._intact.all():
                    added = np.where(self._intact[:, None], added, 0.0)
                self._disturbance += added
        self._ctrl[:] = self.actuation.tendon_forces(q, self._received)

    def _change(self, acting: ActiveDisturbances) -> None:
        """Lets the plants follow their disturbances."""
        plant = acting.plant(self._steps)
        if plant is not None:
            self._write(plant)

    def _write(self, plant: Plant) -> None:
        """Makes the plants these."""
        if self._fields.write(plant.parameters, plant.gravity_angle):
            self.batch.set_const()


def tip_position(q: np.ndarray) -> np.ndarray:
    """The tip of an arm at q, shape (..., 2N) [m], [rad], in the world frame, shape (..., 3) [m].

    It is `world_position` of the last of `positions`, worked out entry by entry along the batch.
    """
    x: Entry = 0.0
    y: Entry = 0.0
    for length, (cos, sin) in zip(split(q), plate_entries(q), strict=False):
        x, y = x + length * cos, y + length * sin
    out = np.zeros_like(q, shape=(*q.shape[:-1], 3))
    out[..., 0], out[..., 2] = y, -x
    return out


def _rest(model: mujoco.MjModel) -> np.ndarray:
    """The loaded equilibrium in the paper's order, shape (2N,)."""
    return model.key("hanging").qpos[paper_order(model)[0]]


def _columns(arms: int, row: np.ndarray) -> np.ndarray:
    """The same row for every arm, shape (n, len(row)), contiguous along the arms."""
    return np.repeat(np.asarray(row)[:, None], arms, axis=1).T
