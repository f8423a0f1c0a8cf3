"""The figures: 1 and 2 of the paper on this arm, those of the studies, and the README's."""

import warnings
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.palette import look_of
from octarm.reports import figures as style
from octarm.reports.figures import INK, Axes, Figure, Picture
from octarm.reports.statistics import Interval
from paper.claims import worded, words
from paper.evidence import Evidence
from paper.numbers import percent
from paper.runs import LONG, name_of
from paper.studies import BENDS, COORDINATES, MODELS, MODULES, MOVING, NOISE, READINGS, SLIDES, Cell
from paper.variants import CONTROLLERS, INSTEAD, PROPOSED, SMC, by_hand

GRAY = "#5f6b77"
DOTTED = {"color": GRAY, "linewidth": 0.9, "linestyle": ":"}  # what the paper says, and equality
ZERO = {"color": INK, "linewidth": 0.6, "zorder": 1}
OVER_TIME = {"sharex": True, "sharey": "row"}
NOISES = {"figure-1": 0.0, "figure-2": NOISE}  # of the paper's figures


class Look(NamedTuple):
    """How a variant is drawn, the same in all figures."""

    color: str
    line: Any
    marker: str


def look(label: str) -> Look:
    """The look of a variant; hand-set gains have a dashed line."""
    if label in words()["looks"]:
        return Look(**words()["looks"][label])
    name = label.removesuffix(by_hand(""))
    color, marker = look_of(name)
    return Look(color, "-" if name == label else (0, (4, 1.5)), marker)


def title_of(label: str) -> str:
    """The name of a variant in a legend."""
    name, comma, rest = label.partition(", ")
    return words()["legend"].get(name, name) + comma + rest


def pictures(evidence: Evidence) -> Iterator[Picture]:
    """All figures that there are numbers for, the README's first."""
    effort, texts = evidence.effort, words()["figures"]

    def drawn(key: str, figure: Figure, name: str = "", **numbers: Any) -> Picture:
        caption = worded(texts[key]["caption"], seeds=effort.seeds, **numbers)
        return style.save_figure(name or key, caption, figure)

    with style.figure_style():
        yield drawn("paper", _readme(evidence))
        for reference, (key, noise) in product(effort.readings, NOISES.items()):
            figure, name = _tracking(evidence, reference, noise), f"{key}-{READINGS[reference]}"
            yield drawn(key, figure, name, joints=" and ".join(MOVING[reference]))
        if any(evidence.plants()):
            yield drawn("plants", _plants(evidence))
        yield drawn("overshoot", _curves(evidence, "overshoot"))
        yield drawn("ranking", _ranking(evidence))
        yield drawn("ablations", _ablations(evidence))
        if effort.long:
            for key in ("degradation", "beyond", "rates"):
                yield drawn(key, _curves(evidence, key))
            yield drawn("drift", _drift(evidence))


def _tracking(evidence: Evidence, reference: str, noise: float) -> Figure:
    """Motion and error of both joints over time, a column a nominal model."""
    unit = {BENDS: "rad", SLIDES: "m"}[reference]
    joints, labels = MOVING[reference], evidence.effort.labels
    figure, grid = _panels(2 * len(joints), len(MODELS), 3.1, 1.45, **OVER_TIME)
    for joint, motions, errors in zip(joints, grid[::2], grid[1::2], strict=True):
        place = COORDINATES.index(joint)
        for ax, model in zip(motions, MODELS, strict=True):
            series = evidence.series[name_of(labels[0], reference)]
            desired = series.q_d[:, place]
            ax.plot(series.t, desired, color=INK, linewidth=3.2, alpha=0.25, label="desired")
            for label in labels:
                series = evidence.series[name_of(label, reference)]
                _median(ax, label, series.t, series.of(model, noise)[:, :, place])
        motions[0].set_ylabel(f"{joint} [{unit}]")
        errors[0].set_ylabel(f"error [m{unit}]")
        largest = 1.5 * _draw_errors(errors, evidence, labels, reference, joint, noise)
        errors[0].set_ylim(-largest, largest)
    _finish_times(figure, grid, evidence.effort.duration)
    figure.align_ylabels(grid[:, 0])
    return figure


def _readme(evidence: Evidence) -> Figure:
    """Errors of theta1 over time without and with noise, a column a nominal model."""
    figure, grid = _panels(2, len(MODELS), 3.3, 1.75, **OVER_TIME)
    for row, noise, name in zip(grid, (0.0, NOISE), ("no noise", "40 % noise"), strict=True):
        _draw_errors(row, evidence, (SMC, PROPOSED), BENDS, "theta1", noise)
        row[0].set_ylabel(f"error of theta1 [mrad]\n{name}")
    _finish_times(figure, grid, evidence.effort.duration)
    return figure


