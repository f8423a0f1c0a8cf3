"""Gymnasium's environments: one arm, or many as a batch, and what actions and observations are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from dm_control.rl import control
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

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

_MOST_SPARE = 8  # batches of arms that are kept
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
        self._rest, limits = physics.hanging(), physics.limits
        rest = np.atleast_2d(self._rest)[0]
        seen: ArmParameters = self._environment.task.arm
        unit = np.concatenate([_TENTH * seen.rest_length, np.ones(seen.modules)])
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
        errors = [seen["q"] - seen["q_d"], seen["v"] - seen["v_d"]]
        row = np.concatenate([seen["q"] - self._rest, seen["v"], *errors], axis=-1)
        row = np.nan_to_num(row / self._unit)
        return np.clip(row, space.low, space.high).astype(np.float32, order="C")


class TrackEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One arm; see `octarm.gym`."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own type)

    def __init__(self, **setting: Any) -> None:
        """An arm; the arguments are those of `Arms`."""
        self._arms = Arms(**setting)
        self.observation_space = self._arms.observation_space
        self.action_space = self._arms.action_space
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """The next episode, whose seed is drawn; the same again after the same seed.

        Returns:
            The first observation, shape (8N,), and the drawn seed.
        """
        super().reset(seed=seed, options=options)
        drawn = _seed(self.np_random)
        self._over = False
        return self._arms.begin([drawn]), {"seed": drawn}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control period with an action of shape (2N,) [1].

        Raises OctarmError if the episode is over.
        """
        if self._over:
            raise OctarmError("the episode is over; reset begins the next one")
        seen, reward, lost, self._over = self._arms.step(action)
        return seen, float(reward), bool(lost), self._over and not lost, {}


@dataclasses.dataclass(eq=False)
class _Group:
    """Arms of a vector that began together."""

    arms: Arms
    rows: np.ndarray  # of the vector, shape (k,)
    alive: np.ndarray  # which of them are not over, shape (k,) of bool


class TrackVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many arms; see `octarm.gym`.

    Arms whose episode is over begin the next one at the next step, whose action they ignore. Those
    that begin together are stepped as one batch from then on.
    """

    def __init__(self, num_envs: int = 1, **setting: Any) -> None:
        """So many arms; the other arguments are those of `Arms`."""
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.num_envs, self._setting = num_envs, setting
        self._spare = {num_envs: Arms(**setting, arms=num_envs)}
        first = self._spare[num_envs]
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seen = np.zeros((num_envs, *first.observation_space.shape), np.float32)
        self._generators: list[np.random.Generator] = [np_random()[0] for _ in range(num_envs)]
        self._groups: list[_Group] = []
        self._over = np.ones(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """New episodes of all arms, or of those of `options["reset_mask"]`.

        Arm i is that of one environment alone with the seed `seed + i`, or the i-th one of a list.
        The observations have shape (n, 8N).
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        seeds = range(seed, seed + self.num_envs) if isinstance(seed, int) else seed
        rows = np.flatnonzero((options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        for i, each in enumerate(seeds or ()):
            if each is not None and i in rows:
                self._generators[i] = np_random(each)[0]
        info = self._begin(rows)
        return self._seen.copy(), info

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control period with actions of shape (n, 2N) [1].

        Arms that were over, or have not begun, begin anew instead.
        """
        again, actions = np.flatnonzero(self._over), np.asarray(actions)
        rewards = np.zeros(self.num_envs)
        terminations, truncations = np.zeros((2, self.num_envs), dtype=bool)
        for group in self._groups:
            seen, reward, lost, over = group.arms.step(actions[group.rows])
            rows, of = group.rows[group.alive], group.alive
            self._seen[rows], rewards[rows] = seen[of], reward[of]
            terminations[rows], truncations[rows] = lost[of], over & ~lost[of]
            group.alive = of & ~lost & (not over)
        self._over = terminations | truncations
        self._tidy()
        info = self._begin(again) if again.size else {}
        return self._seen.copy(), rewards, terminations, truncations, info

    def _begin(self, rows: np.ndarray) -> dict[str, Any]:
        """New episodes of these rows, as one group; their seeds, as Gymnasium has them."""
        for group in self._groups:
            group.alive &= ~np.isin(group.rows, rows)
        self._tidy()
        size, seeds = len(rows), np.zeros(self.num_envs, dtype=np.int64)
        seeds[rows] = [_seed(self._generators[int(i)]) for i in rows]
        arms = self._spare.pop(size, None) or Arms(**self._setting, arms=size)
        self._seen[rows] = arms.begin(seeds[rows].tolist())
        self._groups.append(_Group(arms, rows, np.ones(size, dtype=bool)))
        self._over[rows] = False
        return {"seed": seeds, "_seed": np.isin(np.arange(self.num_envs), rows)}

    def _tidy(self) -> None:
        """Puts groups aside of which no arm is left; some are kept to be used again."""
        for group in self._groups:
            if not group.alive.any() and len(self._spare) < _MOST_SPARE:
                self._spare[len(group.rows)] = group.arms
        self._groups = [group for group in self._groups if group.alive.any()]


def _seed(generator: np.random.Generator) -> int:
    """The seed of the next episode."""
    return int(generator.integers(2**63 - 1))
