"""Which tables there are, and what stands in them."""

from __future__ import annotations

import csv
import io
import math
import tomllib
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from octarm.reports.statistics import Interval
from paper.claims import Claim, ends, filled, in_words, percent, texts
from paper.evidence import Cell, Evidence, interval
from paper.runs import EVERY, LONG
from paper.studies import (
    ABLATIONS,
    BENDS,
    BEYOND,
    CONSEQUENT,
    CONTROLLERS,
    INTEGRAL,
    MODELS,
    MOVING,
    NOISE,
    RATE,
    SLIDES,
    SMC,
    TIME,
    WRONG,
    by_hand,
    study_of_rate,
)

Entry = str | int | float | Interval

_MODELS = tuple(f"model {percent(model)}" for model in MODELS)


class Table(NamedTuple):
    """Rows under headings.

    Attributes:
        name: of its file, and of its caption in `texts.toml`.
        columns: headings, units in brackets.
        rows: an entry a column; an interval stands for median and 95 % interval.
    """

    name: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Entry]]

    @property
    def caption(self) -> str:
        """What it shows, and how."""
        return filled(texts()["tables"][self.name])

    def is_words(self, j: int) -> bool:
        """Whether there are words in a column."""
        return any(isinstance(row[j], str) for row in self.rows)

    def csv(self) -> str:
        """The text of a CSV file; an interval takes three columns."""
        columns = zip(*self.rows, strict=True)
        wide = [any(isinstance(x, Interval) for x in column) for column in columns]
        head = [
            name + end
            for name, intervals in zip(self.columns, wide, strict=True)
            for end in (("", " low", " high") if intervals else ("",))
        ]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(head)
        for row in self.rows:
            parts: list[Any] = []
            for entry, intervals in zip(row, wide, strict=True):
                parts += ends(entry) if intervals else [entry]
            writer.writerow(map(_plain, parts))
        return text.getvalue()


def markdown(columns: Sequence[str], rows: Iterable[Sequence[Entry]]) -> str:
    """A table in Markdown."""
    lines = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for row in rows:
        lines.append(f"| {' | '.join(in_words(entry).replace('|', '/') for entry in row)} |")
    return "\n".join(lines)


def _plain(value: str | float) -> str:
    if not isinstance(value, float):
        return str(value)
    return "" if math.isnan(value) else f"{value:.9g}"


def tables(evidence: Evidence, gains: Path) -> list[Table]:
    """All tables that are the same in every run.

    Args:
        evidence: what was run.
        gains: folder of the tuned gain sets.
    """
    made = [
        ranking(evidence),
        joints(evidence),
        ablations(evidence),
        gain_sets(evidence),
        tuning(evidence, gains),
        rates(evidence),
        correlation(evidence),
        degradation(evidence),
        *(beyond(evidence, name) for name in BEYOND),
        drift(evidence),
        stability(evidence),
        cells(evidence),
    ]
    return [table for table in made if table.rows]


def by_error(evidence: Evidence) -> list[str]:
    """The tuned controllers, the best under noise first."""
    known = [n for n in CONTROLLERS if evidence.measured.has(Cell(n, noise=NOISE))]
    return sorted(known, key=lambda n: _mean_error(evidence, n, NOISE).value)


def ranking(evidence: Evidence) -> Table:
    """The tuned controllers, the best under noise first."""
    measured, rows = evidence.measured, list[list[Entry]]()
    for name in by_error(evidence):
        row: list[Entry] = [name]
        for noise in (NOISE, 0.0):
            row.append(_mean_error(evidence, name, noise))
            row += [measured.percent(cell) for cell in Cell(name, noise=noise).models()]
        for noise in (NOISE, 0.0):
            row.append(measured.percent(Cell(name, mismatch=WRONG, noise=noise), "chattering"))
        row.append(interval(measured.mean_error(name, NOISE) / measured.mean_error(SMC, NOISE)))
        rows.append(row)
    head = ["controller"]
    for noise in ("noise", "no noise"):
        head += [f"error, {noise} [%]", *(f"{noise}, {model} [%]" for model in _MODELS)]
    head += ["chattering, noise [%]", "chattering, no noise [%]", f"error over {SMC}, noise"]
    return Table("ranking", head, rows)


def joints(evidence: Evidence) -> Table:
    """The numbers of figures 1 and 2."""
    measured, rows = evidence.measured, list[list[Entry]]()
    everything = [
        Cell(label, reference=reference, mismatch=model, noise=noise)
        for reference in (BENDS, SLIDES)
        for noise in (0.0, NOISE)
        for model in MODELS
        for label in evidence.variants
    ]
    for cell in filter(measured.has, everything):
        moving = MOVING[cell.reference]
        row: list[Entry] = [", ".join(moving), _noise(cell.noise), percent(cell.mismatch)]
        row.append(cell.label)
        row += [measured.median(cell, f"rms_error_{joint}", 1e3) for joint in moving]
        row += [measured.median(cell, f"overshoot_{joint}") for joint in moving]
        rows.append([*row, measured.diverged(cell)])
    places = [f"{what} {k} [{unit}]" for what, unit in (("rms error", "mm, mrad"),
              ("overshoot", "%")) for k in (1, 2)]  # fmt: skip
    return Table("joints", ["joints", "noise", "model", "controller", *places, "diverged"], rows)


