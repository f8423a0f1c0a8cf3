"""The tables: numbers in rows under the headings of `words.toml`, and their CSV files."""

import csv
import io
import math
import tomllib
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from octarm.reports.statistics import Interval, binomial
from paper.claims import Entry, percent, worded, words
from paper.evidence import Evidence, interval
from paper.plants import LONGEST, SHORTEST, SHORTEST_TRACKED
from paper.runs import EVERY, LONG
from paper.studies import MODELS, MOVING, NOISE, RATE, Cell
from paper.variants import CONTROLLERS, INSTEAD, PROPOSED, SIGN, SMC, by_hand

Rows = Iterator[Sequence[Any]]  # of entries
# How tables say what a cell has.
WORDS: dict[str, Callable[[Any], Entry]] = {
    "label": str,
    "reference": lambda reference: ", ".join(MOVING[reference]),
    "mismatch": percent,
    "noise": lambda noise: percent(noise).lstrip("+") if noise else "none",
    "time": lambda time: f"{1e3 * time:g} ms",
    "rate": lambda rate: f"{rate:g} Hz",
}


class Table(NamedTuple):
    """Rows under headings."""

    name: str  # of its file
    caption: str  # what it shows, and how
    columns: Sequence[str]  # headings, units in brackets
    rows: Sequence[Sequence[Any]]  # entries; an interval is a median and its 95 % interval


def all_tables(evidence: Evidence, gains: Path) -> dict[str, Table]:
    """All tables of `words.toml` that have rows, by name; only `timings` differ from run to run.

    The folder `gains` has the tuned gain sets.
    """
    made = {
        "best": best, "plants": plants, "plants-ranking": plants_ranking,
        "periods": periods, "tuning": partial(tuning, gains=gains), "drift": drift,
        "stability": stability, "cells": cells, "timings": timings,
    }  # fmt: skip
    tables: dict[str, Table] = {}
    for name, wording in words()["tables"].items():
        if evidence.effort.long or not wording.get("long"):
            rows = list(made[name](evidence) if name in made else grid(evidence, name))
            if wording.get("ranked"):
                rows.sort(key=lambda row: row[1].value)
            heads = wording["columns"] if "columns" in wording else rows.pop(0)
            tables[name] = Table(name, worded(wording["caption"]), heads, rows)
    return {name: table for name, table in tables.items() if table.rows}


def as_csv(table: Table) -> str:
    """The text of a CSV file; an interval takes three columns."""
    columns: list[list[str]] = []
    for head, column in zip(table.columns, zip(*table.rows, strict=True), strict=True):
        ends = ("", " low", " high") if any(isinstance(x, Interval) for x in column) else ("",)
        for i, end in enumerate(ends):
            entries = (x[i] if isinstance(x, Interval) else x for x in column)
            columns.append([head + end, *map(_plain, entries)])
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(zip(*columns, strict=True))
    return text.getvalue()


def grid(evidence: Evidence, name: str) -> Rows:
    """The rows of a table of `words.toml`, which says which fields of a cell vary among them.

    There is a row for each combination of these for which all was run. Behind it come `values`:
    a quantity `of` a cell `at` this place, the error if nothing is said, maybe `over` that of
    another variant; `diverged` is of all cells of the row.
    """
    table = words()["tables"][name]
    lists = {"all": evidence.variants, "controllers": CONTROLLERS, "ablations": INSTEAD}
    fields = {key: lists[x] if isinstance(x, str) else x for key, x in table["rows"].items()}
    for combination in product(*fields.values()):
        place = dict(zip(fields, combination, strict=True))
        start = Cell(**{"label": "", **table["at"], **place})
        row = [start._replace(**value.get("at", {})) for value in table["values"]]
        asked = list(zip(row, table["values"], strict=True))
        rivals = [cell.of([x["over"].format(cell.label)])[0] for cell, x in asked if "over" in x]
        if evidence.has(*row, *rivals):
            yield *_where(place), *(_value(evidence, row, cell, **value) for cell, value in asked)


def _value(
    evidence: Evidence, row: list[Cell], cell: Cell, of: str = "error", over: str = "", **_: Any
) -> Entry:
    """See `grid`; one of the values of a row of cells."""
    if of == "diverged":
        return "{} of {}".format(*evidence.diverged(*dict.fromkeys(row)))
    of = of.format(*MOVING[cell.reference])
    return evidence.ratio(cell, over.format(cell.label), of) if over else evidence.median(cell, of)


def best(evidence: Evidence) -> Rows:
    """The law with the least error in each place of the main study, whatever it is."""
    for reference, noise, model in product(MOVING, (NOISE, 0.0), MODELS):
        start = Cell(PROPOSED, "tracking", reference, model, noise)
        if evidence.has(start):
            first, *_ = evidence.ranked(start.of(CONTROLLERS))
            ratios = [evidence.ratio(start, first.label, x) for x in ("error", "chattering")]
            place = _where({"reference": reference, "noise": noise, "mismatch": model})
            yield *place, first.label, evidence.median(first), *ratios


