"""The figures: 1 and 2 of the paper on this arm, those of the studies, and the README's."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.palette import look_of
from octarm.reports import figures as style
from octarm.reports.figures import INK, Axes, Figure, Picture
from paper.claims import percent, worded, words
from paper.evidence import Evidence
from paper.runs import LONG, name_of
from paper.studies import BENDS, COORDINATES, MEAN, MODELS, MOVING, NOISE, READINGS, SLIDES, Cell
from paper.variants import CONTROLLERS, INSTEAD, PROPOSED, SMC, by_hand

GRAY = "#5f6b77"
DOTTED = {"color": GRAY, "linewidth": 0.9, "linestyle": ":"}
ZERO = {"color": INK, "linewidth": 0.6, "zorder": 1}
Mark = tuple[str, Mapping[str, float], str, str]  # of a row: what it is, fields of a cell, its look
NOISY = (("40 % noise", {"noise": NOISE}, "o", "full"), ("no noise", {"noise": 0.0}, "o", "none"))


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
        for reference, (key, noise) in product(
            effort.readings, (("figure-1", 0.0), ("figure-2", NOISE))
        ):
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
        for (ax, model), label in product(zip(panels, MODELS, strict=True), labels):
            series = evidence.series[name_of(label, reference)]
            desired, drawn = series.q_d[:, [place]], series.of(model, noise)[:, :, place]
            if of_error:
                drawn = 1e3 * (drawn - desired)
                ax.axhline(0.0, **ZERO)
                if label in (SMC, PROPOSED):
                    late = np.nanpercentile(np.abs(drawn[series.t > 0.5]), 99.9)
                    largest = max(largest, most * float(late))
            elif label == labels[0]:
                ax.plot(series.t, desired, color=INK, linewidth=3.2, alpha=0.25, label="desired")
            _median(ax, label, series.t, drawn)
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
    order = evidence.ranked(start.of(evidence.effort.plant_labels))
    places = [
        (f"{plant} modules, {1e3 / rate:g} ms", start._replace(plant=plant, rate=rate))
        for rate, plant in product(rates, modules)
    ]
    return _dots(evidence, [cell.label for cell in order], places, len(rates), 2.3, NOISY)


def _ranking(evidence: Evidence) -> Figure:
    """Errors of all controllers, a panel a nominal model."""
    order = evidence.ranked(Cell("", mismatch=MEAN, noise=NOISE).of(CONTROLLERS))
    places = [(f"nominal model {percent(x)}", Cell("", mismatch=x)) for x in MODELS]
    return _dots(evidence, [cell.label for cell in order], places, 1, 3.1, NOISY)


def _ablations(evidence: Evidence) -> Figure:
    """Errors under noise over those of `afsmc`, a panel for each reading of the joints."""
    labels = [cell.label for cell in evidence.known(Cell("", noise=NOISE).of(INSTEAD))]
    places = [(", ".join(MOVING[x]), Cell("", reference=x, noise=NOISE)) for x in MOVING]
    known = [place for place in places if evidence.known(place[1].of(labels))]
    models = zip(MODELS, "os^", strict=True)
    marks = [(f"nominal model {percent(x)}", {"mismatch": x}, y, "full") for x, y in models]
    return _dots(evidence, labels, known, 1, 4.6, marks, PROPOSED)


def _dots(
    evidence: Evidence, labels: Sequence[str], places: Sequence[tuple[str, Cell]], rows: int,
    width: float, marks: Sequence[Mark], over: str = "",
) -> Figure:  # fmt: skip
    """Errors sideways with their intervals: a panel a place, with a row for each variant.

    They may be those over another variant. A cross at the edge is an infinite one.
    """
    size = width, (0.1 * len(marks) + 0.05) * len(labels) + 0.5
    figure, grid = _panels(rows, len(places) // rows, *size, sharex=True, sharey=True)
    shifts, drawn = np.linspace(-0.2, 0.2, len(marks)), list[float]()
    for ax, (title, place) in zip(grid.flat, places, strict=True):
        points = product(enumerate(labels), zip(marks, shifts, strict=True))
        for (row, label), ((_, fields, marker, fill), shift) in points:
            cell, y = place._replace(label=label, **fields), row + shift
            color = look(label)["color"]
            if not evidence.has(cell):
                continue
            value, low, high = evidence.ratio(cell, over) if over else evidence.median(cell)
            if np.isfinite(value):
                drawn.append(value)
                ax.plot([low, high], [y, y], color=color, linewidth=1.2 * (low < high))
                ax.plot(value, y, marker, color=color, fillstyle=fill)
            else:
                ax.plot(0.97, y, "x", color=color, transform=ax.get_yaxis_transform())
        if over:
            ax.axvline(1.0, **DOTTED)
        ax.set_title(title)
        ax.margins(x=0.1)  # room for the crosses
        ax.set_yticks(range(len(labels)), [title_of(label) for label in labels])
        ax.tick_params(axis="y", length=0)
    first = grid[0, 0]
    first.invert_yaxis()
    style.choose_scale(first, "x", np.array(drawn), signed=False)
    style.name_axes(
        list(grid.flat), f"error {f'over that of {over}' if over else '[% of the motion]'}"
    )
    for name, _, marker, fill in marks:
        first.plot([], [], marker, color=GRAY, fillstyle=fill, label=name)
    style.add_legend(figure, first)
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
    gain.set_yscale("log")
    style.logarithmic_ticks(gain.yaxis, *gain.get_ylim())
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
        x, drawn = panel["unit"] * np.array(values), list[np.ndarray]()
        for label in panel["labels"]:
            cells = [start._replace(**{"label": label, field: value}) for value in values]
            if evidence.has(*cells):
                medians = np.array([evidence.median(cell, panel["of"]) for cell in cells])
                finite = np.where(np.isfinite(medians), medians, np.nan).T
                line = look(label) if panel["markers"] else {**look(label), "marker": ""}
                _band(ax, label, x, finite, 0.18, markeredgewidth=0.0, **line)
                drawn.append(finite[0])
        for axis, value in panel["paper"].items():
            {"x": ax.axvline, "y": ax.axhline}[axis](value, **DOTTED)
        style.choose_scale(ax, "x", x, signed=False)
        style.choose_scale(ax, "y", np.array(drawn), signed=panel["signed"])
        ax.set(title=panel["title"], xlabel=panel["axis"])
    style.add_legend(figure, grid[0, 0])
    return figure


def _median(
    ax: Axes, label: str, t: np.ndarray, values: np.ndarray, percentile: Any = np.percentile
) -> None:
    """The median of some arms over time, shape (T, k), and a band of 5 to 95 % of them."""
    low, middle, high = percentile(values, [5.0, 50.0, 95.0], axis=1)
    line = {**look(label), "marker": "", "linewidth": 1.1}
    _band(ax, label, t, (middle, low, high), 0.22, **line)


def _band(ax: Axes, label: str, x: np.ndarray, of: Any, alpha: float, **line: Any) -> None:
    """Values, and the band between their ends, which are behind them."""
    value, low, high = of
    ax.plot(x, value, label=title_of(label), **line)
    if np.any(low < high):
        ax.fill_between(x, low, high, color=line["color"], alpha=alpha, linewidth=0.0)
