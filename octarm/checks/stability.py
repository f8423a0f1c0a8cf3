"""Sampled loops of one arm and several controllers about rest, as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from octarm.arm.groups import Groups
from octarm.arm.lagrange import equilibrium
from octarm.arm.parameters import ArmParameters
from octarm.arm.summary import milliseconds
from octarm.checks.sampled_loop import LONGEST, LinearPlant, Loop, NoSlopeError, first_mode
from octarm.errors import OctarmError
from octarm.interfaces import Controller


class Stability:
    """The loops of an arm and several controllers, about rest.

    Attributes:
        lines: the text.
        stable: whether all that have a slope are stable.
    """

    def __init__(
        self,
        p: ArmParameters,
        controllers: Mapping[str, Controller],
        period: float,
        groups: Groups | None = None,
    ) -> None:
        """Computes them for a control period [s]; on the plant of groups if they are given."""
        plant, on = LinearPlant.of(p), ""
        if groups is not None:
            rest = groups.measured(equilibrium(groups.plant))
            plant = LinearPlant.of(groups.plant, groups.matrix, rest)
            on = f", on a plant of {groups.plant.modules} modules ({groups.layout})"
        self.lines = [
            f"sampled loop about rest, the model exact{on}",
            f"controller          longest period  over {1e3 * period:g} ms  first to grow beyond",
        ]
        self.stable = True
        for name, controller in controllers.items():
            try:
                loop = Loop(plant, controller)
            except NoSlopeError as error:
                self.lines.append(f"{name:<18}  {error}")
                continue
            self.stable &= loop.radius(period) < 1.0
            self.lines.append(f"{name:<18}  {_row(loop, period)}")
            if loop.states:
                held = Loop(plant, controller, learning=False)
                self.lines.append(f"  its state held    {_row(held, period)}")
        low, high = p.input_bounds(())
        if np.any(low == 0.0) or np.any(high == 0.0):
            self.lines.append(
                "columns that only push, or only pull, give no force of the other sign at rest: "
                "what is said here holds where they are under load"
            )


def _row(loop: Loop, period: float) -> str:
    longest = loop.longest_period()
    if longest == 0.0:
        return "no period is short enough"
    if math.isinf(longest):
        return f"all periods up to {LONGEST:g} s"
    mode = first_mode(loop, 1.001 * longest)
    nyquist = math.isclose(mode.frequency, 0.5 / (1.001 * longest), rel_tol=1e-3)
    how = "alternates" if nyquist else "swings"
    return (
        f"{milliseconds(longest):<14}  {longest / period:<{11 + len(f'{1e3 * period:g}') - 1}.3g} "
        f"{mode.coordinate}, {how} at {mode.frequency:.3g} Hz; mode {mode.mode} of the arm, "
        f"{mode.plant_frequency:.3g} Hz"
    )


def check_period(period: float) -> None:
    """Raises OctarmError for a control period [s] that is none."""
    if not 0.0 < period <= 10.0:
        raise OctarmError(f"control period is {period:g} s; it must be above 0 and at most 10 s")