def plants(evidence: Evidence) -> Rows:
    """The paper's laws on arms of more modules than their model, below headings."""
    laws = [name for name in (SIGN, SMC, PROPOSED) if name in evidence.effort.plant_labels]
    heads = [*(f"{name} [%]" for name in laws), *(f"afsmc over {name}" for name in laws[:-1])]
    yield "modules", "period", "noise", "best", *heads, *(f"rank of {name}" for name in laws)
    for cells in evidence.plants():
        first, *_ = cells
        best = first.label if np.isfinite(evidence.median(first).value) else "none"
        ours, own = first._replace(label=PROPOSED), first.of(laws)
        ratios = [evidence.ratio(ours, name) for name in laws[:-1]]
        ranks = [evidence.rank(cell, cells) for cell in own]
        yield *_plant(first), best, *map(evidence.median, own), *ratios, *ranks


def plants_ranking(evidence: Evidence) -> Rows:
    """All laws on all plants, the best first."""
    for cells in evidence.plants():
        for cell in cells:
            lost, count = evidence.diverged(cell)
            share = binomial(lost, count) if cell.noise else (float(lost),) * 3
            percents = Interval(*(100.0 * x for x in share))
            rank = evidence.rank(cell, cells)
            yield *_plant(cell), rank, cell.label, evidence.median(cell), percents


def _plant(cell: Cell) -> tuple[Entry, ...]:
    """Modules, control period and noise."""
    return cell.plant, f"{1e3 / cell.rate:g} ms", *_where({"noise": cell.noise})


def periods(evidence: Evidence) -> Rows:
    """The longest control periods of each law, predicted and simulated [ms], below headings."""
    kinds = ("predicted", "simulated")
    both = product(evidence.effort.plants, kinds)
    yield "controller", *(f"{modules} modules, {kind} [ms]" for modules, kind in both)
    for name, kept in evidence.periods.items():
        pairs = zip(*(kept[kind].tolist() for kind in kinds), strict=True)
        yield name, *(_period(seconds, pair[0]) for pair in pairs for seconds in pair)


def _period(seconds: float, predicted: float) -> Entry:
    """In milliseconds, or beyond which one it is [s]."""
    shortest = SHORTEST_TRACKED if math.isnan(predicted) else SHORTEST
    if math.isnan(seconds):
        return "no slope"
    if seconds > LONGEST:
        return f"above {1e3 * LONGEST:g}"
    return f"below {1e3 * shortest:g}" if seconds < shortest else 1e3 * seconds


def tuning(evidence: Evidence, gains: Path) -> Rows:
    """What tuning gave, from the files of the gain sets."""
    for name in CONTROLLERS:
        file, tuned = gains / f"{name}.toml", evidence.variants[name].gains
        if tuned == evidence.variants[by_hand(name)].gains or not file.is_file():
            continue
        origin = tomllib.loads(file.read_text(encoding="utf-8"))
        if {"tuning", "search", "long_trial"} <= set(origin):
            trials = product(("search", "long_trial"), ("cost", "recommended"))
            costs = [float(origin[trial][key]) for trial, key in trials]
            better = "yes" if costs[2] < costs[3] else "no"
            at_bounds = ", ".join(origin["tuning"]["at_bounds"]) or "none"
            yield name, *costs, costs[3] / costs[2], better, at_bounds


def drift(evidence: Evidence) -> Rows:
    """What grows in long runs with and without safeguards."""
    for label, name in LONG.items():
        series = evidence.series[name]
        bounds = np.asarray(evidence.variants[label].gains["E_max"])
        largest = np.max(series.E / bounds, axis=2)  # of all coordinates, in bounds
        lost = int(np.sum(~np.isnan(series.diverged_at)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of arms that are lost from the start, or never
            late = [np.nanmax(largest[: round(t / EVERY)], axis=0) for t in (2.0, 5.0, 10.0, 20.0)]
            first = float(np.nanmin(series.diverged_at))
        yield label, *map(interval, late), f"{lost} of {len(series.noise)}", first


def stability(evidence: Evidence) -> Rows:
    """How V went on sampled runs."""
    for o in evidence.outcomes:
        sides = ((o.grown_outside, o.outside), (o.grown_inside, o.inside))
        grown = [100.0 * grown / count if count else math.nan for grown, count in sides]
        where = o.label, *_where({"rate": o.rate, "mismatch": o.mismatch})
        shares = o.outside, grown[0], o.inside, grown[1]
        yield *where, "yes" if o.covered else "no", *shares, 1e3 * o.start, 1e3 * o.bound


def cells(evidence: Evidence) -> Rows:
    """Everything: every cell of every study."""
    for cell in evidence.cells:
        lost, count = evidence.diverged(cell)
        numbers = evidence.median(cell), evidence.median(cell, "chattering")
        yield cell.title, cell.label, *cell[2:-1], count, lost, *numbers


def timings(evidence: Evidence) -> Rows:
    """What a step takes on this machine."""
    for name, cost in evidence.costs.items():
        yield name, 1e6 * cost.many, 1e6 * cost.alone, 100.0 * cost.many * RATE


def _where(place: dict[str, Any]) -> Iterator[Entry]:
    return (WORDS[field](value) for field, value in place.items())


def _plain(entry: Entry) -> str:
    if isinstance(entry, float):
        return "" if math.isnan(entry) else f"{entry:.9g}"
    return str(entry)
