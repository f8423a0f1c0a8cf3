"""What the numbers of an arm mean: rest, modes, steps, reach and conditions, as text."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from octarm.arm import lagrange
from octarm.arm.file import Arm
from octarm.arm.kinematics import tip_position
from octarm.arm.modes import INTEGRATORS, Mode, growth_rate, longest_step, modes
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import Reach, reach
from octarm.arrays import coordinate_names
from octarm.errors import printable

_LISTED = 12  # modes; of more the fastest one is listed as well


@dataclasses.dataclass(frozen=True, eq=False)
class ArmSummary:
    """What follows from the parameters of one arm.

    Attributes:
        rest: where it hangs, shape (2N,) [m], [rad].
        modes: about that, by ascending frequency.
        steps: longest stable physics step by integrator [s].
        growth: rate of the fastest growing mode, 0 if it stays where it hangs [1/s].
        conditions: of the mass and of the stiffness matrix at rest, in coordinates that give each a
            diagonal of ones, so that units do not count [1].
    """

    arm: Arm
    rest: np.ndarray
    modes: Sequence[Mode]
    steps: Mapping[str, float]
    growth: float
    reach: Reach
    conditions: tuple[float, float]

    @classmethod
    def of(cls, arm: Arm) -> ArmSummary:
        """Computes all that."""
        p = arm.parameters
        rest = lagrange.equilibrium(p)
        matrices = lagrange.mass_matrix(p, rest), lagrange.potential_hessian(p, rest)
        mass, stiffness = map(_condition, matrices)
        return cls(
            arm=arm,
            rest=rest,
            modes=modes(p, rest),
            steps={name: float(longest_step(p, rest, name)) for name in INTEGRATORS},
            growth=float(growth_rate(p, rest)),
            reach=reach(p),
            conditions=(mass, stiffness),
        )

    def lines(self) -> Iterator[str]:
        """The text, line by line."""
        p = self.arm.parameters
        length, mass = np.sum(p.rest_length) + p.tip_length, np.sum(p.mass)
        modules = f"{p.modules} module{'s' if p.modules > 1 else ''}"
        yield f"{printable(self.arm.name) or 'arm'}: {modules}, {length:.4g} m, {mass:.4g} kg"
        for what in ("source", "converted", "assumed"):
            for sentence in getattr(self.arm, what):
                yield f"  {what}: {printable(sentence)}"
        yield from self._parameters(p)
        yield from self._rest(p)
        yield from self._modes()
        steps = ", ".join(f"{name} {milliseconds(step)}" for name, step in self.steps.items())
        yield f"longest stable physics step: {steps}"
        yield from self._reach(p)
        mass, stiffness = self.conditions
        yield (
            f"condition, of a diagonal of ones: mass matrix {mass:.3g}, stiffness matrix "
            f"{stiffness:.3g}"
        )

    def _parameters(self, p: ArmParameters) -> Iterator[str]:
        n = p.modules
        springs, dampers = (
            np.diagonal(of(p)).reshape(2, n)
            for of in (lagrange.stiffness_matrix, lagrange.damping_matrix)
        )
        low, high = p.input_bounds(())
        yield "module  length     mass     inertia   width    stiffness             damping"
        yield "        [mm]       [kg]     [kg m^2]  [mm]     [N/m]     [N m/rad]  [N s/m]  [N m s]"
        rows = [f"{i + 1:<6}  {1e3 * p.rest_length[i]:<9.4g}  {p.mass[i]:<7.4g}  "
                f"{p.inertia[i]:<8.3g}  {1e3 * p.widths[i]:<7.4g}  {springs[0, i]:<8.4g}  "
                f"{springs[1, i]:<9.4g}  {dampers[0, i]:<7.4g}  {dampers[1, i]:.4g}"
                for i in range(n)]  # fmt: skip
        yield from rows if n <= _LISTED else [*rows[:3], "..", *rows[-3:]]
        ends = sorted({*zip(low.tolist(), high.tolist(), strict=True)})
        if ends == [(-math.inf, math.inf)]:
            return
        ranges = ", ".join(f"{a:g} .. {b:g} N" for a, b in ends[:4])
        yield f"input range of the columns: {ranges}{', ..' if len(ends) > 4 else ''}"

    def _rest(self, p: ArmParameters) -> Iterator[str]:
        x = tip_position(self.rest, p.entries.tip_length)
        n = p.modules
        stretch = 100.0 * (np.sum(self.rest[:n]) / np.sum(p.rest_length) - 1.0)
        yield (
            f"at rest it hangs {-1e3 * x[2]:.4g} mm down and {1e3 * x[0]:.4g} mm to the side, "
            f"{stretch:.3g} % longer than without weight, its tip turned by "
            f"{np.sum(self.rest[n:]):.4g} rad"
        )
        if self.growth > 0.0:
            yield (
                "without control it does not stay where it hangs: a mode grows e-fold in "
                f"{1.0 / self.growth:.3g} s"
            )

    def _modes(self) -> Iterator[str]:
        names = coordinate_names(self.arm.parameters.modules)
        yield "mode  frequency [Hz]  damping ratio  mostly"
        for k, mode in enumerate(self.modes, 1):
            if k > _LISTED and k < len(self.modes):
                continue
            if k == len(self.modes) > _LISTED + 1:
                yield ".."
            kind = "slides" if mode.slides > 0.5 else "bends"
            share = max(mode.slides, 1.0 - mode.slides)
            most = names[int(np.argmax(np.abs(mode.shape) * self._weights()))]
            numbers = f"{mode.frequency:<14.4g}  {mode.damping_ratio:<13.3g}"
            if math.isnan(mode.frequency):
                numbers = f"{'grows':<14}  {'':<13}"
            yield f"{k:<4}  {numbers}  {kind} ({share:.0%}), {most}"

    def _weights(self) -> np.ndarray:
        """By which coordinates are compared: roots of what they move, shape (2N,)."""
        return np.sqrt(np.diagonal(lagrange.mass_matrix(self.arm.parameters, self.rest)))

    def _reach(self, p: ArmParameters) -> Iterator[str]:
        if np.all(np.isinf(p.input_range)):
            yield "no input range limits how far it bends"
            return
        alone, alike = self.reach.alone, self.reach.alike
        few = range(p.modules) if p.modules <= _LISTED else (0, p.modules // 2, p.modules - 1)
        bends = ", ".join(f"theta{i + 1} {_pair(alone[:, i])}" for i in few)
        yield f"largest bend held within the input range, other modules straight [rad]: {bends}"
        yield f"all modules bent alike [rad]: {_pair(alike)} each"


def _condition(matrix: np.ndarray) -> float:
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
