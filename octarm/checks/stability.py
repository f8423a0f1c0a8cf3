"""Sampled loops of one arm and several controllers about rest, each in words and as a table."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from octarm.arm.groups import Groups
from octarm.arm.lagrange import equilibrium
from octarm.arm.parameters import ArmParameters
from octarm.arm.summary import milliseconds
from octarm.checks.sampled_loop import (
    LONGEST,
    LinearPlant,
    Loop,
    LoopMode,
    NoSlopeError,
    first_mode,
)
from octarm.errors import OctarmError
from octarm.interfaces import Controller


@dataclasses.dataclass(frozen=True)
class LoopAtRest:
    """What a sampled loop does about rest at a control period.

    Attributes:
        period: at which it is looked at [s].
        radius: its spectral radius there [1]; NaN if the law has no slope at rest.
        longest: control period up to which it is stable, see `Loop.longest_period` [s].
        mode: what grows first beyond that; None where nothing does, or all periods are too long.
        reason: why nothing is known of it, a sentence; empty if something is.
    """

    period: float
    radius: float = math.nan
    longest: float = math.nan
    mode: LoopMode | None = None
    reason: str = ""

    @property
    def stable(self) -> bool:
        """Whether it is stable at its period; also if nothing is known of it."""
        return not self.radius >= 1.0

    @property
    def limit(self) -> str:
        """The longest control period in words."""
        if self.longest == 0.0:
            return "no period is short enough"
        if math.isinf(self.longest):
            return f"all periods up to {LONGEST:g} s"
        return milliseconds(self.longest)

    @property
    def first(self) -> tuple[str, str]:
        """Which coordinate grows first and how, and which mode of the arm that is."""
        assert self.mode is not None
        frequency = self.mode.frequency
        nyquist = math.isclose(frequency, 0.5 / (1.001 * self.longest), rel_tol=1e-3)
        how = "alternates" if nyquist else "swings"
        return (
            f"{self.mode.coordinate}, {how} at {frequency:.3g} Hz",
            f"mode {self.mode.mode} of the arm, {self.mode.plant_frequency:.3g} Hz",
        )


def linear_plant(p: ArmParameters, groups: Groups | None = None) -> LinearPlant:
    """An arm about rest, or the plant of groups if they are given."""
    if groups is None:
        return LinearPlant.of(p)
    rest = groups.measured(equilibrium(groups.plant))
    return LinearPlant.of(groups.plant, groups.matrix, rest)


def loop_at_rest(plant: LinearPlant, controller: Controller, period: float) -> LoopAtRest:
    """The loop of a plant and a controller about rest at a control period [s]."""
    try:
        loop = Loop(plant, controller)
    except NoSlopeError as error:
        return LoopAtRest(period, reason=str(error))
    longest = loop.longest_period()
    some = 0.0 < longest < math.inf
    mode = first_mode(loop, 1.001 * longest) if some else None
    return LoopAtRest(period, loop.radius(period), longest, mode)


def stability_lines(loops: Mapping[str, LoopAtRest], period: float) -> list[str]:
    """The loops of several controllers by name at a control period [s], as a table."""
    head = f"controller          longest period  over {1e3 * period:g} ms  first to grow beyond"
    lines = [head]
    for name, loop in loops.items():
        lines.append(f"{name:<18}  {loop.reason or _row(loop)}")
    return lines


def _row(loop: LoopAtRest) -> str:
    if loop.mode is None:
        return loop.limit
    width = 11 + len(f"{1e3 * loop.period:g}") - 1
    return f"{loop.limit:<14}  {loop.longest / loop.period:<{width}.3g} {'; '.join(loop.first)}"


def check_period(period: float) -> None:
    """Raises OctarmError for a control period [s] that is none."""
    if not 0.0 < period <= 10.0:
        raise OctarmError(f"control period is {period:g} s; it must be above 0 and at most 10 s")