def _draw_errors(
    row: Sequence[Axes], evidence: Evidence, labels: Sequence[str], reference: str, joint: str,
    noise: float,
) -> float:  # fmt: skip
    """Errors of a joint over time, a panel a nominal model [mrad] or [mm].

    Returns the largest of those of the paper's two controllers, which stay in view.
    """
    place, largest = COORDINATES.index(joint), 0.0
    for ax, model in zip(row, MODELS, strict=True):
        for label in labels:
            series = evidence.series[name_of(label, reference)]
            errors = 1e3 * (series.of(model, noise)[:, :, place] - series.q_d[:, place, None])
            _median(ax, label, series.t, errors)
            if label in (SMC, PROPOSED):
                late = np.abs(errors[series.t > 0.5])
                largest = max(largest, float(np.nanpercentile(late, 99.9)))
        ax.axhline(0.0, **ZERO)
    return largest


def _finish_times(figure: Figure, grid: np.ndarray, duration: float) -> None:
    """Titles, time axes and legend of panels with a column a nominal model."""
    for column, model in zip(grid.T, MODELS, strict=True):
        column[0].set_title(f"nominal model {percent(model)}")
        column[-1].set(xlabel="time [s]", xlim=(0.0, duration), xticks=np.arange(duration))
    _legend(figure, grid[0, 0])


def _plants(evidence: Evidence) -> Figure:
    """Errors of all laws: a column a plant, a row a control period."""
    rates, modules = evidence.effort.plant_rates, evidence.effort.plants
    start = Cell("", "plants", noise=NOISE, plant=modules[0], rate=rates[0])
    cells = start.of(evidence.effort.plant_labels)
    order = sorted(cells, key=lambda cell: evidence.median(cell).value)
    height = 0.21 * len(order) + 0.55
    figure, grid = _panels(len(rates), len(modules), 2.3, height, sharex=True, sharey=True)
    for ax, (rate, plant) in zip(grid.flat, product(rates, modules), strict=True):
        for noise, (place, cell) in product((NOISE, 0.0), enumerate(order)):
            error = evidence.median(cell._replace(noise=noise, plant=plant, rate=rate))
            _dot(ax, cell.label, error, place, hollow=not noise, lost=True)
        ax.set_title(f"{plant} modules" + (", the model" if plant == MODULES else ""))
        _named_rows(ax, [title_of(cell.label) for cell in order])
    for ax, rate in zip(grid[:, 0], rates, strict=True):
        ax.set_ylabel(f"control period {1e3 / rate:g} ms")
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


def _ranking(evidence: Evidence) -> Figure:
    """Errors of all controllers, a panel a nominal model."""
    order = evidence.ranked(Cell("", noise=NOISE).of(CONTROLLERS))
    figure, grid = _panels(1, len(MODELS), 3.1, 0.25 * len(order) + 0.6, sharey=True, sharex=True)
    for ax, model in zip(grid[0], MODELS, strict=True):
        for (place, cell), noise in product(enumerate(order), (NOISE, 0.0)):
            error = evidence.median(cell._replace(mismatch=model, noise=noise))
            _dot(ax, cell.label, error, place, hollow=not noise)
        _logarithmic(ax, "x")
        ax.set(title=f"nominal model {percent(model)}", xlabel="error [% of the motion]")
        _named_rows(ax, [cell.label for cell in order])
    grid[0, 0].invert_yaxis()
    return figure


def _ablations(evidence: Evidence) -> Figure:
    """Errors under noise over those of `afsmc`, a panel for each reading of the joints."""
    labels = [cell.label for cell in evidence.known(Cell("", noise=NOISE).of(INSTEAD))]
    places = [Cell("", reference=reference, noise=NOISE) for reference in MOVING]
    places = [place for place in places if evidence.known(place.of(labels))]
    figure, grid = _panels(1, len(places), 4.6, 0.42 * len(labels) + 0.7, sharey=True)
    shades = dict(zip(MODELS, (("o", -0.2), ("s", 0.0), ("^", 0.2)), strict=True))
    for ax, place in zip(grid[0], places, strict=True):
        for row, cell in enumerate(place.of(labels)):
            for each in evidence.known(cell.models()):
                marker, shift = shades[each.mismatch]
                _dot(ax, each.label, evidence.ratio(each, PROPOSED), row + shift, marker)
        ax.axvline(1.0, **DOTTED)
        title = ", ".join(MOVING[place.reference])
        ax.set(xscale="log", title=title, xlabel="error over that of afsmc")
        _named_rows(ax, [title_of(label) for label in labels])
        low, high = ax.get_xlim()  # of few decades: numbers without powers
        marks = (0.2, 0.3, 0.5, 0.7, 0.8, 1, 1.2, 1.5, 2, 3, 5, 10, 20)
        _ticks(ax, [mark for mark in marks if low <= mark <= high])
    for model, (marker, _) in shades.items():
        grid[0, 0].plot([], [], marker, color=GRAY, label=f"nominal model {percent(model)}")
    grid[0, 0].invert_yaxis()
    _legend(figure, grid[0, 0])
    return figure


