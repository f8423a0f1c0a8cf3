"""The numbers of a sweep's report: medians, failures, and paired differences from a baseline."""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from octarm.errors import OctarmError, closest, quoted
from octarm.reports import statistics
from octarm.reports.factors import Factor
from octarm.reports.frame import Episodes, Measure
from octarm.reports.statistics import FEWEST, Interval, Paired

TABLES = ("medians.csv", "failures.csv", "differences.csv", "cells.csv")
_Row = dict[str, Any]  # of a table, by column


class PairedDifference(NamedTuple):
    """A controller against the baseline: pairs of episodes of the same seed and cell.

    Attributes:
        measured: with arrays of shape (M,); the difference is that of sizes where zero is best.
        alone: pairs of which only this controller's episode diverged.
        other: those of which only the baseline's did.
        both: those of which both did.
        unpaired: episodes whose partner is not finished.
        chance: `measured.chance`, adjusted for all comparisons of the report, see `adjusted`,
            shape (M,) [1]; NaN where neither less nor more is better.
    """

    measured: Paired
    pairs: int
    alone: int
    other: int
    both: int
    unpaired: int
    chance: np.ndarray


class Group(NamedTuple):
    """One controller at one level of one factor, or in the whole sweep.

    Attributes:
        factor: None for the whole sweep.
        episodes: number of finished ones.
        failed: number of those that diverged, and `failures` their share.
        medians: of the measures, arrays of shape (M,).
        seeds: that have a value of each measure, shape (M,); with fewer than `FEWEST` the interval
            of the median is a range.
        difference: from the baseline; None for the baseline itself.
    """

    factor: Factor | None
    level: int
    controller: str
    episodes: int
    failed: int
    failures: Interval
    medians: Interval
    seeds: np.ndarray
    difference: PairedDifference | None

    @property
    def label(self) -> str:
        """The level in words; empty for the whole sweep."""
        return "" if self.factor is None else self.factor.labels[self.level]


class Cells(NamedTuple):
    """Medians over a grid of two factors, of K1 and K2 levels.

    Attributes:
        medians: of C controllers and M measures, shape (C, M, K1, K2); NaN where there is no
            episode.
    """

    first: Factor
    second: Factor
    medians: np.ndarray


class Comparisons(NamedTuple):
    """All the numbers of some episodes; the baseline is empty when there is only one controller.

    The groups are the whole sweep first, then factor by factor, level by level.
    """

    episodes: Episodes
    baseline: str
    groups: tuple[Group, ...]
    cells: tuple[Cells, ...]

    def of(self, factor: Factor | None) -> list[Group]:
        """The groups of a factor, or of the whole sweep."""
        return [group for group in self.groups if group.factor is factor]


def compare(episodes: Episodes, baseline: str | None = None) -> Comparisons:
    """Computes the numbers; the baseline is the first controller if None.

    Raises OctarmError if the sweep has no such controller.
    """
    names, factors = episodes.controllers, episodes.factors
    if baseline is not None and baseline not in names:
        raise OctarmError(
            f"the sweep has no controller {quoted(baseline)}{closest(baseline, names)}"
        )
    selected = baseline or (names[0] if len(names) > 1 else "")
    partner = partners(episodes, selected) if selected else None
    groups: list[Group] = []
    levels = [(f, k) for f in factors for k in range(len(f.labels))]
    for (factor, level), name in itertools.product([(None, 0), *levels], names):
        rows = episodes.of_controller(name)
        if factor is not None:
            rows = rows[factor.code[rows] == level]
        difference = None
        if partner is not None and name != selected:
            difference = _difference(episodes, rows, partner[rows])
        fell, values, seeds = episodes.diverged[rows], episodes.values[rows], episodes.seed[rows]
        medians = statistics.medians(values, seeds)
        share, known = statistics.share(fell, seeds), statistics.seeds_with_values(values, seeds)
        count, failed = len(rows), int(np.sum(fell))
        groups.append(Group(factor, level, name, count, failed, share, medians, known, difference))
    compared = [(k, d) for k, group in enumerate(groups) if (d := group.difference) is not None]
    chances = statistics.adjusted([d.chance for _, d in compared])
    for (k, d), chance in zip(compared, chances, strict=True):
        groups[k] = groups[k]._replace(difference=d._replace(chance=chance))
    pairs = itertools.combinations(factors, 2)
    pairs = ((b, a) if b.drawn and not a.drawn else (a, b) for a, b in pairs)  # long labels first
    cells = tuple(_cells(episodes, first, second) for first, second in pairs)
    return Comparisons(episodes, selected, tuple(groups), cells)


