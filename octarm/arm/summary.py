"""What the numbers of an arm mean: rest, modes, steps, reach and conditions, as text."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from octarm.arm import lagrange
from octarm.arm.file import Arm
from octarm.arm.kinematics import tip_position
from octarm.arm.modes import INTEGRATORS, Mode, longest_step, modes
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import Reach, reach
from octarm.errors import printable

_LISTED = 12  # modules; of more the first and the last three


@dataclasses.dataclass(frozen=True, eq=False)
class ArmSummary:
    """What follows from the parameters of one arm.

    Attributes:
        rest: where it hangs, shape (2N,) [m], [rad].
        modes: about that, by ascending frequency.
    """

    arm: Arm
    rest: np.ndarray
    modes: Sequence[Mode]
    reach: Reach

    @classmethod
    def of(cls, arm: Arm) -> ArmSummary:
        """Computes all that."""
        p = arm.parameters
        rest = lagrange.equilibrium(p)
        return cls(arm, rest, modes(p, rest), reach(p))

    def lines(self) -> Iterator[str]:
        """The text, line by line."""
        p, rest = self.arm.parameters, self.rest
        length, mass = np.sum(p.rest_length) + p.tip_length, np.sum(p.mass)
        modules = f"{p.modules} module{'s' if p.modules > 1 else ''}"
        yield f"{printable(self.arm.name) or 'arm'}: {modules}, {length:.4g} m, {mass:.4g} kg"
        for what in ("source", "converted", "assumed"):
            for sentence in getattr(self.arm, what):
                yield f"  {what}: {printable(sentence)}"
        yield from _parameters(p)
        x = tip_position(rest, p.entries.tip_length)
        yield f"at rest it hangs {-1e3 * x[2]:.4g} mm down and {1e3 * x[0]:.4g} mm to the side"
        if any(math.isnan(mode.frequency) for mode in self.modes):
            yield "without control it does not stay where it hangs"
        yield "mode  frequency [Hz]  damping ratio"
        yield from _few([f"{k:<4}  {_mode(mode)}" for k, mode in enumerate(self.modes, 1)])
        steps = (
            f"{name} {milliseconds(float(longest_step(p, rest, name)))}" for name in INTEGRATORS
        )
        yield f"longest stable physics step: {', '.join(steps)}"
        yield from self._reach(p)
        matrices = lagrange.mass_matrix(p, rest), lagrange.potential_hessian(p, rest)
        conditions = "mass matrix {:.3g}, stiffness matrix {:.3g}".format(
            *map(_condition, matrices)
        )
        yield f"condition, of a diagonal of ones: {conditions}"

    def _reach(self, p: ArmParameters) -> Iterator[str]:
        if np.all(np.isinf(p.input_range)):
            yield "no input range limits how far it bends"
            return
        alone = self.reach.alone
        bends = _few([f"theta{i + 1} {_pair(alone[:, i])}" for i in range(p.modules)])
        yield (
            "largest bend held within the input range, other modules straight [rad]: "
            f"{', '.join(bends)}"
        )
        yield f"all modules bent alike [rad]: {_pair(self.reach.alike)} each"


def _parameters(p: ArmParameters) -> Iterator[str]:
    n = p.modules
    springs, dampers = (
        np.diagonal(of(p)).reshape(2, n)
        for of in (lagrange.stiffness_matrix, lagrange.damping_matrix)
    )
    low, high = p.input_bounds(())
    yield "module  length     mass     inertia   width    stiffness             damping"
    yield "        [mm]       [kg]     [kg m^2]  [mm]     [N/m]     [N m/rad]  [N s/m]  [N m s]"
    yield from _few([
        f"{i + 1:<6}  {1e3 * p.rest_length[i]:<9.4g}  {p.mass[i]:<7.4g}  {p.inertia[i]:<8.3g}  "
        f"{1e3 * p.widths[i]:<7.4g}  {springs[0, i]:<8.4g}  {springs[1, i]:<9.4g}  "
        f"{dampers[0, i]:<7.4g}  {dampers[1, i]:.4g}"
        for i in range(n)
    ])  # fmt: skip
    ends = sorted({*zip(low.tolist(), high.tolist(), strict=True)})
    if ends != [(-math.inf, math.inf)]:
        ranges = _few([f"{a:g} .. {b:g} N" for a, b in ends])
        yield f"input range of the columns: {', '.join(ranges)}"


def _few(words: list[str]) -> list[str]:
    return words if len(words) <= _LISTED else [*words[:3], "..", *words[-3:]]


def _mode(mode: Mode) -> str:
    kind = "slides" if mode.slides > 0.5 else "bends"
    if math.isnan(mode.frequency):
        return f"{'grows':<31}  {kind}"
    share = max(mode.slides, 1.0 - mode.slides)
    return f"{mode.frequency:<14.4g}  {mode.damping_ratio:<13.3g}  {kind} ({share:.0%})"


def _condition(matrix: np.ndarray) -> float:
    """In coordinates that give it a diagonal of ones, so that units do not count."""
    root = np.sqrt(np.abs(np.diagonal(matrix)))
    return float(np.linalg.cond(matrix / np.outer(root, root)))


def _pair(x: np.ndarray) -> str:
    low, high = x.tolist()
    if min(-low, high) > 6.28:
        return "> 6.28"
    return f"+-{high:.3g}" if math.isclose(-low, high, rel_tol=1e-3) else f"{low:.3g} .. {high:.3g}"


def milliseconds(seconds: float) -> str:
    """A time [s] in words."""
    return "any" if math.isinf(seconds) else f"{1e3 * seconds:.3g} ms"
