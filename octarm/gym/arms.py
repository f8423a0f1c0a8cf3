"""Arms behind Gymnasium's environments: what an action does, and what is observed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from dm_control.rl import control
from gymnasium.spaces import Box

from controllers import make_controller
from octarm.arm.file import read_arm
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance
from octarm.errors import OctarmError
from octarm.interfaces import Controller, Measurement, Motion, Reference
from octarm.simulation.arguments import commanded
from octarm.simulation.environment import load
from octarm.simulation.stepping import AnyPhysics
from octarm.simulation.task import TrackingTask

_TENTH = 0.1  # of a rest length, the unit of slides
_OTHERWISE = {  # arguments of `octarm.load` that are said in another way here
    "parameters": "arm gives the parameters",
    "batch": "gymnasium.make_vec has num_envs",
    "seed": "reset takes the seed",
    "flat_observation": "observations are always flat",
}


class Arms:
    """Arms whose episodes begin together: one without a batch axis, or a batch of them.

    Attributes:
        observation_space: of one arm.
        action_space: of one arm.
    """

    def __init__(
        self,
        reference: str | Motion = "sine",
        disturbances: str | Disturbance | Sequence[str | Disturbance] = (),
        arm: str | ArmParameters | None = None,
        controller: str | Controller | None = None,
        *,
        arms: int | None = None,
        mismatch: float = 0.0,
        gain_set: str | None = None,
        residual: float = 0.1,
        **options: Any,
    ) -> None:
        """One arm, or a batch.

        Args:
            reference: as of `octarm.load`.
            disturbances: what acts, as in `noise:0.4`, or made already.
            arm: a file, the name of one that comes with octarm, or parameters; the nominal arm when
                not given.
            controller: by name, or made already, to which actions are added.
            arms: how many, in a batch; one without a batch axis when not given.
            mismatch: by which the model of a controller that is named is wrong [1].
            gain_set: of a controller that is named.
            residual: share of the input range that is added to a controller's inputs for an action
                of 1, above 0 and at most 1.
            **options: further ones of `octarm.load`: `duration` (10 s when not given),
                `control_period`, `timestep`, `engine`, `threads`, `start` and so on.

        Raises:
            OctarmError: for what `octarm.load` or `make_controller` refuses, a share that is not
                one, or an arm without an input range.
        """
        if given_otherwise := options.keys() & _OTHERWISE:
            name = min(given_otherwise)
            raise OctarmError(f"{name} is no argument of the environment; {_OTHERWISE[name]}")
        if not 0.0 < residual <= 1.0:
            raise OctarmError(f"residual is {residual:g}; it must be above 0 and at most 1")
        given = [disturbances] if isinstance(disturbances, str | Disturbance) else disturbances
        true = nominal_parameters() if arm is None else arm
        true = read_arm(true) if isinstance(true, str) else true
        if isinstance(controller, str):
            controller = make_controller(controller, true.mismatched(mismatch), gain_set=gain_set)
        self._controller, share = controller, 1.0 if controller is None else residual
        self._environment = load(
            reference, disturbances=given, parameters=true, batch=arms, **options
        )
        physics: AnyPhysics = self._environment.physics
        low, high = physics.input_range()
        if not np.all(np.isfinite([low, high])):
            raise OctarmError(
                "actions are shares of the input range, and this arm has none; give it an "
                "input_range"
            )
        self._middle, self._reach = 0.5 * (low + high), share * (0.5 * (high - low))
        self._rest = physics.hanging()
        self._describe(physics)

    def _describe(self, physics: AnyPhysics) -> None:
        """Units of the observation, and the spaces."""
        rest = np.atleast_2d(self._rest)[0]
        arm: ArmParameters = self._environment.task.arm
        unit = np.concatenate([_TENTH * arm.rest_length, np.ones(arm.modules)])
        limits = physics.limits
        low, high, speed = (np.array(x) for x in (limits.low, limits.high, limits.speed))
        least = np.stack([low - rest, -speed, low - high, -2.0 * speed])
        most = np.stack([high - rest, speed, high - low, 2.0 * speed])
        least, most = (np.ravel(x / unit).astype(np.float32) for x in (least, most))
        self._unit = np.tile(unit, 4)
        self.observation_space = Box(least, most, dtype=np.float32)
        self.action_space = Box(-1.0, 1.0, self._middle.shape[-1:], np.float32)

    def begin(self, seeds: Sequence[int]) -> np.ndarray:
        """New episodes, one seed an arm; the first observation, shape (..., 8N)."""
        task: TrackingTask = self._environment.task
        task.reseed([np.random.SeedSequence(seed) for seed in seeds])
        self._seen: dict[str, np.ndarray] = self._environment.reset().observation
        controller, physics = self._controller, self._environment.physics
        self._state = None if controller is None else controller.initial_state(physics.batch_shape)
        self._first = True
        return self._observation()

    def step(self, action: Any) -> tuple[np.ndarray, Any, Any, bool]:
        """One control period.

        Args:
            action: shape (..., 2N) [1]; what is beyond -1 and 1 is cut off.

        Returns:
            The observation, shape (..., 8N), the reward, shape (...), whether an arm is terminated,
            shape (...), and whether the time is up.
        """
        environment, physics = self._environment, self._environment.physics
        tau = self._inputs(np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0))
        try:
            timestep = environment.step(tau)
            self._seen, reward, over = timestep.observation, timestep.reward, timestep.last()
        except control.PhysicsError:  # MuJoCo refused the state of an arm alone
            self._seen = environment.task.get_observation(physics)
            reward, over = 0.0, True
        if not physics.all_intact():  # the sensors of an arm alone stop with it, others go on
            lost = ~physics.intact()[..., None]
            true = {"q": physics.q(), "v": physics.v()}
            self._seen = {**self._seen, **{n: np.where(lost, true[n], self._seen[n]) for n in true}}
        return self._observation(), reward, ~physics.intact(), over

    def _inputs(self, action: np.ndarray) -> np.ndarray:
        """The input forces tau for an action, shapes (..., 2N) [N]."""
        controller, seen = self._controller, self._seen
        if controller is None:
            return self._middle + self._reach * action
        measurement = Measurement(self._environment.task.time, seen["q"], seen["v"])
        reference = Reference(seen["q_d"], seen["v_d"], seen["a_d"])
        with np.errstate(all="ignore"):  # an arm that is lost may hold anything
            answer = controller(self._state, measurement, reference)
            command, self._state = commanded(answer, measurement.q.shape, first=self._first)
            tau = self._environment.physics.actuation.inputs(measurement.q, command.force)
        self._first = False
        return tau + self._reach * action

    def _observation(self) -> np.ndarray:
        seen, space = self._seen, self.observation_space
        parts = [
            seen["q"] - self._rest,
            seen["v"],
            seen["q"] - seen["q_d"],
            seen["v"] - seen["v_d"],
        ]
        row = np.nan_to_num(np.concatenate(parts, axis=-1) / self._unit)
        return np.clip(row, space.low, space.high).astype(np.float32, order="C")
