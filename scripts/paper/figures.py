"""The figures: 1 and 2 of the paper on this arm, those of the studies, and the README's."""

import warnings
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.palette import look_of
from octarm.reports import figures as style
from octarm.reports.figures import INK, Axes, Figure, Picture
from octarm.reports.statistics import Interval
from paper import studies, variants
from paper.claims import worded, words
from paper.evidence import Cell, Evidence, coordinates
from paper.numbers import percent
from paper.runs import LONG, Series, name_of
from paper.studies import BENDS, BEYOND, MODELS, MODULES, MOVING, NOISE, RATES, SLIDES, WRONG
from paper.variants import CONSEQUENT, CONTROLLERS, INTEGRAL, PROPOSED, SIGN, SMC, by_hand

GRAY = "#5f6b77"
NAMES = {PROPOSED: "AFSMC (proposed)", SMC: "SMC, boundary layer", SIGN: "SMC, sgn"}


class Look(NamedTuple):
    """How a variant is drawn, the same in all figures."""

    color: str
    line: Any
    marker: str


_ABLATIONS = {
    variants.FIXED_RULES: Look("#3a7ca5", ":", "x"),
    variants.FIXED_PREMISES: Look("#7a8f1f", "--", "x"),
    variants.AS_PRINTED: Look("#7d6bd0", ":", "x"),
    variants.UNGUARDED: Look("#b0413e", "-", "x"),
    variants.MATCHED: Look("#dd9500", "--", "x"),
}


def look(label: str) -> Look:
    """The look of a variant; hand-set gains have a dashed line."""
    if label in _ABLATIONS:
        return _ABLATIONS[label]
    name = label.removesuffix(by_hand(""))
    color, marker = look_of(name)
    return Look(color, "-" if name == label else (0, (4, 1.5)), marker)


def title_of(label: str) -> str:
    """The name of a variant in a legend."""
    name, comma, rest = label.partition(", ")
    return NAMES.get(name, name) + comma + rest


def pictures(evidence: Evidence) -> Iterator[Picture]:
    """All figures that there are numbers for, the README's first."""
    effort, texts = evidence.effort, words()["figures"]

    def drawn(name: str, figure: Figure, caption: str = "", **numbers: Any) -> Picture:
        text = worded(caption or texts[name], seeds=effort.seeds, **numbers)
        return style.save_figure(name, text, figure)

    with style.figure_style():
        yield drawn("paper", _readme(evidence))
        for reference in effort.readings:
            ending, joints = studies.READINGS[reference], " and ".join(MOVING[reference])
            for figure, noise in (("figure-1", 0.0), ("figure-2", NOISE)):
                shape = _tracking(evidence, reference, noise)
                yield drawn(f"{figure}-{ending}", shape, texts[figure], joints=joints)
        kinds = {"overshoot": _overshoot, "ranking": _ranking, "ablations": _ablations}
        if any(evidence.plants()):
            kinds = {"plants": _plants, **kinds}
        if effort.long:
            kinds |= {"degradation": _degradation, "beyond": _beyond, "rates": _rates}
            kinds["drift"] = _drift
        for name, draw in kinds.items():
            yield drawn(name, draw(evidence))


def _tracking(evidence: Evidence, reference: str, noise: float) -> Figure:
    """Motion and error of both joints over time, a column a nominal model."""
    unit = {BENDS: "rad", SLIDES: "m"}[reference]
    joints, labels = MOVING[reference], evidence.effort.labels
    figure, grid = _panels(2 * len(joints), len(MODELS), 3.1, 1.45, sharex=True, sharey="row")
    for row, joint in enumerate(joints):
        motions, errors = grid[2 * row : 2 * row + 2]
        place = coordinates().index(joint)
        for ax, model in zip(motions, MODELS, strict=True):
            series = evidence.series[name_of(labels[0], reference)]
            desired = series.q_d[:, place]
            ax.plot(series.t, desired, color=INK, linewidth=3.2, alpha=0.25, label="desired")
            for label in labels:
                series = evidence.series[name_of(label, reference)]
                _median(ax, label, series.t, series.of(model, noise)[:, :, place])
        motions[0].set_ylabel(f"{joint} [{unit}]")
        errors[0].set_ylabel(f"error [m{unit}]")
        _draw_errors(errors, evidence, labels, reference, joint, noise)
        # The errors of the two controllers of the paper stay in view.
        runs = [evidence.series[name_of(name, reference)] for name in (SMC, PROPOSED)]
        sizes = [
            np.abs(_errors(series, model, noise, place)[series.t > 0.5])
            for series in runs
            for model in MODELS
        ]
        largest = max(float(np.nanpercentile(size, 99.9)) for size in sizes)
        errors[0].set_ylim(-1.5 * largest, 1.5 * largest)
    _finish_times(figure, grid, evidence.effort.duration)
    figure.align_ylabels(grid[:, 0])
    return figure