def _difference(episodes: Episodes, rows: np.ndarray, partner: np.ndarray) -> PairedDifference:
    mine, other = rows[partner >= 0], partner[partner >= 0]
    zero_best = [measure.declared.zero_best for measure in episodes.measures]
    compared = np.where(zero_best, np.abs(episodes.values), episodes.values)
    fell, partner_fell = episodes.diverged[mine], episodes.diverged[other]
    signs = np.array([measure.declared.sign for measure in episodes.measures])
    measured = statistics.paired(compared[mine], compared[other], episodes.seed[mine], signs)
    return PairedDifference(
        measured=measured,
        pairs=len(mine),
        alone=int(np.sum(fell & ~partner_fell)),
        other=int(np.sum(~fell & partner_fell)),
        both=int(np.sum(fell & partner_fell)),
        unpaired=len(rows) - len(mine),
        chance=np.where(signs == 0, np.nan, measured.chance),
    )


def partners(episodes: Episodes, controller: str) -> np.ndarray:
    """The controller's episode of the seed and cell of each one, shape (n,); -1 without one."""
    key = episodes.cell() * (int(episodes.seed.max()) + 1) + episodes.seed
    theirs = episodes.of_controller(controller)
    if not theirs.size:
        return np.full_like(key, -1)
    theirs = theirs[np.argsort(key[theirs])]
    place = np.minimum(np.searchsorted(key[theirs], key), len(theirs) - 1)
    return np.where(key[theirs][place] == key, theirs[place], -1)


def _cells(episodes: Episodes, first: Factor, second: Factor) -> Cells:
    names, count = episodes.controllers, len(episodes.measures)
    middles = np.full((len(names), count, len(first.labels), len(second.labels)), np.nan)
    for c, i, k in np.ndindex(middles.shape[:1] + middles.shape[2:]):
        here = (episodes.controller == c) & (first.code == i) & (second.code == k)
        for m, values in enumerate(np.sort(episodes.values[here], axis=0).T):
            if known := int(np.sum(~np.isnan(values))):  # NaN last
                middles[c, m, i, k] = statistics.middle(values[:known])
    return Cells(first, second, middles)


def tables(comparisons: Comparisons) -> dict[str, str]:
    """The CSV files by name, in SI units; those without a row are left out."""
    medians, failures, differences = list[_Row](), list[_Row](), list[_Row]()
    for group in comparisons.groups:
        factor = group.factor
        axis, value = ("all", "") if factor is None else (factor.name, factor.levels[group.level])
        where: _Row = {"axis": axis, "value": value, "controller": group.controller}
        counts: _Row = {"episodes": group.episodes, "diverged": group.failed}
        shares = dict(zip(("share", "low", "high"), group.failures, strict=True))
        failures.append(where | counts | shares)
        for j, measure in enumerate(comparisons.episodes.measures):
            median = _interval(group.medians, group.seeds, j, "median")
            medians.append(where | _name(measure) | counts | median)
            if (d := group.difference) is not None:
                pairs, won, lost = (x[j] for x in d.measured[:3])
                if not measure.declared.sign:  # there is nothing to win
                    won = lost = ""
                differences.append(
                    where
                    | {"baseline": comparisons.baseline}
                    | _name(measure)
                    | {"pairs": d.pairs, "compared": pairs, "won": won, "lost": lost}
                    | _interval(d.measured.difference, d.measured.seeds, j, "median_difference")
                    | {"p": d.measured.chance[j], "adjusted_p": d.chance[j]}
                    | {"only_this_diverged": d.alone, "only_baseline_diverged": d.other}
                    | {"both_diverged": d.both, "unpaired": d.unpaired}
                )
    rows = (medians, failures, differences, _cell_medians(comparisons))
    return {name: _csv(some) for name, some in zip(TABLES, rows, strict=True) if some}


def _interval(found: Interval, seeds: np.ndarray, j: int, name: str) -> _Row:
    """The columns of a median of so many seeds; `ends` says what `low` and `high` are, if any."""
    median, low, high = (x[j] for x in found)
    ends = "" if math.isnan(low) else "range" if seeds[j] < FEWEST else "95 % interval"
    return {name: median, "low": low, "high": high, "ends": ends}


def _cell_medians(comparisons: Comparisons) -> list[_Row]:
    names, measures = comparisons.episodes.controllers, comparisons.episodes.measures
    rows: list[_Row] = []
    for first, second, values in comparisons.cells:
        for place, value in np.ndenumerate(values):
            c, m, i, k = map(int, place)
            one: _Row = {"axis_1": first.name, "value_1": first.levels[i]}
            other: _Row = {"axis_2": second.name, "value_2": second.levels[k]}
            median = {"controller": names[c]} | _name(measures[m]) | {"median": value}
            rows.append(one | other | median)
    return rows


def _name(measure: Measure) -> _Row:
    return {"metric": measure.name, "unit": measure.unit}


def _csv(rows: Sequence[_Row]) -> str:
    """A table with a header, floats with nine digits, NaN empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(rows[0])
    for row in rows:
        known = ("" if isinstance(x, float) and math.isnan(x) else x for x in row.values())
        writer.writerow(f"{x:.9g}" if isinstance(x, float) else x for x in known)
    return text.getvalue()
