"""Arms as MuJoCo steps them: one behind dm_control's Physics, or many side by side."""
# pyright: reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportIncompatibleMethodOverride=false
# (mujoco ships no type stubs, the base class, dm_control's Physics, has no types)

from __future__ import annotations

import copy
import logging
import operator
import warnings
from typing import Any, cast

import mujoco
import numpy as np
from dm_control.rl import control
from mujoco.batch import Batch

from octarm.arm.actuation import Actuation, GroundedActuation
from octarm.arm.kinematics import tip_position
from octarm.arm.mjcf import build_slim_model, read_parameters, rest_of
from octarm.arm.parameters import ArmParameters
from octarm.arrays import coordinate_names
from octarm.disturbances.episode import Plant
from octarm.simulation.stepping import AnyPhysics

with warnings.catch_warnings():  # without a display, glfw complains although nothing is drawn
    warnings.simplefilter("ignore")
    from dm_control import mujoco as dm_mujoco
    from dm_control.mujoco import wrapper

# dm_control logs each warning of MuJoCo, which also ends the run or freezes the arm of a batch.
logging.getLogger("absl").addFilter(lambda record: record.funcName != "_warning_callback")

_INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION.value
_EPISODE = ("actuation", "active", "limits", "plant_limits", "_model_limits", "groups",
            "coordinates", "_undisturbed", "_input_range", "_zero", "_tau", "_possible",
            "_received", "_disturbance", "_steps", "_intact", "_diverged_at",
            "_all_intact")  # fmt: skip


