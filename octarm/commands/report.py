"""What `octarm report` does."""

from __future__ import annotations

import math
import os
import shlex
import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path

from octarm.commands.loops import Loops, loops_of
from octarm.commands.many_runs import ReportOptions
from octarm.commands.options import spelt
from octarm.errors import OctarmError, printable
from octarm.files import write_files
from octarm.formats import read_toml
from octarm.reports import report as reports
from octarm.reports.charts import pictures, scales_of
from octarm.reports.comparisons import TABLES, Comparisons, tables
from octarm.reports.consistency import Remark
from octarm.reports.figures import Picture
from octarm.reports.page import page
from octarm.sweeps.manifest import open_sweep
from octarm.sweeps.shards import schema
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import SPEC, metadata_of

PAGE = "report.html"
FIGURES = "figures"


def report(sweep: Path, options: ReportOptions) -> None:
    """`octarm report`: a page, tables and figures on a sweep."""
    folder = options.out or sweep / "report"
    _check_place(folder, sweep)
    name, numbers, remarked = reports.report(sweep, options.baseline, options.metric)
    loops = loops_of(sweep, numbers.episodes, options.run_code)
    drawn = list(pictures(numbers))
    files = tables(numbers)
    again = [str(sweep / SPEC), "--out", f"{os.path.normpath(sweep)}-again"]
    commands = [["sweep", *again], ["report", str(sweep), *spelt(options, "force")]]
    text = page(
        numbers,
        remarks=remarked,
        pictures=drawn,
        name=name,
        spec=read_toml(sweep / SPEC).text,
        commands=[shlex.join(["octarm", *words]) for words in commands],
        files=files,
        loops=loops.table(),
        of_loops=loops.caption,
    )
    _write(folder, text, files, drawn)
    _print_summary(numbers, remarked, loops)
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


def _print_summary(numbers: Comparisons, remarked: Sequence[Remark], loops: Loops) -> None:
    """A row a controller, the loops, and the warnings."""
    measure, scale = numbers.episodes.measures[0], scales_of(numbers.episodes)[0]
    unit = scale.unit or "1"
    print(f"controller            episodes  diverged  median {measure.name} [{unit}]")
    for group in numbers.of(None):
        middle, low, high = (scale.factor * float(x[0]) for x in group.medians)
        ends = "" if math.isnan(low) else f"  ({low:.3g} .. {high:.3g})"  # NaN of one seed a cell
        median = f"{middle:.3g}{ends}" if group.episodes else "none finished"
        print(f"{group.controller:<20} {group.episodes:>9} {group.failed:>9}  {median}")
    print(f"{loops.verdict}: the sampled loops about rest")
    for remark in remarked:
        print(f"{'warning' if remark.warning else 'note'}: {remark.text}")
