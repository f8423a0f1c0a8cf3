"""Sampled loops of one arm and several controllers about rest, as a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from octarm.arm.groups import Groups
from octarm.arm.lagrange import equilibrium
from octarm.arm.parameters import ArmParameters
from octarm.arm.summary import milliseconds
from octarm.checks.sampled_loop import LONGEST, LinearPlant, Loop, NoSlopeError, first_mode
from octarm.errors import OctarmError
from octarm.interfaces import Controller


class Stability:
    """The loops of an arm and several controllers, about rest."""

    def __init__(
        self,
        p: ArmParameters,
        controllers: Mapping[str, Controller],
        period: float,
        groups: Groups | None = None,
    ) -> None:
        """Computes them for a control period [s]; on the plant of groups if they are given."""
        self._period = period
        plant, on = LinearPlant.of(p), ""
        if groups is not None:
            rest = groups.measured(equilibrium(groups.plant))
            plant = LinearPlant.of(groups.plant, groups.matrix, rest)
            on = f", on a plant of {groups.plant.modules} modules ({groups.layout})"
        self._lines = [
            f"sampled loop about rest, the model exact{on}",
            f"controller          longest period  over {1e3 * period:g} ms  first to grow beyond",
        ]
        self.stable = True
        for name, controller in controllers.items():
            try:
                self._lines += self._row(name, plant, controller)
            except NoSlopeError as error:
                self._lines.append(f"{name:<18}  {error}")
        low, high = p.input_bounds(())
        if np.any(low == 0.0) or np.any(high == 0.0):
            self._lines.append(
                "columns that only push, or only pull, give no force of the other sign at rest: "
                "what is said here holds where they are under load"
            )

    def lines(self) -> Sequence[str]:
        """The text."""
        return self._lines

    def _row(self, name: str, plant: LinearPlant, controller: Controller) -> Iterator[str]:
        loop = Loop(plant, controller)
        longest = loop.longest_period()
        self.stable &= loop.radius(self._period) < 1.0
        yield f"{name:<18}  {_row(loop, longest, self._period)}"
        if loop.states:
            held = Loop(plant, controller, learning=False)
            yield f"  its state held    {_row(held, held.longest_period(), self._period)}"


def _row(loop: Loop, longest: float, period: float) -> str:
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