class ArmPhysics(AnyPhysics, dm_mujoco.Physics):
    """One arm, which dm_control can draw and whose data have names."""

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
        self._attach(
            model,
            lambda name: getattr(data.ptr, name),
            lambda name: operator.attrgetter(name)(model),
            read_parameters(model),
        )
        self._model_limits = self.plant_limits.reordered(self._qpos_index)  # as MuJoCo orders them
        tip = model.sensor("tip_position").adr[0]
        self._state_size = mujoco.mj_stateSize(model, _INTEGRATION)
        self._tip = data.ptr.sensordata[tip : tip + 3]
        self.actuation = GroundedActuation(self._undisturbed.widths)

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
        changing = self.active is not None and self.active.plant_changes
        other = cast("ArmPhysics", super().copy(share_model and not changing))
        other.__dict__.update(copy.deepcopy(self._episode()))
        return other

    def _episode(self) -> dict[str, Any]:
        """What belongs to an episode, MuJoCo's own data aside."""
        return {name: getattr(self, name) for name in _EPISODE}

    def reset(self, keyframe_id: int | None = None) -> None:
        """Back to the undisturbed model's defaults or a keyframe, with no input."""
        with self.exclusive.anew():
            super().reset(keyframe_id)
            self._forget()

    def step(self, nstep: int = 1) -> None:
        """Advances by `nstep` physics steps; see `AnyPhysics.step`.

        Raises PhysicsError when MuJoCo reports a bad state; the state is never reset.
        """
        with self.exclusive:
            before = self._warnings.tolist()
            super().step(nstep)
            if self._all_intact:
                mujoco.mj_step1(self.model.ptr, self.data.ptr)  # sensors of the new state
            if self._warnings.tolist() != before:
                self._refuse_state(before)

    def _advance(self) -> None:
        mujoco.mj_step(self.model.ptr, self.data.ptr)

    def _check_limits(self) -> None:
        if not self._model_limits.hold(self._qpos, self._qvel):
            self.freeze(True)

    def _follow_inertias(self) -> None:
        mujoco.mj_setConst(self.model.ptr, mujoco.MjData(self.model.ptr))

    def tip_position(self) -> np.ndarray:
        """Tip in the world frame by MuJoCo's sensor, shape (3,) [m]."""
        return self._tip.copy()

    def plant(self) -> Plant:
        """The arm as it is in MuJoCo's model."""
        gravity = self.model.ptr.opt.gravity
        angle = float(np.arctan2(gravity[0], -gravity[2]))
        return Plant(read_parameters(self.model.ptr), angle)

    def integration_state(self) -> np.ndarray:
        """All that the next step depends on (mjSTATE_INTEGRATION), shape (k,)."""
        state = np.empty(self._state_size)
        mujoco.mj_getState(self.model.ptr, self.data.ptr, state, _INTEGRATION)
        return state

    def _refuse_state(self, before: list[int]) -> None:
        """Raises PhysicsError because MuJoCo has counted more warnings than before."""
        counts, self._warnings[:] = self._warnings.copy(), before
        try:
            with self.check_invalid_state():
                self._warnings[:] = counts
        except control.PhysicsError as error:
            self.freeze(True)
            raise control.PhysicsError(f"{self._wildest()} most, {error}") from None

    def _wildest(self) -> str:
        """The coordinate that accelerates most; NaN counts as most."""
        acceleration = np.abs(self.data.qacc[self._qvel_index])
        names = coordinate_names(len(acceleration) // 2)
        return names[int(np.argmax(np.nan_to_num(acceleration, nan=np.inf)))]


class BatchPhysics(AnyPhysics):
    """n arms, each of which gives bit for bit what it gives alone.

    An arm that leaves its limits is frozen where it is; the others go on.
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
        """Physics of so many arms, stepped by threads, on which results do not depend.

        Parameters with batch axis (n,) take the place of the model's.
        """
        each = parameters if parameters is not None and parameters.batch_shape else None
        self.batch = Batch(model, arms, threads)
        self.batch_shape = (arms,)
        self.actuation = actuation
        undisturbed = each or read_parameters(model)
        self._attach(model, self.batch.bind, self.batch.expand, undisturbed)
        if each is not None:
            self._fields.write(each)
            self.batch.set_const()
            for i in range(arms):
                self._rest[i] = rest_of(build_slim_model(each.arm(i), self._timestep))
        self.reset()

    @property
    def arms(self) -> int:
        """Number of arms n."""
        return self.batch.nsim

    def tip_position(self) -> np.ndarray:
        """Tips in the world frame, shape (n, 3) [m]."""
        return tip_position(self.plant_q(), self._undisturbed.entries.tip_length)

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances by physics steps; see `AnyPhysics.step`."""
        with self.exclusive, np.errstate(all="ignore"):  # a frozen arm may hold anything
            super().step(n_sub_steps)
            if self.batch.warning.any():  # MuJoCo refused a state or an input of some arms
                self.freeze(np.any(self.batch.warning, axis=(1, 2)))

    def reset(self) -> None:
        """All arms to the undisturbed model's defaults, with no input."""
        with self.exclusive.anew():
            self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
            self._forget()

    def after_reset(self) -> None:
        """Nothing is derived from the state."""

    def driven(self, ctrl: np.ndarray, added: np.ndarray, alive: np.ndarray) -> np.ndarray:
        """One physics step of the arms that are alive; which are not within their limits then.

        It is for another physics that has these arms and what acts on them: `ctrl` of the model,
        shape (n, 4N - 2) [N], forces in addition, shape (2N, n) [N], [N m], and who is alive,
        shape (n,) of bool, like what is returned.
        """
        self._ctrl[...], self._added[self._qvel_index] = ctrl, added
        self._intact, self._all_intact = alive, bool(alive.all())
        self._advance()
        refused = np.any(self.batch.warning, axis=(1, 2))  # a state or an input
        return refused | ~self.plant_limits.holding(self.plant_q(), self.plant_v())

    def _advance(self) -> None:
        self.batch.step(None if self._all_intact else np.flatnonzero(self._intact))

    def _check_limits(self) -> None:
        self.freeze(~self.plant_limits.holding(self.plant_q(), self.plant_v()))

    def _follow_inertias(self) -> None:
        self.batch.set_const()