def ablations(evidence: Evidence) -> Table:
    """What is left of `afsmc` without one of its parts, and what others reach."""
    measured, rows = evidence.measured, list[list[Entry]]()
    for label in (CONSEQUENT, SMC, INTEGRAL, *ABLATIONS):
        for reference in (BENDS, SLIDES):
            for noise in (NOISE, 0.0):
                models = Cell(label, reference=reference, noise=noise).models()
                if measured.has(*models):
                    ratios = [measured.over_proposed(cell) for cell in models]
                    restless = measured.over_proposed(models[0], "chattering")
                    where = [label, ", ".join(MOVING[reference]), _noise(noise)]
                    rows.append([*where, *ratios, restless])
    head = ["instead of afsmc", "joints", "noise", *_MODELS, f"chattering, {_MODELS[0]}"]
    return Table("ablations", head, rows)


def gain_sets(evidence: Evidence) -> Table:
    """Tuned gains against hand-set ones."""
    measured, rows = evidence.measured, list[list[Entry]]()
    for name in CONTROLLERS:
        for noise in (NOISE, 0.0):
            pairs = [cell.over(by_hand(name)) for cell in Cell(name, noise=noise).models()]
            if all(measured.has(*pair) for pair in pairs):
                rows.append([name, _noise(noise), *(measured.ratio(*pair) for pair in pairs)])
    return Table("gain-sets", ["controller", "noise", *_MODELS], rows)


def tuning(evidence: Evidence, gains: Path) -> Table:
    """What tuning gave, from the files of the gain sets."""
    rows: list[list[Entry]] = []
    for name in CONTROLLERS:
        file, variants = gains / f"{name}.toml", evidence.variants
        if variants[name].gains == variants[by_hand(name)].gains or not file.is_file():
            continue
        origin = tomllib.loads(file.read_text(encoding="utf-8"))
        if not {"tuning", "search", "long_trial"} <= set(origin):
            continue
        short, long = origin["search"], origin["long_trial"]
        costs = [float(t[key]) for t in (short, long) for key in ("cost", "recommended")]
        better = "yes" if costs[2] < costs[3] else "no"
        at_bounds = ", ".join(origin["tuning"]["at_bounds"]) or "none"
        rows.append([name, *costs, costs[3] / costs[2], better, at_bounds])
    costs = [
        f"{run}, {gains}" for run in ("search", "long trial") for gains in ("tuned", "hand-set")
    ]
    head = ["controller", *costs, "hand-set over tuned", "tuned is better", "at its bounds"]
    return Table("tuning", head, rows)


def rates(evidence: Evidence) -> Table:
    """Other control rates."""
    measured, rows, others = evidence.measured, list[list[Entry]](), evidence.effort.rates
    for rate in sorted({*others, RATE}) if others else ():
        for label in _labels(evidence, *map(study_of_rate, others)):
            quiet = Cell(label, study_of_rate(rate), mismatch=WRONG)
            both = (quiet._replace(noise=NOISE), quiet)
            entries = [measured.percent(c, what) for what in ("error", "chattering") for c in both]
            rows.append([f"{rate:g} Hz", label, *entries, measured.diverged(*both)])
    head = [f"{what}, {noise} [%]" for what in ("error", "chattering")
            for noise in ("noise", "no noise")]  # fmt: skip
    return Table("rates", ["rate", "controller", *head, "diverged"], rows)


def correlation(evidence: Evidence) -> Table:
    """Other correlation times of the noise."""
    measured, rows, others = evidence.measured, list[list[Entry]](), evidence.effort.times
    for time in sorted({*others, TIME}) if others else ():
        for label in _labels(evidence, "correlation"):
            study = "tracking" if time == TIME else "correlation"
            cell = Cell(label, study, mismatch=WRONG, noise=NOISE, time=time)
            entries = [measured.percent(cell), measured.percent(cell, "chattering")]
            rows.append([f"{1e3 * time:g} ms", label, *entries, measured.diverged(cell)])
    head = ["correlation time", "controller", "error [%]", "chattering [%]", "diverged"]
    return Table("correlation", head, rows)