def _readme(evidence: Evidence) -> Figure:
    """Errors of theta1 over time without and with noise, a column a nominal model."""
    figure, grid = _panels(2, len(MODELS), 3.3, 1.75, sharex=True, sharey="row")
    for row, noise, name in zip(grid, (0.0, NOISE), ("no noise", "40 % noise"), strict=True):
        _draw_errors(row, evidence, (SMC, PROPOSED), BENDS, "theta1", noise)
        row[0].set_ylabel(f"error of theta1 [mrad]\n{name}")
    _finish_times(figure, grid, evidence.effort.duration)
    return figure


def _draw_errors(
    row: Sequence[Axes], evidence: Evidence, labels: Sequence[str], reference: str, joint: str,
    noise: float,
) -> None:  # fmt: skip
    """Errors of a joint over time, a panel a nominal model."""
    for ax, model in zip(row, MODELS, strict=True):
        for label in labels:
            series = evidence.series[name_of(label, reference)]
            own = _errors(series, model, noise, coordinates().index(joint))
            _median(ax, label, series.t, own)
        _zero_line(ax)


def _errors(series: Series, model: float, noise: float, place: int) -> np.ndarray:
    """Errors of a coordinate of some arms, shape (T, k) [mrad] or [mm]."""
    return 1e3 * (series.of(model, noise)[:, :, place] - series.q_d[:, place, None])


def _finish_times(figure: Figure, grid: np.ndarray, duration: float) -> None:
    """Titles, time axes and legend of panels with a column a nominal model."""
    for column, model in zip(grid.T, MODELS, strict=True):
        column[0].set_title(f"nominal model {percent(model)}")
        column[-1].set(xlabel="time [s]", xlim=(0.0, duration), xticks=np.arange(duration))
    _legend(figure, grid[0, 0])


def _overshoot(evidence: Evidence) -> Figure:
    readings = [(r, j) for r in MOVING for j in MOVING[r]]
    figure, grid = _panels(1, len(readings), 2.6, 2.5)
    models, labels = evidence.models(by_hand(SMC)), (SMC, by_hand(SMC), PROPOSED, by_hand(PROPOSED))
    for ax, (reference, joint) in zip(grid[0], readings, strict=True):
        for label in labels:
            cells = [Cell(label, reference=reference, mismatch=m) for m in models]
            percents = 100.0 * np.array(models)
            _curve(evidence, ax, percents, cells, f"overshoot_{joint}", marker=False)
        _zero_line(ax)
        ax.axhline(3.0, color=GRAY, linewidth=0.9, linestyle=":")
        ax.set(title=f"overshoot of {joint} [%]", xlabel="error of the nominal model [%]")
    _legend(figure, grid[0, 0])
    return figure


def _plants(evidence: Evidence) -> Figure:
    """Errors of all laws: a column a plant, a row a control period."""
    effort = evidence.effort
    places = {
        (cells[0].plant, cells[0].study, cells[0].noise): {cell.label: cell for cell in cells}
        for cells in evidence.plants()
    }
    start = places[effort.plants[0], studies.study_of_plants(effort.plant_rates[0]), NOISE]
    order = sorted(start, key=lambda name: evidence.error(start[name]).value)
    shape = len(effort.plant_rates), len(effort.plants)
    figure, grid = _panels(*shape, 2.3, 0.21 * len(order) + 0.55, sharex=True, sharey=True)
    for row, rate in zip(grid, effort.plant_rates, strict=True):
        for ax, modules in zip(row, effort.plants, strict=True):
            for noise in (NOISE, 0.0):
                cells = places[modules, studies.study_of_plants(rate), noise]
                for place, name in enumerate(order):
                    _plant_mark(ax, name, evidence.error(cells[name]), place, noise)
            ax.set_title(f"{modules} modules" + (", the model" if modules == MODULES else ""))
            _named_rows(ax, [title_of(name) for name in order])
        row[0].set_ylabel(f"control period {1e3 / rate:g} ms")
    for ax in grid[-1]:
        ax.set_xlabel("error [% of the motion]")
    first = grid[0, 0]
    _logarithmic(first, "x")
    low, high = first.get_xlim()
    first.set_xlim(low, high * (high / low) ** 0.12)  # room for the crosses
    first.invert_yaxis()
    marks = (("o", "full", "40 % noise"), ("o", "none", "no noise"), ("x", "full", "lost"))
    for marker, fill, label in marks:
        first.plot([], [], marker, color=GRAY, fillstyle=fill, label=label)
    _legend(figure, first)
    return figure


