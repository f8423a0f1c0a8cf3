"""A controller as what viewers and learning loops of dm_control call a policy."""

from __future__ import annotations

from typing import Any

import dm_env
import numpy as np
from dm_control.rl import control

from octarm.interfaces import Controller, Measurement, Reference
from octarm.simulation.arguments import check_simulation, commanded
from octarm.simulation.stepping import AnyPhysics
from octarm.simulation.task import TrackingTask


class Policy:
    """Gives the action for a time step; the controller's state begins anew with each episode.

    A loop that steps the environment with it moves the arm as `octarm.rollout` does, bit for bit.
    """

    def __init__(self, environment: control.Environment, controller: Controller) -> None:
        """A policy for an environment of `octarm.load`.

        Raises OctarmError if one of the two is something else.
        """
        check_simulation(environment, controller, 1.0)
        self._physics: AnyPhysics = environment.physics
        self._task: TrackingTask = environment.task
        self._controller = controller
        self._state: Any = None

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """The input forces tau, shape (..., 2N) [N]; zero where the controller's are not finite.

        Raises OctarmError if the controller's force has a wrong shape.
        """
        seen = timestep.observation
        if timestep.first():
            self._state = self._controller.initial_state(self._physics.batch_shape)
        measurement = Measurement(self._task.time, seen["q"], seen["v"])
        reference = Reference(seen["q_d"], seen["v_d"], seen["a_d"])
        with np.errstate(all="ignore"):
            answer = self._controller(self._state, measurement, reference)
            command, self._state = commanded(answer, measurement.q.shape, first=timestep.first())
            tau = self._physics.actuation.inputs(measurement.q, command.force)
        return np.where(np.isfinite(tau), tau, 0.0)
