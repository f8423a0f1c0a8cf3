"""The tables: numbers in rows under the headings of `words.toml`, and their CSV files."""

import csv
import io
import math
import tomllib
import warnings
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from octarm.reports.statistics import Interval, binomial
from paper import studies, variants
from paper.claims import Claim, worded, words
from paper.evidence import Cell, Evidence, interval
from paper.numbers import percent
from paper.plants import LONGEST, SHORTEST, SHORTEST_TRACKED
from paper.runs import EVERY, LONG
from paper.studies import BENDS, BEYOND, MODELS, MOVING, NOISE, RATE, RATES, TIME, WRONG
from paper.variants import CONSEQUENT, CONTROLLERS, INTEGRAL, PROPOSED, SIGN, SMC, by_hand

Entry = str | int | float | Interval
Rows = Iterable[Sequence[Entry]]


class Table(NamedTuple):
    """Rows under headings."""

    name: str  # of its file
    caption: str  # what it shows, and how
    columns: Sequence[str]  # headings, units in brackets
    rows: Sequence[Sequence[Entry]]  # an interval is a median and its 95 % interval


def all_tables(evidence: Evidence, claims: Sequence[Claim], gains: Path) -> dict[str, Table]:
    """All tables that are the same in every run, by name, those that have rows.

    Args:
        evidence: what was run.
        claims: all of them.
        gains: folder of the tuned gain sets.
    """
    tables = [
        _table("ranking", ranking(evidence)),
        _table("best", best(evidence)),
        plants(evidence),
        _table("plants-ranking", plants_ranking(evidence)),
        periods(evidence),
        _table("joints", joints(evidence)),
        _table("ablations", ablations(evidence)),
        _table("gain-sets", gain_sets(evidence)),
        _table("tuning", tuning(evidence, gains)),
        _table("rates", rates(evidence)),
        _table("correlation", correlation(evidence)),
        degradation(evidence),
        *(beyond(evidence, name) for name in BEYOND),
        _table("drift", drift(evidence)),
        _table("stability", stability(evidence)),
        _table("cells", cells(evidence)),
        _table("claims", numbers_of(claims)),
    ]
    return {table.name: table for table in tables if table.rows}


