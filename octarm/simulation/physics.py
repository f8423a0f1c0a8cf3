"""The arm as MuJoCo steps it, behind a few methods."""
# pyright: reportUnknownMemberType=false
# (the base class, dm_control's Physics, has no types)

from __future__ import annotations

import copy
import logging
import operator
import warnings
from collections.abc import Callable
from typing import Any, cast

import mujoco
import numpy as np

from octarm.arm.actuation import Actuation, GroundedActuation
from octarm.arm.limits import Limits
from octarm.arm.mjcf import PlantFields, coordinate_names, paper_order
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Plant

with warnings.catch_warnings():  # without a display, glfw complains although nothing is drawn
    warnings.simplefilter("ignore")
    from dm_control import mujoco as dm_mujoco
    from dm_control.mujoco import wrapper

# dm_control logs each warning of MuJoCo, which also ends the run or freezes the arm of a batch.
logging.getLogger("absl").addFilter(lambda record: record.funcName != "_warning_callback")


class ArmPhysics(dm_mujoco.Physics):
    """One arm behind dm_control's Physics, driven by the paper's input forces tau."""

    actuation: Actuation
    limits: Limits
    acting: ActiveDisturbances | None = None  # what disturbs this episode
    # Called when an episode begins, and after every physics step.
    watch: Callable[[ArmPhysics], object] | None = None

    @classmethod
    def from_arm_model(
        cls, model: mujoco.MjModel, actuation: Actuation | None = None
    ) -> ArmPhysics:
        """Physics for a model of `build_model`; `actuation` defaults to the paper's F_coeff."""
        physics = cls(wrapper.MjData(wrapper.MjModel(model)))
        if actuation is not None:
            physics.actuation = actuation
        return physics

    def _reload_from_data(self, data: wrapper.MjData) -> None:
        super()._reload_from_data(data)
        model = self.model.ptr
        self._qpos_index, self._qvel_index = paper_order(model)
        # Views of MuJoCo's memory, kept because looking them up costs as much as a small product.
        self._qpos, self._qvel, self._ctrl = data.ptr.qpos, data.ptr.qvel, data.ptr.ctrl
        self._added = data.ptr.qfrc_applied
        tip = model.sensor("tip_position").adr[0]
        self._tip = data.ptr.sensordata[tip : tip + 3]
        self._fields = PlantFields(model, lambda name: operator.attrgetter(name)(model))
        self._tau = np.zeros(model.nu)
        self._received = self._tau
        self._disturbance = np.zeros(model.nu)
        self._steps = 0
        self._intact = True
        self._undisturbed = ArmParameters.from_model(model)
        self.limits = Limits.of(self._undisturbed)
        self.actuation = GroundedActuation(self._undisturbed.width)

    def __getstate__(self) -> tuple[Any, dict[str, Any]]:
        return cast("Any", super().__getstate__()), self._episode()

    def __setstate__(self, state: tuple[Any, dict[str, Any]]) -> None:
        data, episode = state
        super().__setstate__(data)
        self.__dict__.update(episode)

    def copy(self, share_model: bool = False) -> ArmPhysics:
        """A physics in the same state, with the same actuation, inputs and disturbances.

        The model is shared only when asked for and when no disturbance changes it.
        """
        changing = self.acting is not None and self.acting.plant_changes
        other = cast("ArmPhysics", super().copy(share_model and not changing))
        other.__dict__.update(copy.deepcopy(self._episode()))
        return other

    def _episode(self) -> dict[str, Any]:
        """What an episode consists of beside MuJoCo's own data."""
        inputs = ("_tau", "_received", "_disturbance")
        names = ("actuation", "acting", "limits", "_undisturbed", *inputs, "_steps", "_intact")
        return {name: getattr(self, name) for name in names}

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Batch axes of the arrays: none."""
        return ()

    def q(self) -> np.ndarray:
        """Generalised coordinates, shape (2N,) [m], [rad]; a copy."""
        return self._qpos.take(self._qpos_index)

    def v(self) -> np.ndarray:
        """Generalised velocities, shape (2N,) [m/s], [rad/s]; a copy."""
        return self._qvel.take(self._qvel_index)

    def tau(self) -> np.ndarray:
        """The input forces being held, shape (2N,) [N]; a copy."""
        return self._tau.copy()

    def tip_position(self) -> np.ndarray:
        """Tip in the world frame, shape (3,) [m]; a copy."""
        return self._tip.copy()

    def input_limit(self) -> np.ndarray:
        """Bound on the absolute input forces tau, shape (2N,) [N]."""
        return self.model.actuator_ctrlrange[:, 1].copy()

    def hanging(self) -> np.ndarray:
        """The loaded equilibrium, shape (2N,) [m], [rad]; a copy."""
        return self.model.ptr.key("hanging").qpos[self._qpos_index]

    def set_motion(self, q: np.ndarray, v: np.ndarray) -> None:
        """Places the arm at q, shape (2N,) [m], [rad], moving with v [m/s], [rad/s]."""
        self._qpos[self._qpos_index] = q
        self._qvel[self._qvel_index] = v

    def set_control(self, control: np.ndarray) -> None:
        """Holds the input forces tau, shape (2N,) [N], until the next call."""
        self._tau = np.array(control, dtype=np.float64)

    def reset(self, keyframe_id: int | None = None) -> None:
        """Back to the undisturbed model's defaults or a keyframe, with no input."""
        super().reset(keyframe_id)
        if self.acting is not None and self.acting.plant_changes:
            self._write(Plant(self._undisturbed))
        self.acting = None
        self._tau = self._received = np.zeros(self.model.nu)
        self._disturbance = np.zeros(self.model.nu)
        self._steps = 0
        self._intact = True

    def begin(self, acting: ActiveDisturbances) -> None:
        """Starts an episode under these disturbances, the arm standing where it was placed."""
        self.acting = acting
        self._change(acting)
        acting.record(0, self.q(), self.v())
        if self.watch is not None:
            self.watch(self)

    def step(self, nstep: int = 1) -> None:
        """Advances by `nstep` physics steps under Q = F(q) tau, q being the true coordinates.

        It stops at the first state outside the limits, and goes on from no such state.

        Raises:
            PhysicsError: when MuJoCo reports a bad state; the state is never reset.
        """
        model, data = self.model.ptr, self.data.ptr
        self._disturbance = np.zeros(model.nu)
        q = self.q()
        with self.check_invalid_state():
            for _ in range(nstep):
                self._receive(q, nstep)
                mujoco.mj_step(model, data)
                self._steps += 1
                q, v = self.q(), self.v()
                if self.acting is not None:
                    self.acting.record(self._steps, q, v)
                if self.watch is not None:
                    self.watch(self)
                self._intact = self.limits.hold(q, v)
                if not self._intact:
                    return
            mujoco.mj_step1(model, data)  # sensors of the new state

    def steps(self) -> int:
        """Number of physics steps since the start."""
        return self._steps

    def received(self) -> np.ndarray:
        """The input forces that reached the arm in the last physics step, shape (2N,) [N]."""
        return self._received.copy()

    def added(self) -> np.ndarray:
        """Generalised force that MuJoCo was given in the last physics step, shape (2N,)."""
        return self._added.take(self._qvel_index)

    def plant(self) -> Plant:
        """The arm as it is in MuJoCo's model: its parameters, and where gravity points."""
        model = self.model.ptr
        x, _, z = model.opt.gravity
        return Plant(ArmParameters.from_model(model), np.arctan2(x, -z))

    def disturbance(self) -> np.ndarray:
        """Generalised force that was added, mean over the last `step`, shape (2N,) [N], [N m]."""
        return self._disturbance.copy()

    def intact(self) -> bool:
        """Whether the last step left the arm within its limits."""
        return self._intact

    def divergence(self) -> str:
        """How the arm has left its limits and when, as a sentence; empty while it is intact."""
        violation = self.limits.violation(self.q(), self.v())
        return f"diverged at t = {self.time():.6g} s: {violation}" if violation else ""

    def wildest(self) -> str:
        """The coordinate that accelerates most; NaN counts as most."""
        acceleration = np.abs(self.data.qacc[self._qvel_index])
        n = len(acceleration) // 2
        return coordinate_names(n)[int(np.argmax(np.nan_to_num(acceleration, nan=np.inf)))]

    def integration_state(self) -> np.ndarray:
        """All that the next step depends on (mjSTATE_INTEGRATION), shape (n,)."""
        return self.get_state(mujoco.mjtState.mjSTATE_INTEGRATION.value)

    def _receive(self, q: np.ndarray, nstep: int) -> None:
        """What acts during the next physics step, q being the coordinates at its start."""
        self._received, acting = self._tau, self.acting
        if acting is not None:
            self._change(acting)
            self._received = acting.received(self._steps, self._tau)
            if acting.forces:
                force = acting.force(self._steps, q)
                self._added[self._qvel_index] = force
                self._disturbance += force / nstep
        self._ctrl[:] = self.actuation.tendon_forces(q, self._received)

    def _change(self, acting: ActiveDisturbances) -> None:
        """Lets the plant follow its disturbances."""
        plant = acting.plant(self._steps)
        if plant is not None:
            self._write(plant)

    def _write(self, plant: Plant) -> None:
        """Makes the plant this one."""
        if self._fields.write(plant.parameters, plant.gravity_angle):
            mujoco.mj_setConst(self.model.ptr, mujoco.MjData(self.model.ptr))
