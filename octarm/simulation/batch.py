"""Many arms as MuJoCo steps them on threads, behind the methods of the single arm."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from octarm.arm.actuation import Actuation
from octarm.arm.kinematics import tip_position
from octarm.arm.mjcf import build_slim_model
from octarm.arm.parameters import ArmParameters
from octarm.simulation.stepping import AnyPhysics, rest_of


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
        undisturbed = each or ArmParameters.from_model(model)
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

    def _advance(self) -> None:
        self.batch.step(None if self._all_intact else np.flatnonzero(self._intact))

    def _check_limits(self) -> None:
        self.freeze(~self.plant_limits.holding(self.plant_q(), self.plant_v()))

    def _follow_inertias(self) -> None:
        self.batch.set_const()
