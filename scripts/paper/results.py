"""Which tables there are, and what stands in them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from paper import rankings
from paper.claims import percent
from paper.evidence import Evidence
from paper.measured import Cell, interval
from paper.quantities import chattering_of, error_of
from paper.series import EVERY, LONG
from paper.studies import BEYOND, MODELS, NOISE, RATE, TIME, WRONG, study_of_rate
from paper.tables import Entry, Table
from paper.variants import CONTROLLERS


def tables(evidence: Evidence, gains: Path) -> list[Table]:
    """All tables that are the same in every run.

    Args:
        evidence: what was run.
        gains: folder of the tuned gain sets.
    """
    found = [
        rankings.ranking(evidence),
        rankings.joints(evidence),
        rankings.ablations(evidence),
        rankings.gain_sets(evidence),
        rankings.tuning(evidence, gains),
        rates(evidence),
        correlation(evidence),
        degradation(evidence),
        *(beyond(evidence, name) for name in BEYOND),
        drift(evidence),
        stability(evidence),
        cells(evidence),
    ]
    return [table for table in found if table.rows]


def timings(evidence: Evidence) -> Table:
    """What a step takes on this machine."""
    own = evidence.costs.values()
    rows = [(c.label, 1e6 * c.many, 1e6 * c.alone, 100.0 * c.many * RATE) for c in own]
    caption = (
        f"Shortest of many steps on one core, this machine, this run; in percent of the control "
        f"period of {1e3 / RATE:g} ms."
    )
    head = ("controller", "an arm of 1024 [us]", "one arm alone [us]", "arithmetic [% of period]")
    return Table("timings", caption, head, tuple(rows))


def rates(evidence: Evidence) -> Table:
    """Other control rates."""
    rows: list[tuple[Entry, ...]] = []
    for rate in sorted({*evidence.effort.rates, RATE}):
        for label in _labels(evidence, study_of_rate(rate)) if evidence.effort.rates else ():
            noisy = Cell(label, study_of_rate(rate), mismatch=WRONG, noise=NOISE)
            rows.append((f"{rate:g} Hz", *_both(evidence, noisy)))
    return Table("rates", _CAPTION.format("at other control rates"), ("rate", *_BOTH), tuple(rows))


def correlation(evidence: Evidence) -> Table:
    """Other correlation times of the noise."""
    rows: list[tuple[Entry, ...]] = []
    for time in sorted({*evidence.effort.times, TIME}) if evidence.effort.times else ():
        for label in _labels(evidence, "correlation"):
            study = "tracking" if time == TIME else "correlation"
            cell = Cell(label, study, mismatch=WRONG, noise=NOISE, time=time)
            lost, count = evidence.measured.diverged(cell)
            entries = (error_of(evidence, cell), chattering_of(evidence, cell))
            rows.append((f"{1e3 * time:g} ms", label, *entries, f"{lost} of {count}"))
    head = ("correlation time", "controller", "error [%]", "chattering [%]", "diverged")
    caption = _CAPTION.format("with noise that is held for other times")
    return Table("correlation", caption, head, tuple(rows))


def degradation(evidence: Evidence) -> Table:
    """Error over the strength of the noise."""
    noises = (0.0, *evidence.effort.noises) if evidence.effort.noises else ()
    rows: list[tuple[Entry, ...]] = []
    for label in _labels(evidence, "degradation"):
        own = [Cell(label, "degradation", mismatch=WRONG, noise=noise) for noise in noises]
        rows.append((label, *(error_of(evidence, cell) for cell in own)))
    head = ("controller", *(f"{100 * noise:g} % noise" for noise in noises))
    caption = "Error in percent of the motion over the noise. " + _CAPTION.format("")
    return Table("degradation", caption, head, tuple(rows))


def beyond(evidence: Evidence, name: str) -> Table:
    """Payload, delay or loss."""
    axis, values, _ = BEYOND[name]
    field = axis.removeprefix("actuation-")
    unit, factor = {"payload": ("kg", 1.0), "delay": ("ms", 1e3), "loss": ("%", 100.0)}[name]
    rows: list[tuple[Entry, ...]] = []
    for label in CONTROLLERS:
        for model in MODELS:
            start = Cell(label, "beyond", mismatch=model)
            own = [start._replace(**{field: value}) for value in values]
            if all(map(evidence.measured.has, own)):
                rows.append((label, percent(model), *(error_of(evidence, cell) for cell in own)))
    head = ("controller", "model", *(f"{factor * value:g} {unit}" for value in values))
    caption = (
        f"Beyond the paper: error in percent of the motion over the {name}, tuned gains, without "
        "noise; nothing is random. ∞: the arm left its limits."
    )
    return Table(name, caption, head, tuple(rows))


def drift(evidence: Evidence) -> Table:
    """What grows in long runs with and without safeguards."""
    rows: list[tuple[Entry, ...]] = []
    for label, name in LONG.items():
        if name not in evidence.series:
            continue
        series = evidence.series[name]
        bounds = np.asarray(evidence.cast[label].gains["E_max"])
        largest = np.max(series.E / bounds, axis=2)  # of all coordinates, in bounds
        lost = int(np.sum(~np.isnan(series.diverged_at)))
        first = np.nanmin(series.diverged_at) if lost else math.nan
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of arms that are lost from the start
            late = [np.nanmax(largest[: round(t / EVERY)], axis=0) for t in (2.0, 5.0, 10.0, 20.0)]
        rows.append((label, *map(interval, late), f"{lost} of {len(series.noise)}", first))
    head = ("controller", "2 s", "5 s", "10 s", "20 s", "diverged", "first at [s]")
    caption = (
        "Largest gain E over its bound of any joint within so many seconds, under 40 % noise with "
        f"the model at {percent(WRONG)}."
    )
    return Table("drift", caption, head, tuple(rows))


def stability(evidence: Evidence) -> Table:
    """How V went on sampled runs."""
    rows: list[tuple[Entry, ...]] = []
    for o in evidence.outcomes:
        grown = [
            100.0 * g / n if n else math.nan
            for g, n in ((o.grown_outside, o.outside), (o.grown_inside, o.inside))
        ]
        where = (o.label, f"{o.rate:g} Hz", percent(o.mismatch), "yes" if o.covered else "no")
        rows.append((*where, o.outside, grown[0], o.inside, grown[1], 1e3 * o.start, 1e3 * o.bound))
    head = (
        "controller",
        "rate",
        "model",
        "gains cover the model error",
        "periods outside",
        "V grew [%]",
        "periods inside",
        "V grew inside [%]",
        "V at the start [mJ]",
        "largest 1/2 s^T D s after 2 s [mJ]",
    )
    caption = "The Lyapunov functions (32) and (80) at the control instants of runs without noise."
    return Table("stability", caption, head, tuple(rows))


def cells(evidence: Evidence) -> Table:
    """Everything: every cell of every study."""
    rows: list[tuple[Entry, ...]] = []
    for cell in evidence.measured.cells():
        lost, count = evidence.measured.diverged(cell)
        numbers = [error_of(evidence, cell), chattering_of(evidence, cell)]
        rows.append((cell.study, cell.label, *cell[2:], count, lost, *numbers))
    head = (
        "study",
        "controller",
        "reference",
        "model",
        "noise",
        "noise time [s]",
        "payload [kg]",
        "delay [s]",
        "loss",
        "episodes",
        "diverged",
        "error [%]",
        "chattering [%]",
    )
    return Table("cells", "Every cell of every study.", head, tuple(rows))


_BOTH = (
    "controller",
    "error, noise [%]",
    "error, no noise [%]",
    "chattering, noise [%]",
    "chattering, no noise [%]",
    "diverged",
)
_CAPTION = f"Tuned gains {{}} (theta1 and theta2, model at {percent(WRONG)}, medians over seeds)."


def _both(evidence: Evidence, noisy: Cell) -> tuple[Entry, ...]:
    quiet = noisy._replace(noise=0.0)
    lost = [evidence.measured.diverged(cell) for cell in (noisy, quiet)]
    told = f"{sum(n for n, _ in lost)} of {sum(n for _, n in lost)}"
    entries = [of(evidence, cell) for of in (error_of, chattering_of) for cell in (noisy, quiet)]
    return (noisy.label, *entries, told)


def _labels(evidence: Evidence, study: str) -> Sequence[str]:
    """The variants that a study of rates, times or noises has."""
    found = {cell.label for cell in evidence.measured.cells() if cell.study == study}
    if study == "tracking":
        others = [s for s in map(study_of_rate, evidence.effort.rates)]
        found = {c.label for c in evidence.measured.cells() if c.study in others}
    return [name for name in CONTROLLERS if name in found]
