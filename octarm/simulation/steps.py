"""The physics step, against the fastest mode of every arm that an episode may have.

RK4 is explicit: a step that is too long for a mode makes the arm diverge, and its controller would
be blamed. So the arms of an episode are looked at before it begins, see `octarm.arm.modes`: the
undisturbed one, and those that its disturbances make of it, at the ends of their ranges.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from octarm.arm.groups import Groups
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import physics_step
from octarm.arm.modes import INTEGRATORS, SHORTEST_STEP, longest_step, rate_bound, rates
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Disturbance, Episode, PlantChange
from octarm.errors import OctarmError, closest
from octarm.interfaces import Reference

AUTO = "auto"

_RESERVE = 1.1  # by which a step that is found here is shorter than the longest stable one
_LONGEST_PERIOD = 10.0  # [s]
_MOST_STEPS = 1_000_000  # in a control period


def check_integrator(name: str) -> None:
    """Raises OctarmError if `octarm.arm.modes.INTEGRATORS` has no integrator of this name."""
    if name not in INTEGRATORS:
        raise OctarmError(f"unknown integrator {name!r}{closest(name, INTEGRATORS)}")


def integrator_of(name: str) -> int:
    """MuJoCo's number of an integrator of this name."""
    return int(getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}"))


def step_check(
    rest: np.ndarray, timestep: float, integrator: str
) -> Callable[[ArmParameters], None]:
    """What refuses arms that hang at rest, shape (..., 2N), for which a step [s] is too long."""
    return functools.partial(_check, rest, timestep, integrator)


def _check(rest: np.ndarray, timestep: float, integrator: str, arms: ArmParameters) -> None:
    if np.all(timestep * rate_bound(arms, rest) <= 2.0):
        return
    longest = longest_step(arms, rest, integrator)
    if np.all(timestep <= longest):
        return
    worst, arm = None, arms
    if arms.batch_shape:
        worst = int(np.argmin(longest))
        arm, rest = arms.arm(worst), rest[worst] if rest.ndim > 1 else rest
    allowed = float(np.min(longest))
    raise StepError(
        f"timestep is {timestep:g} s; the fastest mode of the arm "
        f"{_fastest(arm, rest, allowed)}, so that with {integrator} it must be at most "
        f"{_rounded_down(allowed):.3g} s; {AUTO!r} chooses one",
        worst,
    )


class StepError(OctarmError):
    """A physics step that is too long for an arm.

    Attributes:
        sentence: what is wrong, without the arm's number.
        arm: its number in the batch; None if all arms are alike.
    """

    def __init__(self, sentence: str, arm: int | None) -> None:
        super().__init__(sentence if arm is None else f"arm {arm}: {sentence}")
        self.sentence, self.arm = sentence, arm


def _fastest(arm: ArmParameters, rest: np.ndarray, allowed: float) -> str:
    """What the mode does that needs the shortest step."""
    if not allowed > 0.0:
        return "is beyond any number"
    eigenvalues = rates(arm, rest)
    fastest = eigenvalues[np.argmax(np.abs(eigenvalues))]
    if abs(fastest.imag) > abs(fastest.real):
        return f"swings at {abs(fastest.imag) / (2.0 * np.pi):.3g} Hz"
    return f"decays at {-fastest.real:.3g} 1/s"


def _rounded_down(x: float) -> float:
    unit = 10.0 ** (math.floor(math.log10(x)) - 2) if x > 0.0 else 1.0
    return math.floor(x / unit * (1.0 + 1e-12)) * unit


class Possible(NamedTuple):
    """The arms that episodes may have: an arm, or one of each batch place, as disturbances make it.

    Of the disturbances those count that change the arm; see `octarm.disturbances.episode.Episode`.
    """

    arm: ArmParameters
    disturbances: Sequence[Disturbance]
    seeds: Sequence[np.random.SeedSequence]
    batch_shape: tuple[int, ...]
    groups: Groups | None = None

    def longest_steps(self, integrator: str) -> np.ndarray:
        """The longest stable step of each arm, shape (...) [s]."""
        longest: list[np.ndarray] = []

        def look(rest: np.ndarray, arms: ArmParameters) -> None:
            longest.append(longest_step(arms, rest, integrator))

        self._survey(look)
        return functools.reduce(np.minimum, longest, np.full(self.batch_shape, np.inf))

    def check(self, integrator: str, timestep: float | None) -> None:
        """Raises StepError if a step [s], that of `models/octarm.xml` if None, is too long."""
        step = physics_step() if timestep is None else timestep
        self._survey(lambda rest, arms: _check(rest, step, integrator, arms))

    def _survey(self, look: Callable[[np.ndarray, ArmParameters], None]) -> None:
        """Looks at every plant that there may be, with where the undisturbed ones hang."""
        arm, disturbances, seeds, batch_shape, groups = self
        rest = equilibrium(arm if groups is None else groups.plant)
        q = rest if groups is None else groups.measured(rest)
        still = Reference(q, np.zeros_like(q), np.zeros_like(q))
        episode = Episode(
            parameters=arm,
            timestep=physics_step(),
            reference=lambda t: still,
            seeds=seeds,
            batch_shape=batch_shape,
            check_arm=functools.partial(look, rest),
            groups=groups,
        )
        ActiveDisturbances([d for d in disturbances if isinstance(d, PlantChange)], episode)


def fitting_step(longest: float, control_period: float | None) -> tuple[float, float]:
    """A step [s] for arms with this longest stable step [s], and the control period [s].

    It is a period over 1, 2, 5, 10, 20 and so on, shorter than the longest stable one by a tenth at
    least, and at most that of `models/octarm.xml`, which the period is if None. Raises OctarmError
    if it would be below 1e-7 s.
    """
    usual = physics_step()
    period = usual if control_period is None else control_period
    if not period > 0.0:
        raise OctarmError(f"control period is {period:g} s; it must be positive")
    check_period(period, usual)
    for decade, part in itertools.product(range(12), (1, 2, 5)):
        step = period / (part * 10**decade)
        if step <= usual * (1.0 + 1e-9) and step * _RESERVE <= longest:
            if step < SHORTEST_STEP:
                break
            return step, period
    raise OctarmError(
        f"the fastest mode of the arm needs steps below {longest / _RESERVE:.3g} s; they must be "
        f"at least {SHORTEST_STEP:g} s"
    )


def check_period(period: float, step: float) -> None:
    """Raises OctarmError for a control period [s] of too many physics steps [s], or too long."""
    most = min(_LONGEST_PERIOD, _MOST_STEPS * step)
    if period > most * (1.0 + 1e-9):
        raise OctarmError(
            f"control period is {period:g} s; it must be at most {most:g} s: an arm that is left "
            "alone for longer than it swings is not controlled"
        )
