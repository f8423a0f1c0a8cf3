"""The page of a sweep's report: one HTML file that needs nothing beside itself."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from octarm.html import Cell, Table, templates
from octarm.palette import look_of
from octarm.reports.charts import Scale, scales_of
from octarm.reports.comparisons import Comparisons, Group, PairedDifference
from octarm.reports.consistency import Remark
from octarm.reports.factors import Factor
from octarm.reports.figures import Picture
from octarm.reports.statistics import CONFIDENCE, FEWEST, Interval


def page(
    comparisons: Comparisons,
    *,
    remarks: Iterable[Remark],
    pictures: Iterable[Picture],
    name: str,
    spec: str,
    commands: Sequence[str],
    files: Iterable[str],
    loops: Table,
    of_loops: str,
) -> str:
    """The page as text, the same for the same numbers.

    It is of the sweep of this name, with its spec as TOML text, commands that make the sweep and
    the report again, and names of files beside the page. A table of sampled loops has a caption.
    """
    manifest = comparisons.episodes.manifest
    machines = (_machine(start["host"]) for start in manifest["starts"])
    gains = (f"{name}: {json.dumps(gains)}" for name, gains in manifest["gains"].items())
    template = templates().get_template("report.html")
    return template.render(
        comparisons._asdict(),
        manifest=manifest,
        remarks=list(remarks),
        page=Tables(comparisons),
        pictures=list(pictures),
        name=name,
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


def _machine(host: Mapping[str, Any]) -> str:
    names = [str(host[key]) for key in ("cpu", "machine") if key in host]
    return ", ".join([*names, *([f"{host['cores']} cores"] if "cores" in host else [])])


class Tables:
    """The tables of a report."""

    def __init__(self, comparisons: Comparisons) -> None:
        """The tables of these numbers."""
        self._comparisons = comparisons
        self._measures = comparisons.episodes.measures
        self._names = comparisons.episodes.controllers
        self._scales = scales_of(comparisons.episodes)

    def medians(self, factor: Factor | None) -> Table:
        """The medians at each level of a factor, or in the whole sweep."""
        groups = self._comparisons.of(factor)
        head = self._head(factor, Cell("episodes"), Cell("diverged", ["95 % interval"]))
        rows: list[list[Cell]] = []
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
                if measure.sign and pairs:
                    even = f", {ties} even" if (ties := pairs - won - lost) else ""
                    small = [*small, f"won {won} of {pairs}{even}"]
                cells.append(Cell(text, small, _judged(d, j, measure.sign)))
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
        """The headings of a level, of a controller, of counts, and of the measures."""
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
            order = np.abs(values) if measure.declared.zero_best else measure.sign * values
            matters = values.size and measure.sign and len(groups) > 1
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
