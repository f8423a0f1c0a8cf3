"""The report on a sweep: its numbers, and the page, one HTML file that needs nothing beside it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from octarm.html import Cell, Table, notebook_cell, templates
from octarm.palette import look_of
from octarm.reports.charts import Scale, scales_of
from octarm.reports.comparisons import Comparisons, Group, PairedDifference, compare
from octarm.reports.consistency import Remark, remarks
from octarm.reports.factors import Factor
from octarm.reports.figures import Picture
from octarm.reports.frame import read_episodes
from octarm.reports.statistics import CONFIDENCE, FEWEST, Interval


class Report(NamedTuple):
    """What a report on a sweep of this name is made of; remarks have the warnings first."""

    name: str
    comparisons: Comparisons
    remarks: Sequence[Remark]

    def _repr_html_(self) -> str:
        lines = [f"{'Warning: ' * each.warning}{each.text}" for each in self.remarks]
        lines.append("Medians, and their 95 % intervals or ranges below; the best ones are bold.")
        table = Tables(self.comparisons).medians(None)
        return notebook_cell(f"Report on {self.name}", lines, table)


def report(sweep: str | Path, baseline: str | None = None, metrics: Sequence[str] = ()) -> Report:
    """The report on a sweep, as `octarm report` writes it.

    Given are the folder of the sweep, the controller that others are compared with, or its
    MODULE:NAME or FILE.py:NAME, the spec's first one if None, and names of metrics, or of columns
    of the sweep's table, the usual ones if empty. Raises OctarmError if it is no sweep, has no
    finished episode, or a name is unknown.
    """
    folder = Path(sweep)
    episodes = read_episodes(folder, metrics)
    names = {each.path: name for name, each in episodes.spec.code.items()}
    called = None if baseline is None else names.get(baseline, baseline)
    return Report(folder.resolve().name, compare(episodes, called), remarks(episodes))


def page(
    report: Report,
    *,
    pictures: Sequence[Picture],
    spec: str,
    commands: Sequence[str],
    files: Iterable[str],
    loops: Table,
    of_loops: str,
) -> str:
    """The page as text, the same for the same numbers.

    It has the spec as TOML text, commands that make the sweep and the report again, and names of
    files beside the page. A table of sampled loops has a caption.
    """
    comparisons = report.comparisons
    manifest = comparisons.episodes.manifest
    machines: list[str] = []
    for host in (start["host"] for start in manifest["starts"]):
        words = [str(host[key]) for key in ("cpu", "machine") if key in host]
        words += [f"{host['cores']} cores"] if "cores" in host else []
        machines.append(", ".join(words))
    gains = (f"{name}: {json.dumps(gains)}" for name, gains in manifest["gains"].items())
    template = templates().get_template("report.html")
    return template.render(
        comparisons._asdict(),
        manifest=manifest,
        remarks=report.remarks,
        page=Tables(comparisons),
        pictures=pictures,
        name=report.name,
        spec=spec,
        commands=commands,
        files=files,
        loops=loops,
        of_loops=of_loops,
        seeds=len(np.unique(comparisons.episodes.seed)),
        fewest=FEWEST,
        settled_after=f"{comparisons.episodes.spec.settle:g}",
        machines="; ".join(dict.fromkeys(machines)),
        gains="\n".join(gains),
    )


class Tables:
    """The tables of a report."""

    def __init__(self, comparisons: Comparisons) -> None:
        self._comparisons = comparisons
        self._measures = comparisons.episodes.measures
        self._names = comparisons.episodes.controllers
        self._scales = scales_of(comparisons.episodes)

    def medians(self, factor: Factor | None) -> Table:
        """The medians at each level of a factor, or in the whole sweep."""
        groups, rows = self._comparisons.of(factor), list[list[Cell]]()
        head = self._head(factor, Cell("episodes"), Cell("diverged", ["95 % interval"]))
        for group in groups:
            low, high = (100.0 * x for x in group.failures[1:])
            failed = Cell(str(group.failed), [f"{low:.1f} .. {high:.1f} %"])
            counts = [Cell(str(group.episodes)), failed]
            if not group.episodes:
                counts = [Cell("0", ["none finished"]), Cell("-")]
            best = self._best([g for g in groups if g.level == group.level])
            row = [*self._where(group), *counts]
            for j, scale in enumerate(self._scales):
                kind = "best" if group.medians.value[j] == best[j] else ""
                row.append(Cell(*_estimate(group.medians, group.seeds, j, scale), kind))
            rows.append(row)
        return Table(head, rows, len(self._names))

    def differences(self, factor: Factor | None) -> Table:
        """The paired differences from the baseline, likewise."""
        head = self._head(factor, Cell("pairs", ["diverged: this,", "other, both"]))
        rows: list[list[Cell]] = []
        for group in self._comparisons.of(factor):
            if (d := group.difference) is None:
                continue
            missing = f"; {d.unpaired} without partner" if d.unpaired else ""
            fell = f"{d.alone}, {d.other}, {d.both}{missing}"
            cells = [*self._where(group), Cell(str(d.pairs), [fell])]
            for j, (measure, scale) in enumerate(zip(self._measures, self._scales, strict=True)):
                found = d.measured.difference, d.measured.seeds
                text, small = _estimate(*found, j, scale, signed=True)
                pairs, won, lost = (x[j] for x in d.measured[:3])
                if measure.declared.sign and pairs:
                    even = f", {ties} even" if (ties := pairs - won - lost) else ""
                    small = [*small, f"won {won} of {pairs}{even}"]
                cells.append(Cell(text, small, _judged(d, j, measure.declared.sign)))
            rows.append(cells)
        return Table(head, rows, len(self._names) - 1)

    def meanings(self) -> Table:
        """A row for each measure."""
        head = [Cell(text, kind="left") for text in ("metric", "meaning", "unit", "better")]
        rows: list[list[Cell]] = []
        for m, scale in zip(self._measures, self._scales, strict=True):
            better = m.declared.direction
            texts = {m.name: "left", m.text: "wide", scale.unit or "1": "left", better: "left"}
            rows.append([Cell(text, kind=kind) for text, kind in texts.items()])
        return Table(head, rows, len(rows))

    def _head(self, factor: Factor | None, *counts: Cell) -> list[Cell]:
        axis = [] if factor is None else [Cell(factor.title, kind="left")]
        cells = [*axis, Cell("controller", kind="left"), *counts]
        for measure, scale in zip(self._measures, self._scales, strict=True):
            unit = f" [{scale.unit}]" if scale.unit else ""
            cells.append(Cell(measure.metric.replace("_", " "), [measure.of + unit]))
        return cells

    def _where(self, group: Group) -> list[Cell]:
        level = [] if group.factor is None else [Cell(group.label, kind="left")]
        return [*level, Cell(group.controller, kind="left", color=look_of(group.controller).color)]

    def _best(self, groups: Sequence[Group]) -> list[float]:
        """The best median of each measure; NaN where there is nothing to be best at."""
        best: list[float] = []
        for j, measure in enumerate(self._measures):
            values = np.array([group.medians.value[j] for group in groups], dtype=float)
            values = values[np.isfinite(values)]
            order = np.abs(values) if measure.declared.zero_best else measure.declared.sign * values
            matters = values.size and measure.declared.sign and len(groups) > 1
            best.append(float(values[np.argmin(order)]) if matters else math.nan)
        return best


def _estimate(
    interval: Interval, seeds: np.ndarray, j: int, scale: Scale, *, signed: bool = False
) -> tuple[str, list[str]]:
    """A value of so many seeds, and a line with its interval or range if there is one."""
    value, low, high = (scale.factor * float(x[j]) for x in interval)
    text = number(value, signed=signed)
    if math.isnan(low) or math.isnan(high) or (math.isinf(value) and low == high):
        return text, []
    ends = f"{number(low)} .. {number(high)}{' range' if seeds[j] < FEWEST else ''}"
    return text, ["no spread" if low == value == high else ends]


def _judged(difference: PairedDifference, j: int, sign: int) -> str:
    """The style of a difference, which is better or worse when it is unlikely to be chance."""
    sure = difference.chance[j] <= 1.0 - CONFIDENCE + 1e-12  # not for NaN
    value = sign * difference.measured.difference.value[j]
    return "even" if not sure or value == 0.0 else "good" if value < 0.0 else "bad"


def number(value: float, *, signed: bool = False) -> str:
    """Three digits; a dash for NaN."""
    if math.isnan(value):
        return "-"
    size = abs(value)
    text = f"{size:.0f}" if 99.95 <= size < 1e6 else f"{size:#.3g}"
    text = "∞" if math.isinf(value) else text
    plus = "+" if signed and value > 0.0 else ""
    return ("−" if value < 0.0 else plus) + text