def degradation(evidence: Evidence) -> Table:
    """Error over the strength of the noise."""
    noises = (0.0, *evidence.effort.noises)
    rows: list[list[Entry]] = []
    for label in _labels(evidence, "degradation"):
        curve = [Cell(label, "degradation", mismatch=WRONG, noise=noise) for noise in noises]
        rows.append([label, *map(evidence.measured.percent, curve)])
    return Table("degradation", ["controller", *(f"{100 * n:g} % noise" for n in noises)], rows)


def beyond(evidence: Evidence, name: str) -> Table:
    """Payload, delay or loss."""
    stress, rows = BEYOND[name], list[list[Entry]]()
    for label in CONTROLLERS:
        for start in Cell(label, "beyond").models():
            curve = [start._replace(**{name: value}) for value in stress.values]
            if evidence.measured.has(*curve):
                errors = map(evidence.measured.percent, curve)
                rows.append([label, percent(start.mismatch), *errors])
    values = [f"{stress.factor * value:g} {stress.unit}" for value in stress.values]
    return Table(name, ["controller", "model", *values], rows)


def drift(evidence: Evidence) -> Table:
    """What grows in long runs with and without safeguards."""
    rows: list[list[Entry]] = []
    seconds = (2.0, 5.0, 10.0, 20.0)
    for label, name in LONG.items() if evidence.effort.long else ():
        series = evidence.series[name]
        bounds = np.asarray(evidence.variants[label].gains["E_max"])
        largest = np.max(series.E / bounds, axis=2)  # of all coordinates, in bounds
        lost = int(np.sum(~np.isnan(series.diverged_at)))
        first = float(np.nanmin(series.diverged_at)) if lost else math.nan
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of arms that are lost from the start
            late = [np.nanmax(largest[: round(t / EVERY)], axis=0) for t in seconds]
        rows.append([label, *map(interval, late), f"{lost} of {len(series.noise)}", first])
    head = ["controller", *(f"{t:g} s" for t in seconds), "diverged", "first at [s]"]
    return Table("drift", head, rows)


def stability(evidence: Evidence) -> Table:
    """How V went on sampled runs."""
    rows: list[list[Entry]] = []
    for o in evidence.outcomes:
        where = [o.label, f"{o.rate:g} Hz", percent(o.mismatch), "yes" if o.covered else "no"]
        outside = 100.0 * o.share_outside if o.outside else math.nan
        inside = 100.0 * o.share_inside if o.inside else math.nan
        energy = [1e3 * o.start, 1e3 * o.bound]
        rows.append([*where, o.outside, outside, o.inside, inside, *energy])
    head = ["controller", "rate", "model", "gains cover the model error", "periods outside",
            "V grew [%]", "periods inside", "V grew inside [%]", "V at the start [mJ]",
            "largest 1/2 s^T D s after 2 s [mJ]"]  # fmt: skip
    return Table("stability", head, rows)


def cells(evidence: Evidence) -> Table:
    """Everything: every cell of every study."""
    measured, rows = evidence.measured, list[list[Entry]]()
    for cell in measured.cells():
        lost = measured.values(cell, "diverged")
        numbers = [measured.percent(cell), measured.percent(cell, "chattering")]
        rows.append([cell.study, cell.label, *cell[2:], len(lost), int(lost.sum()), *numbers])
    head = ["study", "controller", "reference", "model", "noise", "noise time [s]", "payload [kg]",
            "delay [s]", "loss", "episodes", "diverged", "error [%]", "chattering [%]"]  # fmt: skip
    return Table("cells", head, rows)


def numbers(claims: Sequence[Claim]) -> Table:
    """All numbers of all claims but timings."""
    rows = [
        (c.letter, str(c.verdict), c.condition, row.name, *ends(row.value), row.unit)
        for c in claims
        for row in c.rows
        if not row.varies
    ]
    head = ["claim", "verdict", "condition", "measured", "value", "low", "high", "unit"]
    return Table("claims", head, rows)


def timings(evidence: Evidence) -> Table:
    """What a step takes on this machine."""
    rows = [
        (cost.label, 1e6 * cost.many, 1e6 * cost.alone, 100.0 * cost.many * RATE)
        for cost in evidence.costs.values()
    ]
    head = ["controller", "an arm of 1024 [us]", "one arm alone [us]", "arithmetic [% of period]"]
    return Table("timings", head, rows)


def _mean_error(evidence: Evidence, label: str, noise: float) -> Interval:
    """Error of a variant, mean over the nominal models; seed by seed [%]."""
    return interval(100.0 * evidence.measured.mean_error(label, noise))


def _noise(noise: float) -> str:
    return f"{100 * noise:.0f} %" if noise else "none"


def _labels(evidence: Evidence, *studies: str) -> list[str]:
    """The tuned controllers that are in some of these studies."""
    known = {cell.label for cell in evidence.measured.cells() if cell.study in studies}
    return [name for name in CONTROLLERS if name in known]
