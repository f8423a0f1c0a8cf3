"""The arm as MuJoCo steps it, behind a few methods."""
# pyright: reportAttributeAccessIssue=false, reportIncompatibleMethodOverride=false
# (mujoco ships no type stubs, dm_control few annotations)

from __future__ import annotations

import warnings

import mujoco
import numpy as np

from octarm.actuation import Actuation, GroundedActuation
from octarm.limits import Limits
from octarm.model import coordinate_names, paper_order
from octarm.parameters import ArmParameters

with warnings.catch_warnings():  # without a display, glfw complains although nothing is drawn
    warnings.simplefilter("ignore")
    from dm_control import mujoco as dm_mujoco
    from dm_control.mujoco import wrapper


class ArmPhysics(dm_mujoco.Physics):
    """One arm behind dm_control's Physics, driven by the paper's input forces tau."""

    actuation: Actuation
    limits: Limits

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
        tip = model.sensor("tip_position").adr[0]
        self._tip = data.ptr.sensordata[tip : tip + 3]
        self._tau = np.zeros(model.nu)
        self._intact = True
        arm = ArmParameters.from_model(model)
        self.limits = Limits.of(arm)
        self.actuation = GroundedActuation(arm.width)

    def __getstate__(self) -> tuple:
        return super().__getstate__(), self.actuation, self._tau

    def __setstate__(self, state: tuple) -> None:
        data, actuation, tau = state
        super().__setstate__(data)
        self.actuation, self._tau = actuation, tau

    def copy(self, share_model: bool = False) -> ArmPhysics:
        """A physics in the same state, with the same actuation and inputs."""
        other = super().copy(share_model)
        other.actuation, other._tau = self.actuation, self._tau.copy()
        return other

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
        """Back to the model's defaults or a keyframe, with no input."""
        super().reset(keyframe_id)
        self._tau = np.zeros(self.model.nu)
        self._intact = True

    def step(self, nstep: int = 1) -> None:
        """Advances by `nstep` physics steps under Q = F(q) tau, q being the true coordinates.

        It stops at the first state outside the limits, and goes on from no such state.

        Raises:
            PhysicsError: when MuJoCo reports a bad state; the state is never reset.
        """
        model, data = self.model.ptr, self.data.ptr
        q = self.q()
        with self.check_invalid_state():
            for _ in range(nstep):
                self._ctrl[:] = self.actuation.tendon_forces(q, self._tau)
                mujoco.mj_step(model, data)
                q = self.q()
                self._intact = self.limits.hold(q, self.v())
                if not self._intact:
                    return
            mujoco.mj_step1(model, data)  # sensors of the new state

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
