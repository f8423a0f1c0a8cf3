"""The sampled loops of a sweep about rest, beside what its episodes did.

A report runs no code that a folder names: laws that are not built in are left out unless their code
is asked for. Nor does it take other gains for those that the sweep had.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers import make_controller
from octarm.arm.groups import PAPER
from octarm.arm.mjcf import physics_step
from octarm.checks.sampled_loop import LinearPlant
from octarm.checks.stability import LoopAtRest, linear_plant, loop_at_rest
from octarm.commands.verify import announce
from octarm.errors import OctarmError, printable
from octarm.formats import to_json
from octarm.html import Cell, Table
from octarm.palette import look_of
from octarm.reports.frame import Episodes
from octarm.reports.page import number
from octarm.runs import folder as runs
from octarm.sweeps.spec import ARM, LAYOUT, PLANT_MODULES, SweepSpec

_MOST = 60  # rows of a page
_AXES = (ARM, LAYOUT, PLANT_MODULES, "mismatch")


class LoopRow(NamedTuple):
    """One controller on one plant.

    Attributes:
        where: the values of the axes that make the plant and the model, in words, by name.
        episodes: number of those that were simulated.
        diverged: number of those that did.
        poor: number of those and of others that tracked poorly, see `Episodes.poor`.
        disturbed: whether disturbances act in the sweep, which may do that by themselves.
    """

    controller: str
    where: Mapping[str, str]
    loop: LoopAtRest
    episodes: int
    diverged: int
    poor: int
    disturbed: bool

    @property
    def predicted(self) -> str:
        """What the loop says of the arm; empty if it says nothing."""
        return "" if self.loop.reason else "stable" if self.loop.stable else "unstable"

    @property
    def judged(self) -> bool:
        """Whether simulation can tell if the loop says the right thing."""
        by_disturbances = self.disturbed and self.loop.stable and self.poor > 0
        return not self.loop.reason and self.episodes > 0 and not by_disturbances

    @property
    def agrees(self) -> bool:
        """Whether simulation did what the loop says, or cannot tell."""
        return not self.judged or self.loop.stable == (self.poor == 0)


class Loops(NamedTuple):
    """The loops of a sweep: of each plant, a row a controller, as many as a page holds."""

    rows: list[LoopRow]
    planned: int  # number of all rows
    period: float  # the control period of the sweep [s]
    drawn: bool  # whether the mismatch of the models was, so that the rows have exact models

    @property
    def caption(self) -> str:
        """What the table says and does not say."""
        return (
            "Linear about rest, without disturbances, at the control period of the sweep"
            f"{', with exact models, where the sweep draws them' if self.drawn else ''}. The "
            "margin is the longest stable period over that one. Poor are episodes that diverged, "
            "or in which a coordinate had more than a tenth of the error of hanging still. "
            f"{self.verdict}; the others are coloured: a loop that is stable about rest may do "
            "poorly in a large motion. Where disturbances act, which may do that by themselves, "
            "only loops that are predicted as unstable, or do well, can tell."
        )

    @property
    def verdict(self) -> str:
        """In how many rows simulation did what the loop says."""
        known = [row for row in self.rows if row.judged]
        left = f" of the first {len(self.rows)} of all {self.planned}"
        return (
            f"Prediction and simulation agree in {sum(row.agrees for row in known)} of "
            f"{len(known)} rows{left if self.planned > len(self.rows) else ''} that can tell"
        )

    def table(self) -> Table:
        """The rows as a table of a page."""
        group, ms = len({row.controller for row in self.rows}), f"{1e3 * self.period:g}"
        head = [
            Cell("controller", [", ".join(self.rows[0].where)], "left"),
            Cell("predicted"),
            Cell("poor in", ["simulation"]),
            Cell("longest period", ["[ms]"]),
            Cell("margin", [f"over {ms} ms"]),
            Cell("spectral radius", [f"at {ms} ms"]),
            Cell("first to grow", ["beyond the longest period"], "left"),
        ]
        return Table(head, [_cells(row) for row in self.rows], group)


def _cells(row: LoopRow) -> list[Cell]:
    loop, where = row.loop, [", ".join(map(" ".join, row.where.items()))]
    kind = "even" if row.agrees else "bad"
    diverged = [f"{row.diverged} diverged"] if row.diverged else []
    first, *mode = loop.first if loop.mode is not None else (loop.reason or "-",)
    return [
        Cell(row.controller, where, "left", look_of(row.controller).color),
        Cell(row.predicted or "-", kind=kind),
        Cell(f"{row.poor} of {row.episodes}", diverged, kind),
        Cell(number(1e3 * loop.longest)),
        Cell(number(loop.longest / loop.period)),
        Cell("-" if loop.reason else f"{loop.radius:.4f}"),
        Cell(first, mode, "wide" if loop.reason else "left"),
    ]


def loops_of(folder: Path, episodes: Episodes, run_code: bool) -> Loops:
    """The loops of a sweep and of its episodes; with `run_code` those of other laws, too."""
    spec, gains = episodes.spec, episodes.manifest["gains"]
    step = physics_step() if spec.timestep is None else float(spec.timestep)
    period = step if spec.control_period is None else spec.control_period
    axes = [axis for axis in spec.axes if axis.name in _AXES]
    values = [a.values if a.words else sorted(map(float, a.values)) for a in axes]
    factors = {factor.name: factor for factor in episodes.factors}
    reasons = {name: _left_out(folder, spec, name, gains, run_code) for name in spec.controllers}

    @functools.cache
    def plant(arm: str, modules: int | None, layout: str) -> LinearPlant:
        return linear_plant(spec.arm(arm), spec.groups(arm, modules, layout))

    def row(which: int, name: str, *places: tuple[int, Any]) -> LoopRow:
        value: dict[str, Any] = {a.name: x for a, (_, x) in zip(axes, places, strict=True)}
        arm, here, where = value.get(ARM, ""), episodes.controller == which, dict[str, str]()
        for axis, (level, _) in zip(axes, places, strict=True):
            if factor := factors.get(axis.name):
                here = here & (factor.code == level)
                where[factor.title] = factor.labels[level]
        loop = LoopAtRest(period, reason=reasons[name])
        if not loop.reason:
            model = spec.believed(arm).mismatched(value.get("mismatch", 0.0))
            law = spec.controller(name, model, make_controller)
            modules = int(value[PLANT_MODULES]) if PLANT_MODULES in value else None
            this = plant(arm, modules, value.get(LAYOUT, PAPER))
            loop = loop_at_rest(this, law, period)
        all_of, diverged, poor = (
            int(np.sum(x[here])) for x in (here, episodes.diverged, episodes.poor)
        )
        label, disturbed = episodes.controllers[which], bool(spec.disturbances)
        return LoopRow(label, where, loop, all_of, diverged, poor, disturbed)

    asked: Any = itertools.product(*map(enumerate, values), enumerate(spec.controllers))
    rows = [row(*law, *places) for *places, law in itertools.islice(asked, _MOST)]
    planned = len(spec.controllers) * math.prod(map(len, values))
    return Loops(rows, planned, period, any(axis.name == "mismatch" for axis in spec.random))


def _left_out(
    folder: Path, spec: SweepSpec, name: str, gains: Mapping[str, Any], run_code: bool
) -> str:
    """Why nothing is said of a controller, a sentence; empty if it is what the sweep had."""
    if name in spec.code and not run_code:
        return "a report runs no code of your own unless --run-code is given"
    try:
        if name in spec.code:
            announce(folder, {name: spec.code[name]})
        law = spec.controller(name, spec.all_believed()[0], make_controller)
    except OctarmError as error:
        return printable(str(error))
    if to_json(runs.gains_of(law)) != to_json(gains[name]):
        return "its gains are not those that the sweep had"
    return ""
