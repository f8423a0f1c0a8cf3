"""The figures: 1 and 2 of the paper on this arm, those of the studies, and the README's."""

import warnings
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.palette import look_of
from octarm.reports import figures as style
from octarm.reports.figures import INK, Axes, Figure, Picture
from octarm.reports.statistics import Interval
from paper.claims import percent, worded, words
from paper.evidence import Evidence
from paper.runs import LONG, name_of
from paper.studies import BENDS, COORDINATES, MODELS, MODULES, MOVING, NOISE, READINGS, SLIDES, Cell
from paper.variants import CONTROLLERS, INSTEAD, PROPOSED, SMC, by_hand

GRAY = "#5f6b77"
DOTTED = {"color": GRAY, "linewidth": 0.9, "linestyle": ":"}
ZERO = {"color": INK, "linewidth": 0.6, "zorder": 1}
NOISES = {"figure-1": 0.0, "figure-2": NOISE}  # of the paper's figures


def look(label: str) -> dict[str, Any]:
    """How a variant is drawn in all figures; hand-set gains have a dashed line."""
    if label in words()["looks"]:
        return words()["looks"][label]
    name = label.removesuffix(by_hand(""))
    color, marker = look_of(name)
    return {"color": color, "linestyle": "-" if name == label else (0, (4, 1.5)), "marker": marker}


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
    """Motion and error of both joints over time."""
    unit = {BENDS: "rad", SLIDES: "m"}[reference]
    kinds = (("{} [{}]", False), ("error [m{1}]", True))
    rows = [
        (reference, joint, noise, name.format(joint, unit), of_error)
        for joint, (name, of_error) in product(MOVING[reference], kinds)
    ]
    figure = _over_time(evidence, evidence.effort.labels, rows, 3.1, 1.45, most=1.5)
    figure.align_ylabels()
    return figure


def _readme(evidence: Evidence) -> Figure:
    """Errors of theta1 over time without and with noise."""
    rows = [
        (BENDS, "theta1", noise, f"error of theta1 [mrad]\n{name}", True)
        for noise, name in ((0.0, "no noise"), (NOISE, "40 % noise"))
    ]
    return _over_time(evidence, (SMC, PROPOSED), rows, 3.3, 1.75)


def _over_time(
    evidence: Evidence, labels: Sequence[str], rows: Sequence[tuple[str, str, float, str, bool]],
    width: float, height: float, most: float = 0.0,
) -> Figure:  # fmt: skip
    """Joints over time, a column a nominal model, in panels of this size [inch].

    A row has a reference, a joint, the noise, a title, and whether errors are drawn [mrad], [mm].
    Its axis ends at the largest errors of the paper's two controllers, times `most` if not 0.
    """
    figure, grid = _panels(len(rows), len(MODELS), width, height, sharex=True, sharey="row")
    for panels, (reference, joint, noise, title, of_error) in zip(grid, rows, strict=True):
        place, largest = COORDINATES.index(joint), 0.0
        for ax, model in zip(panels, MODELS, strict=True):
            for label in labels:
                series = evidence.series[name_of(label, reference)]
                desired, drawn = series.q_d[:, place], series.of(model, noise)[:, :, place]
                if of_error:
                    drawn = 1e3 * (drawn - desired[:, None])
                elif label == labels[0]:
                    ax.plot(
                        series.t, desired, color=INK, linewidth=3.2, alpha=0.25, label="desired"
                    )
                _median(ax, label, series.t, drawn)
                if of_error and label in (SMC, PROPOSED):
                    late = np.abs(drawn[series.t > 0.5])
                    largest = max(largest, most * float(np.nanpercentile(late, 99.9)))
            if of_error:
                ax.axhline(0.0, **ZERO)
        if largest:
            panels[0].set_ylim(-largest, largest)
        panels[0].set_ylabel(title)
    duration = evidence.effort.duration
    for column, model in zip(grid.T, MODELS, strict=True):
        column[0].set_title(f"nominal model {percent(model)}")
        column[-1].set(xlabel="time [s]", xlim=(0.0, duration), xticks=np.arange(duration))
    style.add_legend(figure, grid[0, 0])
    return figure


