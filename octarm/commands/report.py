"""What `octarm report` does, and the sampled loops about rest beside what episodes did.

A report runs no code that a folder names: laws that are not built in are left out unless their code
is asked for. Nor does it take other gains for those that the sweep had.
"""

from __future__ import annotations

import functools
import itertools
import math
import os
import shlex
import shutil
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers import make_controller
from octarm.arm.groups import PAPER
from octarm.arm.mjcf import physics_step
from octarm.checks.sampled_loop import LinearPlant
from octarm.checks.stability import LoopAtRest, linear_plant, loop_at_rest
from octarm.commands.many_runs import ReportOptions
from octarm.commands.options import spelt
from octarm.commands.verify import announce
from octarm.errors import OctarmError, printable
from octarm.files import write_files
from octarm.formats import read_toml, to_json
from octarm.html import Cell, Table
from octarm.palette import look_of
from octarm.reports import report as reports
from octarm.reports.charts import pictures, scales_of
from octarm.reports.comparisons import TABLES, tables
from octarm.reports.figures import Picture
from octarm.reports.frame import Episodes
from octarm.sweeps.shards import schema
from octarm.sweeps.spec import ARM, LAYOUT, PLANT_MODULES, SweepSpec
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import SPEC, metadata_of, open_sweep

PAGE = "report.html"
FIGURES = "figures"
_MOST = 60  # rows of a page
_AXES = (ARM, LAYOUT, PLANT_MODULES, "mismatch")


def report(sweep: Path, options: ReportOptions) -> None:
    """`octarm report`: a page, tables and figures on a sweep."""
    folder = options.out or sweep / "report"
    _check_place(folder, sweep)
    made = reports.report(sweep, options.baseline, options.metric)
    numbers = made.comparisons
    loops = loops_of(sweep, numbers.episodes, options.run_code)
    drawn = list(pictures(numbers))
    files = tables(numbers)
    again = [str(sweep / SPEC), "--out", f"{os.path.normpath(sweep)}-again"]
    commands = [["sweep", *again], ["report", str(sweep), *spelt(options, "force")]]
    text = reports.page(
        made,
        pictures=drawn,
        spec=read_toml(sweep / SPEC).text,
        commands=[shlex.join(["octarm", *words]) for words in commands],
        files=files,
        loops=loops.table(),
        of_loops=loops.caption,
    )
    _write(folder, text, files, drawn)
    _print_summary(made, loops)
    print(f"wrote {printable(str(folder / PAGE))}")


def columns(sweep: Path | None) -> None:
    """`octarm report --columns`: what the columns of a table mean, a row each."""
    spec = parse_spec('controller = "smc"') if sweep is None else open_sweep(sweep)[0].spec
    rows = [("column", "unit", "better", "meaning")]
    for field in schema(spec):
        said = {key.decode(): text.decode() for key, text in metadata_of(field).items()}
        rows.append((field.name, said.get("unit", ""), said.get("better", ""), said["text"]))
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    # Where nobody reads it in a terminal, lines are as long as those of a page of text.
    width = max(shutil.get_terminal_size((100, 24)).columns, sum(widths) + 36)
    for row in rows:
        cells = (cell.ljust(size) for cell, size in zip(row, widths, strict=False))
        head = "  ".join([*cells, ""])
        print(textwrap.fill(printable(row[3]), width, initial_indent=head,
                            subsequent_indent=" " * len(head)))  # fmt: skip


def _check_place(out: Path, sweep: Path) -> None:
    """Raises OctarmError if the folder holds something else; an earlier report is replaced."""
    if out.exists() and not out.is_dir():
        raise OctarmError(f"{out} is not a folder; choose another --out")
    if out.resolve() == sweep.resolve():
        raise OctarmError(f"{out} is the sweep itself; choose another --out")
    present = {entry.name for entry in (out.iterdir() if out.is_dir() else ())}
    if PAGE not in present and present - {FIGURES, *TABLES}:
        raise OctarmError(f"{out} exists and is not a report; choose another --out")


def _write(out: Path, text: str, files: dict[str, str], drawn: list[Picture]) -> None:
    """Writes the report, whole or not at all; the page, last, makes it one."""
    contents = {out / name: content.encode() for name, content in files.items()}
    for picture in drawn:
        contents |= picture.files(out / FIGURES)
    page_bytes = text.encode(errors="backslashreplace")  # names of files may be any bytes
    write_files({**contents, out / PAGE: page_bytes})
    earlier = [out / name for name in TABLES]
    for start in ("degradation-", "distributions", "map-", "failures"):
        earlier += (out / FIGURES).glob(f"{start}*")
    for file in earlier:
        if file not in contents:
            file.unlink(missing_ok=True)  # of another choice of metrics


def _print_summary(made: reports.Report, loops: Loops) -> None:
    """A row a controller, the loops, and the warnings."""
    numbers = made.comparisons
    measure, scale = numbers.episodes.measures[0], scales_of(numbers.episodes)[0]
    unit = scale.unit or "1"
    print(f"controller            episodes  diverged  median {measure.name} [{unit}]")
    for group in numbers.of(None):
        middle, low, high = (scale.factor * float(x[0]) for x in group.medians)
        ends = "" if math.isnan(low) else f"  ({low:.3g} .. {high:.3g})"  # NaN of one seed a cell
        median = f"{middle:.3g}{ends}" if group.episodes else "none finished"
        print(f"{group.controller:<20} {group.episodes:>9} {group.failed:>9}  {median}")
    print(f"{loops.verdict}: the sampled loops about rest")
    for remark in made.remarks:
        print(f"{'warning' if remark.warning else 'note'}: {remark.text}")


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
        Cell(reports.number(1e3 * loop.longest)),
        Cell(reports.number(loop.longest / loop.period)),
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
        made = spec.stated_gains(name, make_controller)
    except OctarmError as error:
        return printable(str(error))
    if to_json(made) != to_json(gains[name]):
        return "its gains are not those that the sweep had"
    return ""
