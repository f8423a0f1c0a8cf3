"""The numbers of a sweep's report: medians, failures, and differences from a baseline."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from octarm.errors import OctarmError, closest
from octarm.reports.episodes import Axis, Episodes
from octarm.reports.measures import Measure
from octarm.reports.statistics import Interval, Paired, binomial, medians, paired


class Comparison(NamedTuple):
    """A controller against the baseline: pairs of episodes of the same seed and cell.

    Attributes:
        measured: with arrays of shape (M,); the difference is that of sizes where zero is best.
        pairs: their number.
        alone: pairs of which only this controller's episode diverged.
        other: those of which only the baseline's did.
        both: those of which both did.
        unpaired: episodes whose partner is not finished.
    """

    measured: Paired
    pairs: int
    alone: int
    other: int
    both: int
    unpaired: int


class Entry(NamedTuple):
    """One controller at one value of one axis, or in the whole sweep.

    Attributes:
        axis: None for the whole sweep.
        place: which of the axis's values.
        controller: its name.
        episodes: finished ones.
        failed: of them, those that diverged.
        failures: their share.
        medians: of the measures, arrays of shape (M,).
        comparison: with the baseline; None for the baseline itself.
    """

    axis: Axis | None
    place: int
    controller: str
    episodes: int
    failed: int
    failures: Interval
    medians: Interval
    comparison: Comparison | None

    @property
    def label(self) -> str:
        """The value of the axis; empty for the whole sweep."""
        return "" if self.axis is None else self.axis.labels[self.place]


class Cells(NamedTuple):
    """Medians over a grid of two axes.

    Attributes:
        first: the axis of K1 values.
        second: the axis of K2 values.
        medians: of C controllers and M metrics, shape (C, M, K1, K2); NaN where there is no
            episode.
    """

    first: Axis
    second: Axis
    medians: np.ndarray


class Report(NamedTuple):
    """All the numbers.

    Attributes:
        episodes: what they were worked out from.
        baseline: name of a controller; empty when there is only one.
        entries: the whole sweep first, then axis by axis, value by value.
        cells: for each pair of axes.
    """

    episodes: Episodes
    baseline: str
    entries: tuple[Entry, ...]
    cells: tuple[Cells, ...]

    def of(self, axis: Axis | None) -> list[Entry]:
        """The entries of an axis, or of the whole sweep."""
        return [entry for entry in self.entries if entry.axis is axis]


def make_report(episodes: Episodes, baseline: str | None = None) -> Report:
    """Works out the numbers.

    Args:
        episodes: of a sweep.
        baseline: that the others are compared with; the first controller when not given.

    Raises:
        ValueError: if the sweep has no such controller.
    """
    names = episodes.controllers
    if baseline is not None and baseline not in names:
        raise OctarmError(f"the sweep has no controller {baseline!r}{closest(baseline, names)}")
    chosen = baseline or (names[0] if len(names) > 1 else "")
    partner = partners(episodes, chosen) if chosen else None
    entries: list[Entry] = []
    for axis in (None, *episodes.axes):
        for place in range(1 if axis is None else len(axis.labels)):
            here = np.ones_like(episodes.seed, bool) if axis is None else axis.code == place
            for i, name in enumerate(names):
                rows = np.flatnonzero(here & (episodes.controller == i))
                against = partner if name != chosen else None
                entries.append(_entry(episodes, rows, axis, place, name, against))
    pairs = ((a, b) for i, a in enumerate(episodes.axes) for b in episodes.axes[i + 1 :])
    pairs = ((b, a) if b.drawn and not a.drawn else (a, b) for a, b in pairs)  # long labels first
    cells = tuple(_cells(episodes, first, second) for first, second in pairs)
    return Report(episodes, chosen, tuple(entries), cells)


def _entry(
    episodes: Episodes,
    rows: np.ndarray,
    axis: Axis | None,
    place: int,
    name: str,
    partner: np.ndarray | None,
) -> Entry:
    failed = int(np.sum(episodes.diverged[rows]))
    return Entry(
        axis=axis,
        place=place,
        controller=name,
        episodes=len(rows),
        failed=failed,
        failures=binomial(failed, len(rows)),
        medians=medians(episodes.values[rows], episodes.seed[rows]),
        comparison=None if partner is None else _comparison(episodes, rows, partner[rows]),
    )


def _comparison(episodes: Episodes, rows: np.ndarray, partner: np.ndarray) -> Comparison:
    own, other = rows[partner >= 0], partner[partner >= 0]
    compared = np.where(
        [measure.by_size for measure in episodes.measures],
        np.abs(episodes.values),
        episodes.values,
    )
    fell, partner_fell = episodes.diverged[own], episodes.diverged[other]
    return Comparison(
        measured=paired(
            compared[own],
            compared[other],
            episodes.seed[own],
            [measure.sign for measure in episodes.measures],
        ),
        pairs=len(own),
        alone=int(np.sum(fell & ~partner_fell)),
        other=int(np.sum(~fell & partner_fell)),
        both=int(np.sum(fell & partner_fell)),
        unpaired=len(rows) - len(own),
    )


def partners(episodes: Episodes, controller: str) -> np.ndarray:
    """The controller's episode of the seed and cell of each one, shape (n,); -1 without one."""
    key = episodes.cell() * (int(episodes.seed.max()) + 1) + episodes.seed
    theirs = np.flatnonzero(episodes.controller == episodes.controllers.index(controller))
    if not theirs.size:
        return np.full_like(key, -1)
    theirs = theirs[np.argsort(key[theirs])]
    found = np.minimum(np.searchsorted(key[theirs], key), len(theirs) - 1)
    return np.where(key[theirs][found] == key, theirs[found], -1)