def as_csv(table: Table) -> str:
    """The text of a CSV file; an interval takes three columns."""
    wide = [any(isinstance(x, Interval) for x in own) for own in zip(*table.rows, strict=True)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    ends = [("", " low", " high") if three else ("",) for three in wide]
    heads = zip(table.columns, ends, strict=True)
    writer.writerow([name + end for name, own in heads for end in own])
    for row in table.rows:
        triples = [x if isinstance(x, Interval) else [x] * 3 for x in row]
        entries = zip(triples, wide, strict=True)
        writer.writerow([_plain(x) for own, three in entries for x in own[: 3 if three else 1]])
    return text.getvalue()


def ranking(evidence: Evidence) -> Rows:
    """The tuned controllers, the best under noise first."""
    for name in evidence.ranked(CONTROLLERS, NOISE):
        errors: list[Entry] = []
        for noise in (NOISE, 0.0):
            errors.append(evidence.mean_error(name, noise))
            errors += map(evidence.error, Cell(name, noise=noise).models())
        restless = [evidence.chattering(Cell(name, mismatch=WRONG, noise=x)) for x in (NOISE, 0.0)]
        yield name, *errors, *restless, evidence.over(name, SMC, NOISE)


def best(evidence: Evidence) -> Rows:
    """The law with the least error in each place of the main study, whatever it is."""
    for reference, noise, model in product(MOVING, (NOISE, 0.0), MODELS):
        start = Cell(PROPOSED, "tracking", reference, model, noise)
        cells = evidence.known([start._replace(label=name) for name in CONTROLLERS])
        if start in cells:
            first = _least(evidence, cells)
            ratios = [evidence.ratio(start, first.label, x) for x in ("error", "chattering")]
            yield *_place(start), first.label, evidence.error(first), *ratios


def plants(evidence: Evidence) -> Table:
    """The paper's laws on arms of more modules than their model."""
    laws = [name for name in (SIGN, SMC, PROPOSED) if name in evidence.effort.plant_labels]
    rivals = [name for name in laws if name != PROPOSED]
    rows: list[Sequence[Entry]] = []
    for cells in evidence.plants():
        own = {cell.label: cell for cell in cells}
        first = _least(evidence, cells)
        best = first.label if np.isfinite(evidence.error(first).value) else "none"
        errors = [evidence.error(own[name]) for name in laws]
        ratios = [evidence.ratio(own[PROPOSED], name) for name in rivals]
        ranks = [_rank(evidence, own[name], list(own)) for name in laws]
        rows.append((*_plant(cells[0]), best, *errors, *ratios, *ranks))
    heads = [*(f"{name} [%]" for name in laws), *(f"afsmc over {name}" for name in rivals)]
    return _table("plants", rows, [*heads, *(f"rank of {name}" for name in laws)])


def plants_ranking(evidence: Evidence) -> Rows:
    """All laws on all plants, the best first."""
    for cells in evidence.plants():
        names = [cell.label for cell in cells]
        for cell in sorted(cells, key=lambda cell: evidence.error(cell).value):
            lost, count = evidence.diverged(cell)
            share = binomial(lost, count) if cell.noise else Interval(*(float(lost),) * 3)
            percent_lost = Interval(*(100.0 * x for x in share))
            rank = _rank(evidence, cell, names)
            yield *_plant(cell), rank, cell.label, evidence.error(cell), percent_lost


def periods(evidence: Evidence) -> Table:
    """The longest control periods of each law, predicted and simulated."""
    rows: list[Sequence[Entry]] = []
    for name, own in evidence.periods.items():
        sorts = [SHORTEST_TRACKED if math.isnan(x) else SHORTEST for x in own["predicted"]]
        pairs = zip(own["predicted"], own["simulated"], sorts, strict=True)
        rows.append((name, *(_period(x, shortest) for *pair, shortest in pairs for x in pair)))
    kinds = product(evidence.effort.plants, ("predicted", "simulated"))
    return _table("periods", rows, [f"{modules} modules, {kind} [ms]" for modules, kind in kinds])


def joints(evidence: Evidence) -> Rows:
    """The numbers of figures 1 and 2."""
    for reference, noise, model in product(MOVING, (0.0, NOISE), MODELS):
        cells = [Cell(name, "tracking", reference, model, noise) for name in evidence.variants]
        for cell in evidence.known(cells):
            numbers = [
                evidence.median(cell, f"{metric}_{joint}", factor)
                for metric, factor in (("rms_error", 1e3), ("overshoot", 1.0))
                for joint in MOVING[reference]
            ]
            yield *_place(cell), cell.label, *numbers, _lost(evidence, cell)


def ablations(evidence: Evidence) -> Rows:
    """What is left of `afsmc` without one of its parts, and what others reach."""
    labels = (CONSEQUENT, SMC, INTEGRAL, *variants.ABLATIONS)
    for label, reference, noise in product(labels, MOVING, (NOISE, 0.0)):
        cells = Cell(label, reference=reference, noise=noise).models()
        if evidence.has(*cells):
            ratios = [evidence.ratio(cell, PROPOSED) for cell in cells]
            restless = evidence.ratio(cells[0], PROPOSED, "chattering")
            yield label, *_place(cells[0])[:2], *ratios, restless


def gain_sets(evidence: Evidence) -> Rows:
    """Tuned gains against hand-set ones."""
    for name, noise in product(CONTROLLERS, (NOISE, 0.0)):
        cells = Cell(name, noise=noise).models()
        if evidence.has(*cells, *Cell(by_hand(name), noise=noise).models()):
            yield name, _noise(noise), *(evidence.ratio(cell, by_hand(name)) for cell in cells)


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


def rates(evidence: Evidence) -> Rows:
    """Other control rates."""
    labels = _labels(evidence, *(studies.study_of_rate(rate) for rate in RATES if rate != RATE))
    for rate, label in product(RATES, labels):
        noisy = Cell(label, studies.study_of_rate(rate), mismatch=WRONG, noise=NOISE)
        both = (noisy, noisy._replace(noise=0.0))
        if evidence.has(*both):
            numbers = [f(cell) for f in (evidence.error, evidence.chattering) for cell in both]
            yield f"{rate:g} Hz", label, *numbers, _lost(evidence, *both)


def correlation(evidence: Evidence) -> Rows:
    """Other correlation times of the noise."""
    times = {cell.time for cell in evidence.rows if cell.study == "correlation"} | {TIME}
    for time, label in product(sorted(times), _labels(evidence, "correlation")):
        study = "tracking" if time == TIME else "correlation"
        cell = Cell(label, study, mismatch=WRONG, noise=NOISE, time=time)
        numbers = evidence.error(cell), evidence.chattering(cell)
        yield f"{1e3 * time:g} ms", label, *numbers, _lost(evidence, cell)


def degradation(evidence: Evidence) -> Table:
    """Error over the strength of the noise."""
    noises = evidence.noises()
    rows = [
        (label, *(evidence.error(Cell(label, "degradation", BENDS, WRONG, x)) for x in noises))
        for label in _labels(evidence, "degradation")
    ]
    return _table("degradation", rows, [f"{100 * noise:g} % noise" for noise in noises])


def beyond(evidence: Evidence, name: str) -> Table:
    """Payload, delay or loss, in the sweeps that vary nothing else."""
    sort = BEYOND[name]
    rows: list[Sequence[Entry]] = []
    for label, model in product(CONTROLLERS, MODELS):
        start = Cell(label, "beyond", mismatch=model)
        own = [start._replace(**{name: value}) for value in sort.values]
        if evidence.has(*own):
            rows.append((label, percent(model), *map(evidence.error, own)))
    return _table("beyond", rows, [*map(sort.written, sort.values)], name)


def drift(evidence: Evidence) -> Rows:
    """What grows in long runs with and without safeguards."""
    for label, name in LONG.items() if evidence.effort.long else ():
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
        outside, inside = (
            100.0 * grown / periods if periods else math.nan
            for grown, periods in ((o.grown_outside, o.outside), (o.grown_inside, o.inside))
        )
        where = o.label, f"{o.rate:g} Hz", percent(o.mismatch), "yes" if o.covered else "no"
        yield *where, o.outside, outside, o.inside, inside, 1e3 * o.start, 1e3 * o.bound


def cells(evidence: Evidence) -> Rows:
    """Everything: every cell of every study."""
    for cell in evidence.rows:
        lost, count = evidence.diverged(cell)
        numbers = evidence.error(cell), evidence.chattering(cell)
        yield cell.study, cell.label, *cell[2:], count, lost, *numbers


def numbers_of(claims: Sequence[Claim]) -> Rows:
    """All numbers of all claims but timings."""
    for c in claims:
        own = c.letter, str(c.verdict), c.condition
        yield from ((*own, row.name, *row.number, row.unit) for row in c.rows if not row.varies)


def timings(evidence: Evidence) -> Table:
    """What a step takes on this machine."""
    rows = [
        (name, 1e6 * cost.many, 1e6 * cost.alone, 100.0 * cost.many * RATE)
        for name, cost in evidence.costs.items()
    ]
    return _table("timings", rows)


def _table(key: str, rows: Rows, columns: Sequence[str] = (), name: str = "") -> Table:
    wording: dict[str, Any] = words()["tables"][key]
    caption = worded(wording["caption"], name=name)
    return Table(name or key, caption, [*wording["columns"], *columns], list(rows))


def _place(cell: Cell) -> tuple[str, str, str]:
    """Joints, noise and model."""
    return ", ".join(MOVING[cell.reference]), _noise(cell.noise), percent(cell.mismatch)


def _plant(cell: Cell) -> tuple[Entry, ...]:
    """Modules, control period and noise."""
    return cell.plant, studies.period_of_plants(cell.study), _noise(cell.noise)


def _noise(noise: float) -> str:
    return percent(noise).lstrip("+") if noise else "none"


def _least(evidence: Evidence, cells: Sequence[Cell]) -> Cell:
    return min(cells, key=lambda cell: evidence.error(cell).value)


def _rank(evidence: Evidence, cell: Cell, names: Sequence[str]) -> Entry:
    rank = evidence.rank(cell, names)
    return "lost" if np.isnan(rank.value) else rank


def _period(seconds: float, shortest: float) -> Entry:
    """In milliseconds, or beyond which one it is [s]."""
    if math.isnan(seconds):
        return "no slope"
    if seconds > LONGEST:
        return f"above {1e3 * LONGEST:g}"
    return f"below {1e3 * shortest:g}" if seconds < shortest else 1e3 * float(seconds)


def _lost(evidence: Evidence, *cells: Cell) -> str:
    """How many of the episodes diverged."""
    lost, count = evidence.diverged(*cells)
    return f"{lost} of {count}"


def _labels(evidence: Evidence, *studies: str) -> list[str]:
    """The tuned controllers that studies have."""
    labels = {cell.label for cell in evidence.rows if cell.study in studies}
    return [name for name in CONTROLLERS if name in labels]


def _plain(entry: Entry) -> str:
    if isinstance(entry, float):
        return "" if math.isnan(entry) else f"{entry:.9g}"
    return str(entry)
