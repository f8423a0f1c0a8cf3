"""The tables: numbers in rows under the headings of `words.toml`, and their CSV files."""

import csv
import io
import math
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from octarm.reports.statistics import Interval, binomial
from paper.claims import Claim, worded, words
from paper.evidence import Evidence, interval
from paper.numbers import Entry, percent
from paper.plants import LONGEST, SHORTEST, SHORTEST_TRACKED
from paper.runs import EVERY, LONG
from paper.studies import BEYOND, MODELS, MOVING, NOISE, RATE, WRONG, Cell
from paper.variants import CONTROLLERS, INSTEAD, PROPOSED, SIGN, SMC, by_hand

Rows = Iterable[Sequence[Entry]]
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
    rows: Sequence[Sequence[Entry]]  # an interval is a median and its 95 % interval


def all_tables(evidence: Evidence, claims: Sequence[Claim], gains: Path) -> dict[str, Table]:
    """All tables that are the same in every run, by name, those that have rows.

    The folder `gains` has the tuned gain sets.
    """
    tables = [
        _table("ranking", ranking(evidence)),
        _table("best", best(evidence)),
        plants(evidence),
        _table("plants-ranking", plants_ranking(evidence)),
        periods(evidence),
        *(_table(name, grid(evidence, name)) for name in ("joints", "ablations", "gain-sets")),
        _table("tuning", tuning(evidence, gains)),
    ]
    if evidence.effort.long:
        names = ("rates", "correlation", "degradation", *BEYOND)
        tables += [_table(name, grid(evidence, name)) for name in names]
        tables += [_table("drift", drift(evidence))]
    tables += [
        _table("stability", stability(evidence)),
        _table("cells", cells(evidence)),
        _table("claims", numbers_of(claims)),
    ]
    return {table.name: table for table in tables if table.rows}


def as_csv(table: Table) -> str:
    """The text of a CSV file; an interval takes three columns."""
    wide = [
        any(isinstance(x, Interval) for x in column) for column in zip(*table.rows, strict=True)
    ]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    ends = [("", " low", " high") if three else ("",) for three in wide]
    heads = zip(table.columns, ends, strict=True)
    writer.writerow([name + end for name, three in heads for end in three])
    for row in table.rows:
        entries = zip(row, ends, strict=True)
        triples = [(x if isinstance(x, Interval) else [x] * 3)[: len(own)] for x, own in entries]
        writer.writerow([_plain(x) for triple in triples for x in triple])
    return text.getvalue()


def grid(evidence: Evidence, name: str) -> Rows:
    """The rows of a table of `words.toml`, which says which fields of a cell vary among them.

    There is a row for each combination of these for which all was run. Behind it come `values`:
    a quantity `of` the cell, the error if nothing is said, maybe `over` that of another variant.
    Other fields of a value are the cell's; `diverged` is of all cells of the row.
    """
    table = words()["tables"][name]
    lists = {"all": evidence.variants, "controllers": CONTROLLERS, "ablations": INSTEAD}
    fields = {key: lists[x] if isinstance(x, str) else x for key, x in table["rows"].items()}
    for combination in product(*fields.values()):
        place = dict(zip(fields, combination, strict=True))
        start = Cell(**{"label": "", **table["at"], **place})
        asked = [_asked(start, **value) for value in table["values"]]
        row = list(dict.fromkeys(cell for _, cell, _ in asked))
        rivals = [cell._replace(label=rival) for _, cell, rival in asked if rival]
        if evidence.has(*row, *rivals):
            yield *_where(place), *(_value(evidence, row, *one) for one in asked)


def _asked(
    start: Cell, of: str = "error", over: str = "", **fields: float
) -> tuple[str, Cell, str]:
    """A quantity, the cell that has it, and the variant that it is held against, if any."""
    cell = start._replace(**fields)
    return of.format(*MOVING[cell.reference]), cell, over.format(cell.label)


def _value(evidence: Evidence, row: list[Cell], quantity: str, cell: Cell, rival: str) -> Entry:
    if quantity == "diverged":
        return "{} of {}".format(*evidence.diverged(*row))
    return evidence.ratio(cell, rival, quantity) if rival else evidence.median(cell, quantity)


def ranking(evidence: Evidence) -> Rows:
    """The tuned controllers, the best under noise first."""
    for noisy in evidence.ranked(Cell("", noise=NOISE).of(CONTROLLERS)):
        both = (noisy, noisy._replace(noise=0.0))
        errors = [[evidence.mean_error(x), *map(evidence.median, x.models())] for x in both]
        rattle = [evidence.median(x._replace(mismatch=WRONG), "chattering") for x in both]
        yield noisy.label, *errors[0], *errors[1], *rattle, evidence.mean_error(noisy, SMC)