def _plant_mark(ax: Axes, name: str, error: Interval, place: int, noise: float) -> None:
    """An error under noise, full, or without, hollow; a cross at the edge where the arm is lost."""
    if not np.isfinite(error.value):
        y, size = place + (0.0 if noise else 0.2), 5 if noise else 3
        ax.plot(0.96, y, "x", color=look(name).color, markersize=size, markeredgewidth=1.4,
                transform=ax.get_yaxis_transform())  # fmt: skip
    else:
        _dot(ax, name, error, place, hollow=not noise)


def _ranking(evidence: Evidence) -> Figure:
    order = evidence.ranked(CONTROLLERS, NOISE)
    figure, grid = _panels(1, len(MODELS), 3.1, 0.25 * len(order) + 0.6, sharey=True, sharex=True)
    for ax, model in zip(grid[0], MODELS, strict=True):
        for place, name in enumerate(order):
            for noise in (NOISE, 0.0):
                error = evidence.error(Cell(name, mismatch=model, noise=noise))
                _dot(ax, name, error, place, hollow=not noise)
        _logarithmic(ax, "x")
        ax.set(title=f"nominal model {percent(model)}", xlabel="error [% of the motion]")
        _named_rows(ax, order)
    grid[0, 0].invert_yaxis()
    return figure


def _ablations(evidence: Evidence) -> Figure:
    labels = [
        name for name in (CONSEQUENT, SMC, INTEGRAL, *variants.ABLATIONS)
        if evidence.has(Cell(name, noise=NOISE))
    ]  # fmt: skip
    readings = [
        reference for reference in MOVING
        if evidence.known([Cell(name, reference=reference, noise=NOISE) for name in labels])
    ]  # fmt: skip
    figure, grid = _panels(1, len(readings), 4.6, 0.42 * len(labels) + 0.7, sharey=True)
    shades = dict(zip(MODELS, (("o", -0.2), ("s", 0.0), ("^", 0.2)), strict=True))
    for ax, reference in zip(grid[0], readings, strict=True):
        for place, label in enumerate(labels):
            for cell in evidence.known(Cell(label, reference=reference, noise=NOISE).models()):
                marker, shift = shades[cell.mismatch]
                _dot(ax, label, evidence.ratio(cell, PROPOSED), place + shift, marker)
        ax.axvline(1.0, color=GRAY, linewidth=0.9, linestyle=":")
        ax.set(xscale="log", title=", ".join(MOVING[reference]), xlabel="error over that of afsmc")
        _named_rows(ax, [title_of(label) for label in labels])
        low, high = ax.get_xlim()  # of few decades: numbers without powers
        marks = (0.2, 0.3, 0.5, 0.7, 0.8, 1, 1.2, 1.5, 2, 3, 5, 10, 20)
        _ticks(ax, [mark for mark in marks if low <= mark <= high])
    for model, (marker, _) in shades.items():
        grid[0, 0].plot([], [], marker, color=GRAY, label=f"nominal model {percent(model)}")
    grid[0, 0].invert_yaxis()
    _legend(figure, grid[0, 0])
    return figure


def _degradation(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, 2, 4.2, 2.8)
    noises = evidence.noises()
    quantities = (("error", "error of all joints [% of the motion]", 100.0),
                  ("rms_error_theta1", "rms error of theta1 [mrad]", 1e3))  # fmt: skip
    for ax, (quantity, title, factor) in zip(grid[0], quantities, strict=True):
        for label in CONTROLLERS:
            cells = [Cell(label, "degradation", BENDS, WRONG, noise) for noise in noises]
            _curve(evidence, ax, 100.0 * np.array(noises), cells, quantity, factor)
        ax.axvline(100.0 * NOISE, color=GRAY, linewidth=0.9, linestyle=":")
        ax.set(title=title, xlabel="rms of the noise [% of the input's amplitude]")
        ax.set_ylim(0.0, None)
    _legend(figure, grid[0, 0])
    return figure


def _beyond(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, len(BEYOND), 3.3, 2.9)
    for ax, (name, sort) in zip(grid[0], BEYOND.items(), strict=True):
        for label in CONTROLLERS:
            start = Cell(label, "beyond", mismatch=WRONG)
            cells = [start._replace(**{name: x}) for x in sort.values]
            _curve(evidence, ax, sort.factor * np.array(sort.values), cells, "error", 100.0)
        _logarithmic(ax, "y")
        quantity = "loss of force" if name == "loss" else name
        ax.set(xlabel=f"{quantity} [{sort.unit}]", title="error [% of the motion]")
    _legend(figure, grid[0, 0])
    figure.set_figheight(figure.get_figheight() + 0.3)
    return figure


