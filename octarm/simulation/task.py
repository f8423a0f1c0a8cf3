"""The tracking task: what is observed of an arm that follows a motion, and what is earned by it."""
# pyright: reportIncompatibleMethodOverride=false
# (dm_control's abstract methods are inferred to return None)

from __future__ import annotations

import collections
import math
import operator
from collections.abc import Sequence

import numpy as np
from dm_control.rl import control
from dm_env import specs

from octarm.arm.kinematics import arc_tip, last_axis, tip_position
from octarm.arm.mjcf import world_position
from octarm.arrays import split
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Disturbance, Episode
from octarm.errors import OctarmError, quoted
from octarm.references import wanted
from octarm.simulation.start import Start
from octarm.simulation.stepping import AnyPhysics


class TrackingTask(control.Task):
    """Follow a desired motion until the time is up, or the arm leaves its limits.

    Attributes:
        reference: the desired motion.
        arm: the undisturbed true arm, as it is measured.
        disturbances: what acts on the arm that the controller does not know.
        random: what wrappers draw from; a stream of the present episode.
        episode: number of the present episode, from 0.
        next_episode: number of the episode that the next reset starts; it may be written to.
        flat: whether all observations are one array.
    """

    def __init__(
        self,
        episode: Episode,
        disturbances: Sequence[Disturbance] = (),
        *,
        margin: Sequence[float],
        period: float,
        periods: int,
        lasting: bool = False,
        start: Start | None = None,
        flat: bool = False,
    ) -> None:
        """A task for episodes, of which the first one is given.

        Args:
            episode: the first one.
            disturbances: what acts in all of them.
            margin: error of each coordinate that earns a tenth of the reward [m], [rad].
            period: control period [s].
            periods: number of control periods of an episode.
            lasting: whether a loop that has a duration of its own goes on beyond them.
            start: what is drawn of the beginning; None for arms that hang at rest.
            flat: whether all observations are one array.
        """
        self.reference, self.arm = episode.reference, episode.parameters
        self.disturbances = tuple(disturbances)
        self.random = episode.streams("wrappers")[0]
        self.episode = self.next_episode = 0
        self._first = episode
        ActiveDisturbances(self.disturbances, episode)  # raises when one does not suit the arm
        self._margin = np.array(margin)
        self._period = period
        self._lasting, self._ordinary = lasting, periods
        self._end: int | None = periods
        self._start = start
        self.flat = flat
        self._periods = 0
        self._shape = (*episode.batch_shape, episode.coordinates)
        self._desired = wanted(self.reference, 0.0, self._shape)

    def reseed(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Lets the next reset start episode 0 of other seeds, one an arm."""
        self._first = self._first.changed(seeds=seeds)
        self.next_episode = 0

    @property
    def time(self) -> float:
        """Time since the start of the episode [s]: whole control periods times their length."""
        return self._periods * self._period

    def desired_steps(self, step: float, count: int) -> np.ndarray:
        """q_d at the physics steps of the present period, shape (count, ..., 2N) [m], [rad].

        The step is given in seconds. As in the answers of the reference, (count, 2N) will do.
        """
        later = range(self._periods * count + 1, (self._periods + 1) * count)
        rows = [wanted(self.reference, i * step, self._shape).q for i in later]
        return np.stack([self._desired.q, *rows])

    def initialize_episode(self, physics: AnyPhysics) -> None:
        """The arm hangs still, as it does undisturbed, or where the start is drawn.

        What changes it acts from here on. Raises OctarmError if the number of the episode is not a
        whole one, at least 0.
        """
        try:
            index = operator.index(self.next_episode)
        except TypeError:
            index = -1
        if index < 0:
            given = self.next_episode
            raise OctarmError(
                f"next_episode is {quoted(given)}; it must be a whole number, at least 0"
            )
        episode = self._first.later(index)
        self._begin_period(0)
        self._end = self._ordinary
        self.random = episode.streams("wrappers")[0]
        physics.set_motion(*self._drawn(episode, physics))
        physics.begin(ActiveDisturbances(self.disturbances, episode))
        self.episode, self.next_episode = episode.index, episode.index + 1

    def go_on(self) -> None:
        """Lets the present episode last, unless a duration was given: a loop has its own."""
        if self._lasting:
            self._end = None

    def _drawn(self, episode: Episode, physics: AnyPhysics) -> tuple[np.ndarray, np.ndarray]:
        """Where the plants begin, and how fast, each of shape (..., 2N)."""
        rest = physics.plant_rest()
        if self._start is None:
            return rest, np.zeros_like(rest)
        shape = (*physics.batch_shape, -1)
        moved, v = (x.reshape(shape) for x in self._start.drawn(episode.streams("start")))
        if physics.groups is not None:
            moved, v = physics.groups.spread(moved), physics.groups.spread(v)
        return rest + moved, v

    def before_step(self, action: np.ndarray, physics: AnyPhysics) -> None:
        """Holds the action, tau, shape (2N,) [N]."""
        physics.set_control(action)

    def after_step(self, physics: AnyPhysics) -> None:
        """One control period has passed."""
        del physics
        self._begin_period(self._periods + 1)

    def action_spec(self, physics: AnyPhysics) -> specs.BoundedArray:
        """Input forces tau, shape (2N,) [N], within the arm's input range."""
        low, high = physics.input_range()
        return specs.BoundedArray(low.shape, np.float64, low, high, name="tau")

    def get_observation(self, physics: AnyPhysics) -> collections.OrderedDict[str, np.ndarray]:
        """What is measured and what is wanted, in fresh arrays.

        q, v, q_d, v_d and a_d have shape (..., 2N), tip_position has shape (..., 2); see `load`.
        """
        desired, active = self._desired, physics.active
        q, v = physics.readings()
        if active is not None and active.sensors:  # nothing acts before the first episode
            q, v = active.sensed(physics.steps(), q, v)
            tip = self._seeming_tip(q)
        else:
            tip = physics.tip_position()
        seen: collections.OrderedDict[str, np.ndarray] = collections.OrderedDict(
            q=q,
            v=v,
            q_d=desired.q.copy("K"),
            v_d=desired.v.copy("K"),
            a_d=desired.a.copy("K"),
            tip_position=tip[..., ::2].copy("K"),  # the arm stays in the plane of x and z
        )
        if not self.flat:
            return seen
        rows = [np.broadcast_to(x, (*self._shape[:-1], x.shape[-1])) for x in seen.values()]
        return collections.OrderedDict(
            {control.FLAT_OBSERVATION_KEY: np.concatenate(rows, axis=-1)}
        )

    def get_reward(self, physics: AnyPhysics) -> np.ndarray | float:
        """In [0, 1], shape (...).

        It is 1 without error, 0.1 when the rms of error by margin is 1, 0 when diverged.
        """
        error = (physics.q() - self._desired.q) / self._margin
        mean = sum(split(error * error)) / error.shape[-1]
        reward = np.exp(math.log(0.1) * mean)
        return reward if physics.all_intact() else np.where(physics.intact(), reward, 0.0)[()]

    def get_termination(self, physics: AnyPhysics) -> float | None:
        """Discount 0 when every arm has left its limits, 1 when the time is up, else None."""
        if physics.all_lost():
            return 0.0
        return 1.0 if self._periods == self._end else None

    def _seeming_tip(self, q: np.ndarray) -> np.ndarray:
        """The tip of an arm with these coordinates, shape (..., 3) [m], in the world frame."""
        length = self._first.parameters.entries.tip_length
        if self._first.groups is None:
            return tip_position(q, length)
        (x, y), (cos, sin) = arc_tip(q), last_axis(q)
        return world_position(np.stack([x + length * cos, y + length * sin], axis=-1))

    def _begin_period(self, periods: int) -> None:
        self._periods = periods
        self._desired = wanted(self.reference, self.time, self._shape)