def best(evidence: Evidence) -> Rows:
    """The law with the least error in each place of the main study, whatever it is."""
    for reference, noise, model in product(MOVING, (NOISE, 0.0), MODELS):
        start = Cell(PROPOSED, "tracking", reference, model, noise)
        if evidence.has(start):
            first = _least(evidence, start.of(CONTROLLERS))
            ratios = [evidence.ratio(start, first.label, x) for x in ("error", "chattering")]
            place = _where({"reference": reference, "noise": noise, "mismatch": model})
            yield *place, first.label, evidence.median(first), *ratios


def plants(evidence: Evidence) -> Table:
    """The paper's laws on arms of more modules than their model."""
    laws = [name for name in (SIGN, SMC, PROPOSED) if name in evidence.effort.plant_labels]
    rivals, rows = laws[:-1], list[Sequence[Entry]]()
    for cells in evidence.plants():
        names, first = [cell.label for cell in cells], _least(evidence, cells)
        best = first.label if np.isfinite(evidence.median(first).value) else "none"
        ours = first._replace(label=PROPOSED)
        errors = [evidence.median(cell) for cell in first.of(laws)]
        ratios = [evidence.ratio(ours, name) for name in rivals]
        ranks = [_rank(evidence, cell, names) for cell in first.of(laws)]
        rows.append((*_plant(first), best, *errors, *ratios, *ranks))
    heads = [*(f"{name} [%]" for name in laws), *(f"afsmc over {name}" for name in rivals)]
    return _table("plants", rows, [*heads, *(f"rank of {name}" for name in laws)])


def plants_ranking(evidence: Evidence) -> Rows:
    """All laws on all plants, the best first."""
    for cells in evidence.plants():
        names = [cell.label for cell in cells]
        for cell in sorted(cells, key=lambda cell: evidence.median(cell).value):
            lost, count = evidence.diverged(cell)
            share = binomial(lost, count) if cell.noise else Interval(*(float(lost),) * 3)
            lost_percent = Interval(*(100.0 * x for x in share))
            rank = _rank(evidence, cell, names)
            yield *_plant(cell), rank, cell.label, evidence.median(cell), lost_percent


def _least(evidence: Evidence, cells: Sequence[Cell]) -> Cell:
    return min(evidence.known(cells), key=lambda cell: evidence.median(cell).value)


def _plant(cell: Cell) -> tuple[Entry, ...]:
    """Modules, control period and noise."""
    return cell.plant, f"{1e3 / cell.rate:g} ms", *_where({"noise": cell.noise})


def _rank(evidence: Evidence, cell: Cell, names: Sequence[str]) -> Entry:
    rank = evidence.rank(cell, names)
    return "lost" if np.isnan(rank.value) else rank


def periods(evidence: Evidence) -> Table:
    """The longest control periods of each law, predicted and simulated [ms]."""
    rows: list[Sequence[Entry]] = []
    for name, both in evidence.periods.items():
        row: list[Entry] = [name]
        for pair in zip(both["predicted"].tolist(), both["simulated"].tolist(), strict=True):
            shortest = SHORTEST_TRACKED if math.isnan(pair[0]) else SHORTEST
            row += [_period(seconds, shortest) for seconds in pair]
        rows.append(row)
    kinds = product(evidence.effort.plants, ("predicted", "simulated"))
    return _table("periods", rows, [f"{modules} modules, {kind} [ms]" for modules, kind in kinds])


def _period(seconds: float, shortest: float) -> Entry:
    """In milliseconds, or beyond which one it is [s]."""
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
        first = float(np.nanmin(series.diverged_at)) if lost else math.nan
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of arms that are lost from the start
            late = [np.nanmax(largest[: round(t / EVERY)], axis=0) for t in (2.0, 5.0, 10.0, 20.0)]
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


def numbers_of(claims: Sequence[Claim]) -> Rows:
    """All numbers of all claims but timings."""
    for c in claims:
        for row in c.rows:
            if not row.varies:
                yield c.letter, str(c.verdict), c.condition, row.name, *row.number, row.unit


def timings(evidence: Evidence) -> Table:
    """What a step takes on this machine."""
    costs = evidence.costs.items()
    rows = [(n, 1e6 * x.many, 1e6 * x.alone, 100.0 * x.many * RATE) for n, x in costs]
    return _table("timings", rows)


def _table(name: str, rows: Rows, columns: Sequence[str] = ()) -> Table:
    wording: dict[str, Any] = words()["tables"][name]
    return Table(name, worded(wording["caption"]), [*wording["columns"], *columns], list(rows))


def _where(place: dict[str, Any]) -> Iterator[Entry]:
    return (WORDS[field](value) for field, value in place.items())


def _plain(entry: Entry) -> str:
    if isinstance(entry, float):
        return "" if math.isnan(entry) else f"{entry:.9g}"
    return str(entry)