def _plants(evidence: Evidence) -> Figure:
    """Errors of all laws: a column a plant, a row a control period."""
    rates, modules = evidence.effort.plant_rates, evidence.effort.plants
    start = Cell("", "plants", noise=NOISE, plant=modules[0], rate=rates[0])
    cells = start.of(evidence.effort.plant_labels)
    order = sorted(cells, key=lambda cell: evidence.median(cell).value)
    height = 0.21 * len(order) + 0.55
    figure, grid = _panels(len(rates), len(modules), 2.3, height, sharex=True, sharey=True)
    for ax, (rate, plant) in zip(grid.flat, product(rates, modules), strict=True):
        _dots(ax, evidence, [cell._replace(plant=plant, rate=rate) for cell in order], lost=True)
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
    style.add_legend(figure, first)
    return figure


def _ranking(evidence: Evidence) -> Figure:
    """Errors of all controllers, a panel a nominal model."""
    order = evidence.ranked(Cell("", noise=NOISE).of(CONTROLLERS))
    figure, grid = _panels(1, len(MODELS), 3.1, 0.25 * len(order) + 0.6, sharey=True, sharex=True)
    for ax, model in zip(grid[0], MODELS, strict=True):
        _dots(ax, evidence, [cell._replace(mismatch=model) for cell in order])
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
    style.add_legend(figure, grid[0, 0])
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
        left.plot(series.t, 100.0 * np.mean(~np.isnan(E), axis=1), color=look(label)["color"])
    _logarithmic(gain, "y")
    gain.set(title="gain E of theta1 [N m]", xlabel="time [s]")
    left.set(title="arms within their limits [%]", xlabel="time [s]", ylim=(-3.0, 103.0))
    style.add_legend(figure, gain)
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
                medians = np.array([evidence.median(cell, panel["of"]) for cell in cells])
                finite = np.where(np.isfinite(medians), medians, np.nan).T
                line = look(label) if panel["markers"] else {**look(label), "marker": ""}
                _band(ax, label, x, finite, 0.18, markeredgewidth=0.0, **line)
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
    style.add_legend(figure, grid[0, 0])
    return figure


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
    _band(ax, label, t, (middle, low, high), 0.22, color=look(label)["color"], linewidth=1.1)


def _band(ax: Axes, label: str, x: np.ndarray, of: Any, alpha: float, **line: Any) -> None:
    """Values, and the band between their ends, which are behind them."""
    value, low, high = of
    ax.plot(x, value, label=title_of(label), **line)
    if np.any(low < high):
        ax.fill_between(x, low, high, color=line["color"], alpha=alpha, linewidth=0.0)


def _dots(ax: Axes, evidence: Evidence, cells: Sequence[Cell], *, lost: bool = False) -> None:
    """Errors of cells in rows: with noise full, and without it hollow, as nothing is random then.

    Infinite ones are crosses at the edge where the lost are to be seen.
    """
    for (row, cell), noise in product(enumerate(cells), (NOISE, 0.0)):
        error, hollow = evidence.median(cell._replace(noise=noise)), not noise
        color = look(cell.label)["color"]
        if lost and not np.isfinite(error.value):
            ax.plot(0.96, row + 0.2 * hollow, "x", color=color, markersize=3 if hollow else 5,
                    markeredgewidth=1.4, transform=ax.get_yaxis_transform())  # fmt: skip
        elif hollow:
            ax.plot(error.value, row, "o", color=color, fillstyle="none")
        else:
            _dot(ax, cell.label, error, row)


def _dot(ax: Axes, label: str, median: Interval, y: float, marker: str = "o") -> None:
    """A median with its interval, sideways; none where it is infinite."""
    if np.isfinite(median.value):
        color = look(label)["color"]
        ax.plot([median.low, median.high], [y, y], color=color, linewidth=1.2)
        ax.plot(median.value, y, marker, color=color, markersize=5)