def _drift(evidence: Evidence) -> Figure:
    """The gain E of theta1 in long runs, and how many arms are left."""
    figure, grid = _panels(1, 2, 4.2, 2.6)
    gain, left = grid[0]
    for label, name in LONG.items():
        series = evidence.series[name]
        E = series.E[:, :, COORDINATES.index("theta1")]
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


def _curves(evidence: Evidence, name: str) -> Figure:
    """Panels of `words.toml` side by side: medians over a field of cells, a curve a variant.

    A curve has a band of intervals, where they are finite, and is left out unless all was run.
    """
    common = {**words()["curves"], **words()["figures"][name]}
    figure, grid = _panels(1, len(common["panels"]), *common["size"])
    for ax, own in zip(grid[0], common["panels"], strict=True):
        panel = {**common, **own}
        start, field = Cell("", **panel["at"]), panel["over"]
        values = evidence.varied(start, field)
        x = panel["unit"] * np.array(values)
        for label in panel["labels"]:
            cells = [start._replace(**{"label": label, field: value}) for value in values]
            if evidence.has(*cells):
                medians = [evidence.median(cell, panel["of"]) for cell in cells]
                _curve(ax, label, x, medians, panel["markers"])
        for axis, value in panel["paper"].items():
            {"x": ax.axvline, "y": ax.axhline}[axis](value, **DOTTED)
        if panel["log"] == "xy":
            ax.set_xscale("log")
            _ticks(ax, values)
        if panel["log"]:
            _logarithmic(ax, "y")
        elif panel["signed"]:
            ax.axhline(0.0, **ZERO)
        else:
            ax.set_ylim(0.0, None)
        ax.set(title=panel["title"], xlabel=panel["axis"])
    _legend(figure, grid[0, 0])
    return figure


def _legend(figure: Figure, ax: Axes) -> None:
    """One legend for all panels, above them."""
    handles, labels = ax.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        list(unique.values()), list(unique), loc="outside upper center", handlelength=2.2,
        ncols=min(len(unique), 5), columnspacing=1.8,
    )  # fmt: skip


def _logarithmic(ax: Axes, which: str) -> None:
    """Makes an axis logarithmic, with plain numbers at its ticks."""
    getattr(ax, f"set_{which}scale")("log")
    style.logarithmic_ticks(getattr(ax, f"{which}axis"), *getattr(ax, f"get_{which}lim")())


def _ticks(ax: Axes, ticks: Sequence[float]) -> None:
    """Plain numbers at these places of the x axis alone."""
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_xticks([], minor=True)


def _named_rows(ax: Axes, names: Sequence[str]) -> None:
    """A name instead of a number at each row of a panel."""
    ax.set_yticks(range(len(names)), names)
    ax.tick_params(axis="y", length=0)


def _median(
    ax: Axes, label: str, t: np.ndarray, values: np.ndarray, percentile: Any = np.percentile
) -> None:
    """The median of some arms over time, shape (T, k), and a band of 5 to 95 % of them."""
    low, middle, high = percentile(values, [5.0, 50.0, 95.0], axis=1)
    ax.plot(t, middle, color=look(label).color, label=title_of(label), linewidth=1.1)
    if values.shape[1] > 1:
        ax.fill_between(t, low, high, color=look(label).color, alpha=0.22, linewidth=0.0)


def _curve(ax: Axes, label: str, x: np.ndarray, medians: Sequence[Interval], markers: bool) -> None:
    """Medians over x with a band of their intervals, where finite."""
    numbers = np.array(medians, dtype=float)
    value, low, high = np.where(np.isfinite(numbers), numbers, np.nan).T
    color, line, mark = look(label)
    ax.plot(
        x, value, color=color, linestyle=line, marker=mark if markers else "",
        label=title_of(label), markeredgewidth=0.0,
    )  # fmt: skip
    if np.any(low < high):
        ax.fill_between(x, low, high, color=color, alpha=0.18, linewidth=0.0)


def _dot(
    ax: Axes, label: str, median: Interval, y: float, marker: str = "o", *, hollow: bool = False,
    lost: bool = False,
) -> None:  # fmt: skip
    """A median with its interval, sideways; hollow without the latter, where nothing is random.

    An infinite one is a cross at the edge where the lost are to be seen.
    """
    color = look(label).color
    if lost and not np.isfinite(median.value):
        ax.plot(0.96, y + 0.2 * hollow, "x", color=color, markersize=3 if hollow else 5,
                markeredgewidth=1.4, transform=ax.get_yaxis_transform())  # fmt: skip
    elif hollow:
        ax.plot(median.value, y, marker, color=color, fillstyle="none")
    elif np.isfinite(median.value):
        ax.plot([median.low, median.high], [y, y], color=color, linewidth=1.2)
        ax.plot(median.value, y, marker, color=color, markersize=5)
