"""The tracking task on dm_control's environment loop."""
# pyright: reportIncompatibleMethodOverride=false
# (dm_control's abstract methods are inferred to return None)

from __future__ import annotations

import collections
import math

import numpy as np
from dm_control.rl import control
from dm_control.utils import rewards
from dm_env import specs

from octarm.actuation import ACTUATIONS
from octarm.errors import closest
from octarm.interfaces import Motion, Reference
from octarm.model import build_model
from octarm.parameters import ArmParameters
from octarm.plant import ArmPhysics
from octarm.references import named_reference

# A tracking error of this size earns a tenth of the reward.
_SLIDE_MARGIN = 0.01  # [m]
_BEND_MARGIN = 0.1  # [rad]


def load(
    reference: str | Motion = "sine",
    *,
    parameters: ArmParameters | None = None,
    timestep: float | None = None,
    control_period: float | None = None,
    duration: float | None = None,
    actuation: str = "f-coeff",
    seed: int | np.random.SeedSequence = 0,
) -> control.Environment:
    """The arm, hanging at rest, and a motion it shall follow.

    The action is tau, the input forces of eq (1), shape (2N,) [N]. They act as the generalised
    force F_coeff(q) tau and are held for one control period.

    Args:
        reference: a name of `octarm.references.REFERENCES`, or a function of time that gives
            the desired coordinates, velocities and accelerations.
        parameters: the true arm; the nominal one when not given.
        timestep: physics step [s]; 0.5 ms when not given.
        control_period: time between two actions [s]; one physics step when not given.
        duration: when an episode ends [s], rounded up to whole control periods; never when not
            given.
        actuation: `f-coeff`, or `internal` for forces between neighbouring modules.
        seed: of the task's random generator, which dm_control's wrappers draw from.

    Returns:
        An environment with the observations q, v, q_d, v_d, a_d, each of shape (2N,), and
        tip_position, shape (3,), in the world frame.

    Raises:
        ValueError: for an unknown name, a period that is not a whole multiple of the step, or an
            arm that does not hang within its limits.
    """
    model = build_model(parameters, timestep)
    arm = ArmParameters.from_model(model)
    if actuation not in ACTUATIONS:
        raise ValueError(f"unknown actuation {actuation!r}{closest(actuation, ACTUATIONS)}")
    physics = ArmPhysics.from_arm_model(model, ACTUATIONS[actuation](arm.width))
    rest = physics.hanging()
    if not physics.limits.hold(rest, np.zeros_like(rest)):
        broken = physics.limits.violation(rest, np.zeros_like(rest))
        raise ValueError(f"this arm cannot hang in one piece: at rest {broken}")
    step = physics.timestep()
    steps_a_period = 1 if control_period is None else _whole_steps(control_period, step)
    motion = named_reference(reference, rest) if isinstance(reference, str) else reference
    limit = None if duration is None else whole_periods(duration, steps_a_period * step)
    if isinstance(seed, int) and seed < 0:
        raise ValueError(f"seed is {seed}; it must be at least 0")
    random = np.random.default_rng(seed)
    task = TrackingTask(
        motion, arm.modules, random, period=steps_a_period * step, episode_periods=limit
    )
    return control.Environment(physics, task, n_sub_steps=steps_a_period)


def whole_periods(duration: float, period: float) -> int:
    """Number of control periods [1] that cover a duration [s]; at least one.

    Raises:
        ValueError: unless the duration is positive and at most 1e9 periods.
    """
    if not duration > 0.0:
        raise ValueError(f"duration is {duration:g} s; it must be positive")
    if not duration / period <= 1e9:
        raise ValueError(
            f"duration is {duration:g} s; it must be at most {1e9 * period:g} s, "
            f"1e9 control periods of {period:g} s"
        )
    return max(1, math.ceil(duration / period - 1e-6))


class TrackingTask(control.Task):
    """Follow a desired motion; the episode ends early when the arm leaves its limits.

    Attributes:
        reference: the desired motion.
        random: what wrappers draw from.
    """

    def __init__(
        self,
        reference: Motion,
        modules: int,
        random: np.random.Generator,
        *,
        period: float,
        episode_periods: int | None = None,
    ) -> None:
        """A task for an arm of N modules and a control period [s]."""
        self.reference = reference
        self.random = random
        self._margin = np.repeat([_SLIDE_MARGIN, _BEND_MARGIN], modules)
        self._period = period
        self._episode_periods = episode_periods
        self._periods = 0
        self._desired = reference(0.0)

    @property
    def time(self) -> float:
        """Time since the start of the episode [s]: whole control periods times their length."""
        return self._periods * self._period

    def initialize_episode(self, physics: ArmPhysics) -> None:
        """The arm hangs still, loaded by its weight."""
        self._start_at(0)
        physics.set_motion(physics.hanging(), np.zeros_like(physics.hanging()))

    def before_step(self, action: np.ndarray, physics: ArmPhysics) -> None:
        """Holds the action, tau, shape (2N,) [N]."""
        physics.set_control(action)

    def after_step(self, physics: ArmPhysics) -> None:
        """One control period has passed."""
        del physics
        self._start_at(self._periods + 1)

    def action_spec(self, physics: ArmPhysics) -> specs.BoundedArray:
        """Input forces tau, shape (2N,) [N], within the actuators' range."""
        limit = physics.input_limit()
        return specs.BoundedArray(limit.shape, np.float64, -limit, limit, name="tau")

    def get_observation(self, physics: ArmPhysics) -> collections.OrderedDict[str, np.ndarray]:
        """What is measured and what is wanted, in fresh arrays."""
        desired = self._desired
        return collections.OrderedDict(
            q=physics.q(),
            v=physics.v(),
            q_d=desired.q.copy(),
            v_d=desired.v.copy(),
            a_d=desired.a.copy(),
            tip_position=physics.tip_position(),
        )

    def get_reward(self, physics: ArmPhysics) -> float:
        """In [0, 1]: 1 without error, 0.1 when the rms of error by margin is 1, 0 when diverged."""
        if not physics.intact():
            return 0.0
        error = (physics.q() - self._desired.q) / self._margin
        return float(rewards.tolerance(math.sqrt(error.dot(error) / error.size), margin=1.0))

    def get_termination(self, physics: ArmPhysics) -> float | None:
        """Discount 0 when the arm has left its limits, 1 when the time is up, else None."""
        if not physics.intact():
            return 0.0
        return 1.0 if self._periods == self._episode_periods else None

    def _start_at(self, periods: int) -> None:
        self._periods = periods
        self._desired: Reference = self.reference(self.time)


def _whole_steps(period: float, step: float) -> int:
    ratio = period / step
    if not (math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-6):
        raise ValueError(
            f"control period is {period:g} s; it must be a whole multiple of the physics step, "
            f"{step:g} s"
        )
    return round(ratio)