def _cells(episodes: Episodes, first: Axis, second: Axis) -> Cells:
    """Medians over the cells of two axes."""
    names, M = episodes.controllers, len(episodes.measures)
    shape = (len(first.labels), len(second.labels))
    found = np.full((len(names), M, *shape), np.nan)
    number = (episodes.controller * shape[0] + first.code) * shape[1] + second.code
    order = np.argsort(number, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        controller, rest = divmod(int(number[rows[0]]), shape[0] * shape[1])
        for m in range(M):
            values = episodes.values[rows, m]
            values = np.sort(values[~np.isnan(values)])
            if values.size:
                middle = 0.5 * (values[(len(values) - 1) // 2] + values[len(values) // 2])
                found[controller, m, rest // shape[1], rest % shape[1]] = middle
    return Cells(first, second, found)


TABLES = ("medians.csv", "failures.csv", "differences.csv", "cells.csv")


def tables(report: Report) -> dict[str, str]:
    """The CSV files by name, in SI units; empty where there is no number."""
    files = {
        "medians.csv": _csv(_MEDIANS, _median_rows(report)),
        "failures.csv": _csv(_FAILURES, _failure_rows(report)),
    }
    if report.baseline:
        files["differences.csv"] = _csv(_DIFFERENCES, _difference_rows(report))
    if report.cells:
        files["cells.csv"] = _csv(_CELLS, _cell_rows(report))
    return files


_WHERE = ("axis", "value", "controller")
_MEDIANS = (*_WHERE, "metric", "unit", "episodes", "diverged", "median", "low", "high")
_FAILURES = (*_WHERE, "episodes", "diverged", "share", "low", "high")
_DIFFERENCES = (
    *_WHERE, "baseline", "metric", "unit", "pairs", "compared", "won", "lost",
    "median_difference", "low", "high",
    "only_this_diverged", "only_baseline_diverged", "both_diverged", "unpaired",
)  # fmt: skip
_CELLS = ("axis_1", "value_1", "axis_2", "value_2", "controller", "metric", "unit", "median")


def _where(entry: Entry) -> tuple[str, str, str]:
    return ("all" if entry.axis is None else entry.axis.name), entry.label, entry.controller


def _median_rows(report: Report) -> Iterator[tuple[Any, ...]]:
    for entry in report.entries:
        for j, measure in enumerate(report.episodes.measures):
            interval = (x[j] for x in entry.medians)
            counts = (entry.episodes, entry.failed)
            yield (*_where(entry), measure.name, measure.unit, *counts, *interval)


def _failure_rows(report: Report) -> Iterator[tuple[Any, ...]]:
    for entry in report.entries:
        yield (*_where(entry), entry.episodes, entry.failed, *entry.failures)


def _difference_rows(report: Report) -> Iterator[tuple[Any, ...]]:
    for entry in report.entries:
        if (c := entry.comparison) is None:
            continue
        for j, measure in enumerate(report.episodes.measures):
            won, lost = outcomes(measure, c, j)
            yield (
                *_where(entry), report.baseline, measure.name, measure.unit,
                c.pairs, c.measured.pairs[j], won, lost, *(x[j] for x in c.measured.difference),
                c.alone, c.other, c.both, c.unpaired,
            )  # fmt: skip


def outcomes(measure: Measure, comparison: Comparison, j: int) -> tuple[Any, Any]:
    """Pairs won and lost by the measure in place j; NaN where there is nothing to win."""
    if not measure.sign:
        return math.nan, math.nan
    return int(comparison.measured.won[j]), int(comparison.measured.lost[j])


def _cell_rows(report: Report) -> Iterator[tuple[Any, ...]]:
    names, measures = report.episodes.controllers, report.episodes.measures
    for cells in report.cells:
        for place in np.ndindex(*cells.medians.shape):
            c, m, i, k = map(int, place)
            places = (cells.first.name, cells.first.labels[i], cells.second.name)
            value = cells.medians[place]
            yield (
                *places, cells.second.labels[k], names[c], measures[m].name, measures[m].unit, value
            )  # fmt: skip


def _csv(header: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.9g}"
    return value
