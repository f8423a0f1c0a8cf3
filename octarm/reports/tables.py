"""The tables of a sweep's page."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from octarm.metrics.table import SETTLED_AFTER
from octarm.reports.episodes import Axis
from octarm.reports.findings import Entry, Report, outcomes
from octarm.reports.measures import Measure
from octarm.reports.panels import COLORS, Scale, label_of, scale_of
from octarm.reports.statistics import RESAMPLES


def escaped(value: object) -> str:
    """Escaped for HTML."""
    return html.escape(str(value))


class Tables:
    """The tables of a report, as HTML."""

    def __init__(self, report: Report) -> None:
        """Tables of a report."""
        self._report = report
        self._measures = report.episodes.measures
        self._scales = [scale_of(report, measure) for measure in self._measures]

    def glance(self) -> str:
        """A row a controller, over the whole sweep."""
        entries = self._report.of(None)
        parts = [self._medians(None, entries)]
        if self._report.baseline:
            parts.append(f"<h3>{escaped(self._against())}</h3>")
            parts.append(self._differences(None, entries))
        return "\n".join(parts)

    def tables(self, files: Sequence[str]) -> str:
        """The same for each axis."""
        links = ", ".join(f'<a href="{escaped(name)}">{escaped(name)}</a>' for name in files)
        parts = [f"<p>All numbers in SI units, beside this page: {links}.</p>"]
        for axis in self._report.episodes.axes:
            entries = self._report.of(axis)
            parts.append(details(f"Medians by {axis.name}", self._medians(axis, entries)))
            if self._report.baseline:
                table = self._differences(axis, entries)
                parts.append(details(f"{self._against()}, by {axis.name}", table))
        return "\n".join(parts)

    def meanings(self) -> str:
        """A row a measure, then what the statistics are."""
        better = {1: "less", -1: "more", 0: "neither"}
        rows = [
            f'<tr><td class="left">{escaped(m.name)}</td><td class="wide">{escaped(m.text)}</td>'
            f'<td class="left">{escaped(m.unit)}</td>'
            f'<td class="left">{"nearer to zero" if m.by_size else better[m.sign]}</td></tr>'
            for m in self._measures
        ]
        head = "".join(
            f'<th class="left">{h}</th>' for h in ("metric", "meaning", "unit", "better")
        )
        notes = "\n".join(f"<p>{escaped(note)}</p>" for note in _notes(self._report))
        return f"{_table(head, rows, '')}\n{notes}"

    def _against(self) -> str:
        return f"Against {self._report.baseline}, same seed and cell"

    def _medians(self, axis: Axis | None, entries: Sequence[Entry]) -> str:
        head = _axis_heading(axis) + '<th class="left">controller</th><th>episodes</th>'
        head += "<th>diverged<small>95 % interval</small></th>" + self._headings()
        rows: list[str] = []
        names = self._report.episodes.controllers
        for entry in entries:
            cells = [self._where(axis, entry), f"<td>{entry.episodes}</td>", _failed(entry)]
            best = self._best([e for e in entries if e.place == entry.place])
            for j, scale in enumerate(self._scales):
                value = entry.medians.value[j]
                kind = ' class="best"' if not np.isnan(value) and value == best[j] else ""
                cells.append(f"<td{kind}>{_estimate(entry.medians, j, scale)}</td>")
            rows.append(_row(cells, first=entry.controller == names[0]))
        caption = "Median, and its 95 % interval below; the best median of each group is bold."
        return _table(head, rows, caption)

    def _differences(self, axis: Axis | None, entries: Sequence[Entry]) -> str:
        head = _axis_heading(axis) + '<th class="left">controller</th>'
        head += "<th>pairs<small>diverged: this,<br/>other, both</small></th>"
        head += self._headings()
        rows: list[str] = []
        names = [n for n in self._report.episodes.controllers if n != self._report.baseline]
        for entry in entries:
            if (c := entry.comparison) is None:
                continue
            fell = f"{c.alone}, {c.other}, {c.both}"
            missing = f"; {c.unpaired} without partner" if c.unpaired else ""
            cells = [self._where(axis, entry), f"<td>{c.pairs}<small>{fell}{missing}</small></td>"]
            for j, (measure, scale) in enumerate(zip(self._measures, self._scales, strict=True)):
                won, lost = outcomes(measure, c, j)
                told = f"<small>{_won(won, lost, int(c.measured.pairs[j]))}</small>"
                kind = _verdict(measure, c.measured.difference, j)
                estimate = _estimate(c.measured.difference, j, scale, signed=True)
                cells.append(f'<td class="{kind}">{estimate}{told}</td>')
            rows.append(_row(cells, first=entry.controller == names[0]))
        caption = (
            "Median of the paired differences, its 95 % interval, and the pairs won. "
            '<span class="key good">Better</span> or <span class="key bad">worse</span> where the '
            "interval lies on one side of zero."
        )
        return _table(head, rows, caption)

    def _headings(self) -> str:
        cells: list[str] = []
        for measure, scale in zip(self._measures, self._scales, strict=True):
            words, _, subject = label_of(measure).partition(", ")
            unit = f" [{scale.unit}]" if scale.unit else ""
            cells.append(f"<th>{escaped(words)}<small>{escaped(subject + unit)}</small></th>")
        return "".join(cells)

    def _where(self, axis: Axis | None, entry: Entry) -> str:
        place = self._report.episodes.controllers.index(entry.controller)
        color = COLORS[place % len(COLORS)]
        first = "" if axis is None else f'<td class="left">{escaped(entry.label)}</td>'
        dot = f'<span class="dot" style="background: {color}"></span>'
        return f'{first}<td class="left">{dot}{escaped(entry.controller)}</td>'

    def _best(self, entries: Sequence[Entry]) -> list[float]:
        """The best median of each measure; NaN where there is nothing to be best at."""
        best: list[float] = []
        for j, measure in enumerate(self._measures):
            known = [float(e.medians.value[j]) for e in entries if np.isfinite(e.medians.value[j])]
            if not known or not measure.sign or len(entries) < 2:
                best.append(math.nan)
            else:
                best.append(min(known, key=abs if measure.by_size else lambda x: measure.sign * x))  # noqa: B023
        return best


def _axis_heading(axis: Axis | None) -> str:
    if axis is None:
        return ""
    unit = f" [{axis.unit}]" if axis.unit else ""
    return f'<th class="left">{escaped(axis.name + unit)}</th>'


def _row(cells: Sequence[str], *, first: bool) -> str:
    """A row; the first of a group is set off."""
    kind = ' class="first"' if first else ""
    return f"<tr{kind}>{''.join(cells)}</tr>"


def _table(head: str, rows: Sequence[str], caption: str) -> str:
    told = f"<caption>{caption}</caption>" if caption else ""
    body = "\n".join(rows)
    return (
        f'<div class="scroll"><table>{told}<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def details(title: str, content: str) -> str:
    """Something to be opened; its content is HTML."""
    return f"<details>\n<summary>{escaped(title)}</summary>\n{content}\n</details>"


def _failed(entry: Entry) -> str:
    share, low, high = (100.0 * x for x in entry.failures)
    if math.isnan(share):
        return "<td>-</td>"
    return f"<td>{entry.failed}<small>{low:.1f} .. {high:.1f} %</small></td>"


def _won(won: Any, lost: Any, pairs: int) -> str:
    if isinstance(won, float) or not pairs:
        return ""
    ties = pairs - won - lost
    return f"won {won} of {pairs}" + (f", {ties} even" if ties else "")


def _verdict(measure: Measure, difference: Any, j: int) -> str:
    low, high = measure.sign * difference.low[j], measure.sign * difference.high[j]
    if max(low, high) < 0.0:
        return "good"
    return "bad" if min(low, high) > 0.0 else "even"


def _estimate(interval: Any, j: int, scale: Scale, *, signed: bool = False) -> str:
    """A value and its interval."""
    value, low, high = (scale.factor * float(x[j]) for x in interval)
    told = number(value, signed=signed)
    if math.isnan(low) or math.isnan(high) or (math.isinf(value) and low == high):
        return told
    spread = "no spread" if low == value == high else f"{number(low)} .. {number(high)}"
    return f"{told}<small>{spread}</small>"


def number(value: float, *, signed: bool = False) -> str:
    """Three digits; a dash for what there is not."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        told = "&#8734;"
    else:
        size = abs(value)
        told = f"{size:.0f}" if 99.95 <= size < 1e6 else f"{size:#.3g}"
    plus = "+" if signed and value > 0.0 else ""
    return ("&#8722;" if value < 0.0 else plus) + told


def _notes(report: Report) -> list[str]:
    seeds = len(np.unique(report.episodes.seed))
    notes = [
        "An episode that diverged has no measures: it counts as worse than any that did not, and "
        "so does a time that never came. An infinite value means that this is so for half of the "
        "episodes.",
        f"Medians are over all episodes of a group, their 95 % intervals are percentiles of "
        f"{RESAMPLES} bootstrap resamples of the {seeds} seeds: the seeds are random, the grid is "
        "not. Where nothing random acts, or the median falls on an episode in which nothing does, "
        "an interval has no width.",
        "Shares of diverged episodes have Wilson's interval, as if episodes were independent.",
    ]
    if any(measure.sign == 0 for measure in report.episodes.measures):
        notes.append(
            "Metrics of which neither less nor more is better are those of the episodes that did "
            "not diverge."
        )
    if report.baseline:
        notes.append(
            "A paired difference is that of two episodes of the same seed in the same cell: both "
            "met the same random numbers. It is that of sizes for what should be near zero. If one "
            "of the two diverged, the other one wins; if both did, the pair is even, and has no "
            "difference."
        )
    notes.append(f"The steady regime begins at {SETTLED_AFTER:g} s.")
    return notes
