"""How many modules are enough: chains of both layouts against the rod that they stand for.

Errors at N = 1 .. 40 of statics, frequencies and motion, and the orders at which they vanish.
`rod_theory` has the exact statics and the frequencies, `rod_study` what chains do.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import root_scalar

from octarm.arm.rod import Rod, arm_from_rod
from octarm.checks import rod_study, rod_theory
from octarm.tolerances import Check, CheckTable, run_checks

MODULES = (1, 2, 3, 5, 10, 20, 40)
ORDERS = {"paper": 1, "centred": 2}
HALVES = "half-half"  # a layout that no arm has; see `octarm.checks.rod_study`
TAPERED = Rod(EA=(300.0, 150.0), EI=(0.5, 0.2), density=(3.0, 1.0), rotary_inertia=(4e-3, 1e-3))

_SMALL = 1e-4  # load on the tip [N]
_ANGLE = 1.0  # of the tip under the large load [rad]
_CLOSE = 0.15  # of an observed order to that of theory
_APART = 2e-3  # [1]; PyElastica's rod from its chain, as both shear and stretch in their own ways


class Curve(NamedTuple):
    """The errors of one quantity over the number of modules.

    Attributes:
        case: what is compared.
        layout: of the chains.
        errors: relative to the rod's value, at each of MODULES, shape (7,) [1]; NaN where a chain
            has no such quantity. Those of a motion are distances in lengths of the rod.
        order: at which they vanish; 0 where they are zero, None where terms cancel up to N = 40.
    """

    case: str
    layout: str
    errors: np.ndarray
    order: int | None

    @property
    def observed(self) -> float:
        """The order between the two largest numbers of modules [1]."""
        return float(np.log2(np.abs(self.errors[-2] / self.errors[-1])))

    def needed(self, error: float) -> int:
        """The number of modules from which on errors are at most `error` [1].

        Between MODULES by straight lines in logarithmic scales, beyond them by the order.
        """
        size = np.abs(self.errors)
        above = np.flatnonzero(~(size <= error))
        if not above.size:
            return MODULES[0]
        i, slope = int(above[-1]), float(self.order or 1)
        if i < len(size) - 1:
            slope = math.log(size[i] / size[i + 1]) / math.log(MODULES[i + 1] / MODULES[i])
        return math.ceil(MODULES[i] * (size[i] / error) ** (1.0 / slope) * (1.0 - 1e-9))

    def checks(self) -> Iterator[Check]:
        """The order, or that the errors are zero."""
        what = f"{self.case}, {self.layout}"
        if self.order == 0:
            yield Check(f"{what}: largest error", float(np.max(np.abs(self.errors))), 1e-9)
        elif self.order is not None:
            low, high = self.order - _CLOSE, self.order + _CLOSE
            yield Check(f"{what}: order", self.observed, high, low)

    def to_dict(self) -> dict[str, Any]:
        """The errors for JSON; None where there is none."""
        errors = [None if math.isnan(x) else float(x) for x in self.errors]
        return {"case": self.case, "layout": self.layout, "error": errors}


class Study(NamedTuple):
    """The whole comparison.

    Attributes:
        motions: of the tip of the default rod let go, by name, shape (T, 2) [m].
        peer: likewise of the slim rod, beside PyElastica; empty where that is not installed.
    """

    curves: list[Curve]
    motions: dict[str, np.ndarray]
    peer: dict[str, np.ndarray]
    table: CheckTable

    def to_dict(self) -> dict[str, Any]:
        """The checks and the errors, for JSON."""
        curves = [curve.to_dict() for curve in self.curves]
        return self.table.to_dict() | {"modules": list(MODULES), "curves": curves}

    def __str__(self) -> str:
        """The errors as a table, and the checks."""
        notes = [
            "",
            "hinges: paper, at the ends of modules; centred, amid elements, with a rigid tip;",
            "half-half, amid modules, as no arm has them. Releases: distances in rod lengths.",
        ]
        notes += [] if self.peer else [rod_study.MISSING]
        return "\n".join([table(self.curves), *notes, "", str(self.table)])


def study(progress: Callable[[str], object] | None = None) -> Study:
    """Compares chains of MODULES with the default rod, and with one that tapers.

    The progress is called with the name of each part. Raises OctarmError if no static shape is
    found.
    """
    rod, curves = Rod(), list[Curve]()
    motions, peer = dict[str, np.ndarray](), dict[str, np.ndarray]()

    def listed(some: Iterator[Curve]) -> Iterator[Check]:
        for curve in some:
            curves.append(curve)
            yield from curve.checks()

    parts = {
        "closed forms": _closed_forms(rod),
        "statics": listed(_statics(rod)),
        "a rod that tapers": listed(_tapered()),
        "frequencies": listed(_frequencies(rod)),
        "motion": listed(_motion(rod, motions)),
    }
    if rod_study.installed():
        parts["PyElastica"] = _peer(peer)
    checks = run_checks(parts, progress)
    title = f"chains of up to {MODULES[-1]} modules against the extensible rod"
    return Study(curves, motions, peer, CheckTable(title, dataclasses.asdict(rod), 0, 0, checks))


def _closed_forms(rod: Rod) -> Iterator[Check]:
    beam = rod.length**3 / (3.0 * rod.at(rod.EI)(0.0))
    factors: dict[str, Callable[[int], float]] = {
        "paper": lambda n: 1.0 - 1.5 / n + 0.5 / n**2,
        "centred": lambda n: 1.0 - 0.25 / n**2,
    }
    for layout, factor in factors.items():
        errors = [
            abs(rod_study.tip_compliance(arm_from_rod(rod, n, layout)) / beam - factor(n))
            for n in range(1, MODULES[-1] + 1)
        ]
        yield Check(f"small tip load, {layout}: closed form", max(errors), 1e-9)


def _deflections(
    rod: Rod, case: str, force: np.ndarray, gravity: np.ndarray, orders: Sequence[int | None]
) -> Iterator[Curve]:
    """The deflection of the tip by a load along the rod or across it, in every layout."""
    along = bool(gravity[0])
    place, unloaded = (0, rod.length) if along else (1, 0.0)
    exact = rod_theory.static_tip(rod, force, gravity)[place] - unloaded
    for layout, order in zip((*ORDERS, HALVES), orders, strict=True):
        tips = [
            rod_study.halves_tip(rod, n, force, gravity)
            if layout == HALVES
            else rod_study.static_tip(arm_from_rod(rod, n, layout), force, gravity)
            for n in MODULES
        ]
        yield Curve(case, layout, (np.array(tips)[:, place] - unloaded) / exact - 1.0, order)


def _statics(rod: Rod) -> Iterator[Curve]:
    none, across = np.zeros(2), np.array([0.0, 1.0])
    yield from _deflections(rod, "small tip load", _SMALL * across, none, (1, 2, 2))
    yield from _large_load(rod)
    yield from _deflections(rod, "weight across", none, rod.gravity * across, (1, 2, 2))
    along = np.array([rod.gravity, 0.0])
    yield from _deflections(rod, "weight along", none, along, (1, 0, 0))


def _large_load(rod: Rod) -> Iterator[Curve]:
    # The rigid tip piece of the centred layout does not stretch, an error of first order.
    force = np.array([0.0, _force_for(rod, _ANGLE)])
    yield from _deflections(rod, "tip at 1 rad", force, np.zeros(2), (1, None, 2))


def _force_for(rod: Rod, angle: float) -> float:
    """The force across the tip [N] that turns it by an angle [rad]."""

    def beyond(force: float) -> float:
        return float(rod_theory.static_tip(rod, np.array([0.0, force]), np.zeros(2))[2]) - angle

    first = 2.0 * angle * rod.at(rod.EI)(0.0) / rod.length**2  # by linear theory
    return float(root_scalar(beyond, x0=first, x1=1.2 * first, method="secant", xtol=1e-10).root)


def _tapered() -> Iterator[Curve]:
    """Deflections of a rod whose properties change along it."""
    none, load, weight = np.zeros(2), np.array([0.0, _SMALL]), np.array([0.0, TAPERED.gravity])
    yield from _deflections(TAPERED, "small tip load, tapered", load, none, (1, 2, 2))
    yield from _deflections(TAPERED, "weight across, tapered", none, weight, (1, 2, 2))


def _frequencies(rod: Rod) -> Iterator[Curve]:
    bending, axial = rod_theory.bending_frequencies(rod, 3), rod_theory.axial_frequencies(rod, 1)
    for layout, order in ORDERS.items():
        chains = [rod_study.frequencies(arm_from_rod(rod, n, layout)) for n in MODULES]
        for k, exact in enumerate(bending):
            values = [b[k] if len(b) > k else math.nan for b, _ in chains]
            # In the paper's layout, what mass and hinges at the ends do to the first one cancels.
            known = None if layout == "paper" and k == 0 else order
            yield Curve(f"bending frequency {k + 1}", layout, np.array(values) / exact - 1.0, known)
        values = np.array([a[0] for _, a in chains])
        yield Curve("axial frequency 1", layout, values / axial[0] - 1.0, order)


def _motion(rod: Rod, motions: dict[str, np.ndarray]) -> Iterator[Curve]:
    """The largest distance of the tip of a chain let go from that of the rod, in .3 and 1 s."""
    motions["rod"] = rod_study.converged(rod)
    for layout, order in ORDERS.items():
        tips = [rod_study.released(arm_from_rod(rod, n, layout)) for n in MODULES]
        motions |= {f"{layout}, N = {n}": tip for n, tip in zip(MODULES, tips, strict=True)}
        for case, last in (("in .3 s", rod_study.FIRST), ("in 1 s", rod_study.SAMPLES)):
            exact, *others = (tip[: last + 1] for tip in (motions["rod"], *tips))
            errors = [rod_study.distance(rod, tip, exact) for tip in others]
            yield Curve(f"release, tip {case}", layout, np.array(errors), order)


def _peer(motions: dict[str, np.ndarray]) -> Iterator[Check]:
    """PyElastica's slim rod against the chain of its own discretisation, and extrapolated."""
    rod = rod_study.slim_rod()
    motions["rod"] = rod_study.converged(rod)
    peers = [rod_study.peer_released(rod, n) for n in rod_study.ELEMENTS]
    for n, tips in zip(rod_study.ELEMENTS, peers, strict=True):
        motions[f"PyElastica, n = {n}"] = tips
        chain = motions[f"the same chain, N = {n}"] = rod_study.released(rod_study.like(rod, n))
        apart = rod_study.distance(rod, tips, chain)
        yield Check(f"slim rod let go: PyElastica, n = {n}, against its chain", apart, _APART)
    # From n, 2n and 4n elements, without the errors of the orders 1/n and 1/n^2.
    limit = (peers[0] - 6.0 * peers[1] + 8.0 * peers[2]) / 3.0
    motions["PyElastica, extrapolated"] = limit
    part = slice(rod_study.FIRST + 1)
    apart = rod_study.distance(rod, limit[part], motions["rod"][part])
    # The weights of the extrapolation, in sum 5, magnify what PyElastica's rods differ by.
    what = "slim rod let go, .3 s: PyElastica extrapolated, against the rod"
    yield Check(what, apart, 5.0 * _APART)


def table(curves: Sequence[Curve]) -> str:
    """The errors of all curves in percent, observed orders, and how many modules are enough."""
    head = ("error [%] at N =", "layout", *map(str, MODULES), "order", "5 % from", "1 % from")
    rows = [head, *map(_row, curves)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    pads = [str.ljust] * 2 + [str.rjust] * (len(head) - 2)
    cells = [zip(pads, row, widths, strict=True) for row in rows]
    return "\n".join("  ".join(pad(x, width) for pad, x, width in row) for row in cells)


def _row(curve: Curve) -> tuple[str, ...]:
    errors = ["-" if math.isnan(x) else _percent(x) for x in curve.errors]
    order = f"{curve.observed:.2f}" if curve.order else "-"
    needed = ["1" if curve.order == 0 else str(curve.needed(x)) for x in (0.05, 0.01)]
    return (curve.case, curve.layout, *errors, order, *needed)


def _percent(error: float) -> str:
    percent = 100.0 * error
    if abs(percent) < 0.005:
        return "0"
    return f"{percent:.{0 if abs(percent) >= 99.5 else 1 if abs(percent) >= 9.95 else 2}f}"