def _rates(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, 3, 3.2, 2.6)
    panels = (("error", NOISE, "error, 40 % noise [% of the motion]"),
              ("chattering", NOISE, "chattering, 40 % noise [% of weight]"),
              ("chattering", 0.0, "chattering, no noise [% of weight]"))  # fmt: skip
    start = Cell(PROPOSED, mismatch=WRONG, noise=NOISE)
    rates = [r for r in RATES if evidence.has(start._replace(study=studies.study_of_rate(r)))]
    for ax, (quantity, noise, title) in zip(grid[0], panels, strict=True):
        for label in (PROPOSED, SMC, variants.TWISTING, SIGN):
            cells = [Cell(label, studies.study_of_rate(r), BENDS, WRONG, noise) for r in rates]
            _curve(evidence, ax, np.array(rates), cells, quantity, 100.0)
        ax.set_xscale("log")
        _logarithmic(ax, "y")
        _ticks(ax, rates)
        ax.set(xlabel="control rate [Hz]", title=title)
    _legend(figure, grid[0, 0])
    return figure


def _drift(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, 2, 4.2, 2.6)
    gain, left = grid[0]
    for label, name in LONG.items():
        series = evidence.series[name]
        E = series.E[:, :, coordinates().index("theta1")]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of instants at which no arm is left
            _median(gain, label, series.t, np.where(E > 0.0, E, np.nan), np.nanpercentile)
        left.plot(series.t, 100.0 * np.mean(~np.isnan(E), axis=1), color=look(label).color)
    _logarithmic(gain, "y")
    gain.set(title="gain E of theta1 [N m]", xlabel="time [s]")
    left.set(title="arms within their limits [%]", xlabel="time [s]", ylim=(-3.0, 103.0))
    _legend(figure, gain)
    return figure


def _panels(
    rows: int, columns: int, width: float, height: float, **options: Any
) -> tuple[Figure, np.ndarray]:
    """A grid of panels of this size [inch], shape (rows, columns)."""
    figure = NewFigure(figsize=(width * columns, height * rows + 0.4), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def _legend(figure: Figure, ax: Axes) -> None:
    """One legend for all panels, above them."""
    handles, labels = ax.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        list(unique.values()), list(unique), loc="outside upper center", handlelength=2.2,
        ncols=min(len(unique), 5), columnspacing=1.8,
    )  # fmt: skip


def _zero_line(ax: Axes) -> None:
    ax.axhline(0.0, color=INK, linewidth=0.6, zorder=1)


def _logarithmic(ax: Axes, which: str) -> None:
    """Makes an axis logarithmic, with plain numbers at its ticks."""
    getattr(ax, f"set_{which}scale")("log")
    style.logarithmic_ticks(getattr(ax, f"{which}axis"), *getattr(ax, f"get_{which}lim")())


def _ticks(ax: Axes, ticks: Sequence[float]) -> None:
    """Plain numbers at these places of the x axis alone."""
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_xticks([], minor=True)


def _named_rows(ax: Axes, names: Sequence[str]) -> None:
    ax.set_yticks(range(len(names)), names)
    ax.tick_params(axis="y", length=0)


def _median(
    ax: Axes, label: str, t: np.ndarray, own: np.ndarray, percentile: Any = np.percentile
) -> None:
    """The median of some arms over time, shape (T, k), and a band of 5 to 95 % of them."""
    low, middle, high = percentile(own, [5.0, 50.0, 95.0], axis=1)
    ax.plot(t, middle, color=look(label).color, label=title_of(label), linewidth=1.1)
    if own.shape[1] > 1:
        ax.fill_between(t, low, high, color=look(label).color, alpha=0.22, linewidth=0.0)


def _curve(
    evidence: Evidence, ax: Axes, x: np.ndarray, cells: Sequence[Cell], quantity: str,
    factor: float = 1.0, *, marker: bool = True,
) -> None:  # fmt: skip
    """Medians of a variant's cells with a band of intervals, where finite; none if not all ran."""
    if not evidence.has(*cells):
        return
    numbers = np.array([evidence.median(cell, quantity, factor) for cell in cells], dtype=float)
    value, low, high = np.where(np.isfinite(numbers), numbers, np.nan).T
    color, line, mark = look(cells[0].label)
    ax.plot(
        x, value, color=color, linestyle=line, marker=mark if marker else "",
        label=title_of(cells[0].label), markeredgewidth=0.0,
    )  # fmt: skip
    if np.any(low < high):
        ax.fill_between(x, low, high, color=color, alpha=0.18, linewidth=0.0)


def _dot(
    ax: Axes, label: str, own: Interval, y: float, marker: str = "o", *, hollow: bool = False
) -> None:
    """A median with its interval, sideways; without the latter, hollow, where nothing is random."""
    color = look(label).color
    if hollow:
        ax.plot(own.value, y, marker, color=color, fillstyle="none")
    elif np.isfinite(own.value):
        ax.plot([own.low, own.high], [y, y], color=color, linewidth=1.2)
        ax.plot(own.value, y, marker, color=color, markersize=5)
