"""The page of a sweep's report: one HTML file that needs nothing beside itself."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np

from octarm.metrics.metric import SETTLED_AFTER
from octarm.reports.charts import Scale, scale_of
from octarm.reports.comparisons import Comparisons, Group, outcomes
from octarm.reports.consistency import Remark
from octarm.reports.figures import COLORS, Picture
from octarm.reports.frame import Factor
from octarm.reports.statistics import RESAMPLES, Interval


class Source(NamedTuple):
    """Where a report comes from.

    Attributes:
        name: of the sweep.
        spec: its TOML text.
        commands: that make the sweep and the report again.
        files: names of the files beside the page.
    """

    name: str
    spec: str
    commands: Sequence[str]
    files: Sequence[str]


class Cell(NamedTuple):
    """A cell of a table.

    Attributes:
        text: its content.
        small: lines below it.
        kind: class names of the style.
        color: of a dot before the text.
    """

    text: str
    small: Sequence[str] = ()
    kind: str = ""
    color: str = ""


class Table(NamedTuple):
    """A table of a page, for the macro `table` of `parts.html`.

    Attributes:
        head: the headings.
        rows: the cells of each row.
        group: number of rows that belong together, which a line sets off.
    """

    head: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]
    group: int = 1


def templates(*folders: Path) -> jinja2.Environment:
    """Templates in folders, and `base.html` and `parts.html`, with which all pages look alike."""
    package = jinja2.PackageLoader("octarm.reports")
    return jinja2.Environment(
        loader=jinja2.ChoiceLoader([*map(jinja2.FileSystemLoader, folders), package]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def page(
    comparisons: Comparisons,
    remarks: Iterable[Remark],
    pictures: Iterable[Picture],
    source: Source,
) -> str:
    """The page as text; the same for the same numbers."""
    episodes = comparisons.episodes
    manifest = episodes.manifest
    machines = [_machine(start["host"]) for start in manifest["starts"]]
    versions = manifest["starts"][0]["versions"]
    gains = (f"{name}: {json.dumps(gains)}" for name, gains in manifest["gains"].items())
    return (
        templates()
        .get_template("report.html")
        .render(
            title=f"Sweep report: {source.name}",
            lead=_lead(comparisons),
            remarks=list(remarks),
            page=Tables(comparisons),
            baseline=comparisons.baseline,
            pictures=list(pictures),
            factors=episodes.factors,
            source=source,
            seeds=len(np.unique(episodes.seed)),
            resamples=RESAMPLES,
            undirected=any(measure.sign == 0 for measure in episodes.measures),
            settled_after=f"{SETTLED_AFTER:g}",
            versions=", ".join(f"{name} {version}" for name, version in versions.items()),
            machines="; ".join(dict.fromkeys(machines)),
            gains="\n".join(gains),
            spec_hash=manifest["spec_hash"],
        )
    )


def _lead(comparisons: Comparisons) -> str:
    episodes, spec = comparisons.episodes, comparisons.episodes.manifest["spec"]
    grid = [_several(len(episodes.controllers), "controller")]
    for factor in episodes.factors:
        if not factor.drawn:
            grid.append(f"{_several(len(factor.labels), 'value')} of {factor.name}")
    grid.append(_several(spec["episodes"], "seed"))
    parts = [f"{len(episodes.seed)} episodes of {spec['duration']:g} s: {' × '.join(grid)}"]
    if drawn := [factor.name for factor in episodes.factors if factor.drawn]:
        parts.append(f"{', '.join(drawn)} drawn for each seed")
    parts.append("every controller meets the same random numbers")
    return "; ".join(parts) + "."


def _several(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _machine(host: Mapping[str, Any]) -> str:
    names = [str(host[key]) for key in ("cpu", "machine") if key in host]
    return ", ".join([*names, *([f"{host['cores']} cores"] if "cores" in host else [])])


class Tables:
    """The tables of a report."""

    def __init__(self, comparisons: Comparisons) -> None:
        """The tables of these numbers."""
        self._comparisons = comparisons
        self._measures, self._names = (
            comparisons.episodes.measures,
            comparisons.episodes.controllers,
        )
        self._scales = [scale_of(comparisons.episodes, measure) for measure in self._measures]

    def medians(self, factor: Factor | None) -> Table:
        """The medians at each level of a factor, or in the whole sweep."""
        groups = self._comparisons.of(factor)
        small = ["95 % interval"]
        head = [Cell("controller", kind="left"), Cell("episodes"), Cell("diverged", small)]
        rows: list[list[Cell]] = []
        for group in groups:
            cells = [*self._where(group), Cell(str(group.episodes)), _failed(group)]
            best = self._best([g for g in groups if g.level == group.level])
            for j, scale in enumerate(self._scales):
                kind = "best" if group.medians.value[j] == best[j] else ""
                cells.append(Cell(*_estimate(group.medians, j, scale), kind))
            rows.append(cells)
        return Table([*_axis(factor), *head, *self._headings()], rows, len(self._names))

    def differences(self, factor: Factor | None) -> Table:
        """The paired differences from the baseline, likewise."""
        pairs = Cell("pairs", ["diverged: this,", "other, both"])
        head = [*_axis(factor), Cell("controller", kind="left"), pairs, *self._headings()]
        rows: list[list[Cell]] = []
        for group in self._comparisons.of(factor):
            if (d := group.difference) is None:
                continue
            missing = f"; {d.unpaired} without partner" if d.unpaired else ""
            fell = f"{d.alone}, {d.other}, {d.both}{missing}"
            cells = [*self._where(group), Cell(str(d.pairs), [fell])]
            for j, (measure, scale) in enumerate(zip(self._measures, self._scales, strict=True)):
                difference = d.measured.difference
                text, small = _estimate(difference, j, scale, signed=True)
                won = _won(*outcomes(self._comparisons, d, j), int(d.measured.pairs[j]))
                cells.append(Cell(text, [*small, won], _verdict(measure.sign, difference, j)))
            rows.append(cells)
        return Table(head, rows, len(self._names) - 1)

    def meanings(self) -> Table:
        """A row for each measure."""
        head = [Cell(text, kind="left") for text in ("metric", "meaning", "unit", "better")]
        rows: list[list[Cell]] = []
        for m in self._measures:
            better = "nearer to zero" if m.declared.zero_best else m.declared.better
            texts = {m.name: "left", m.text: "wide", m.unit: "left", better: "left"}
            rows.append([Cell(text, kind=kind) for text, kind in texts.items()])
        return Table(head, rows, len(rows))

    def _headings(self) -> list[Cell]:
        """The headings of the measures."""
        cells: list[Cell] = []
        for measure, scale in zip(self._measures, self._scales, strict=True):
            unit = f" [{scale.unit}]" if scale.unit else ""
            cells.append(Cell(measure.metric.replace("_", " "), [measure.of + unit]))
        return cells

    def _where(self, group: Group) -> list[Cell]:
        color = COLORS[self._names.index(group.controller) % len(COLORS)]
        level = [] if group.factor is None else [Cell(group.label, kind="left")]
        return [*level, Cell(group.controller, kind="left", color=color)]

    def _best(self, groups: Sequence[Group]) -> list[float]:
        """The best median of each measure; NaN where there is nothing to be best at."""
        best: list[float] = []
        for j, measure in enumerate(self._measures):
            values = np.array([group.medians.value[j] for group in groups], dtype=float)
            values = values[np.isfinite(values)]
            order = np.abs(values) if measure.declared.zero_best else measure.sign * values
            none = not values.size or not measure.sign or len(groups) < 2
            best.append(math.nan if none else float(values[np.argmin(order)]))
        return best


def _axis(factor: Factor | None) -> list[Cell]:
    return [] if factor is None else [Cell(factor.title, kind="left")]


def _failed(group: Group) -> Cell:
    share, low, high = (100.0 * x for x in group.failures)
    if math.isnan(share):
        return Cell("-")
    return Cell(str(group.failed), [f"{low:.1f} .. {high:.1f} %"])


def _won(won: Any, lost: Any, pairs: int) -> str:
    if isinstance(won, float) or not pairs:
        return ""
    ties = pairs - won - lost
    return f"won {won} of {pairs}" + (f", {ties} even" if ties else "")


def _verdict(sign: int, difference: Interval, j: int) -> str:
    low, high = sign * difference.low[j], sign * difference.high[j]
    if max(low, high) < 0.0:
        return "good"
    return "bad" if min(low, high) > 0.0 else "even"


def _estimate(
    interval: Interval, j: int, scale: Scale, *, signed: bool = False
) -> tuple[str, list[str]]:
    """A value, and a line with its interval if there is one."""
    value, low, high = (scale.factor * float(x[j]) for x in interval)
    text = number(value, signed=signed)
    if math.isnan(low) or math.isnan(high) or (math.isinf(value) and low == high):
        return text, []
    return text, ["no spread" if low == value == high else f"{number(low)} .. {number(high)}"]


def number(value: float, *, signed: bool = False) -> str:
    """Three digits; a dash for NaN."""
    if math.isnan(value):
        return "-"
    size = abs(value)
    if math.isinf(value):
        text = "∞"
    else:
        text = f"{size:.0f}" if 99.95 <= size < 1e6 else f"{size:#.3g}"
    plus = "+" if signed and value > 0.0 else ""
    return ("−" if value < 0.0 else plus) + text
