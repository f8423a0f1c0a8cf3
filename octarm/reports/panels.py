"""What the figures of a report have in common: colours, panels, axes, scales."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure as NewFigure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from octarm.reports.episodes import Axis
from octarm.reports.findings import Report
from octarm.reports.measures import Measure

# Stand for Matplotlib's classes, whose methods leave the types of keyword arguments unknown.
Axes = Any
Figure = Any

# Told apart by the colour-blind too, and on dark ground as on white; after Okabe and Ito.
COLORS = (
    "#0a72b8", "#d55e00", "#00956c", "#c569a0", "#dd9500",
    "#3aa3dd", "#7d6bd0", "#8c8c8c", "#b0413e", "#7a8f1f",
)  # fmt: skip
MARKERS = "os^Dv<>PXp"
INK, LINE, GROUND = "#24292f", "#d4dae1", "#ffffff"  # what a page may replace by its own

_COLUMNS = 4  # of panels
LETTER = 0.085  # inches that one takes, about
LOGARITHMIC = 8.0  # largest over smallest median, from which on an axis is logarithmic
STYLE: dict[str, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.labelsize": 8.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "figure.facecolor": GROUND,
    "axes.facecolor": GROUND,
    "savefig.facecolor": GROUND,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "octarm",
    "text.parse_math": False,
}


class Scale(NamedTuple):
    """How a measure is shown: in thousandths of its unit when it is small."""

    factor: float
    unit: str


def scale_of(report: Report, measure: Measure) -> Scale:
    """The scale of a measure, the same in all figures and tables of a report."""
    values = report.episodes.values[:, report.episodes.measures.index(measure)]
    sizes = np.abs(values[np.isfinite(values)])
    prefixed = {"m": "mm", "rad": "mrad", "N": "mN", "N m": "mN m"}
    if measure.unit in prefixed and np.median(sizes) < 0.1:
        return Scale(1e3, prefixed[measure.unit])
    return Scale(1.0, "" if measure.unit == "1" else measure.unit)


def label_of(measure: Measure) -> str:
    """A measure's name in words: `rms error, theta1`."""
    subject = measure.name.removeprefix(measure.metric).lstrip("_")
    words = measure.metric.replace("_", " ")
    return f"{words}, {subject}" if subject else words


def panels_of(
    count: int, height: float, margin: float = 0.0, **options: Any
) -> tuple[Figure, list[Axes]]:
    """So many panels, in rows; heights and margin in inches."""
    columns = count if count <= _COLUMNS else -(-count // -(-count // _COLUMNS))
    rows = -(-count // columns)
    size = (max(5.5, 2.75 * columns) + margin, height * rows + 0.25)
    figure = NewFigure(figsize=size, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.06)  # pyright: ignore
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    for ax in grid.flat[count:]:
        ax.remove()
    return figure, list(grid.flat[:count])


def row_length(panels: list[Axes]) -> int:
    """Number of panels side by side."""
    return panels[0].get_subplotspec().get_gridspec().ncols


def name_axis(ax: Axes, axis: Axis, last: bool = True) -> None:
    """Ticks of the horizontal axis; its name if it is that of a last row."""
    apart = np.diff(axis.places)
    roomy = bool(np.all(12.0 * apart > np.sum(apart)))  # enough for a label at each value
    if not axis.scaled or (roomy and not axis.drawn):
        ax.set_xticks(axis.places, axis.labels)
    if not axis.scaled:
        ax.set_xlim(-0.5, len(axis.labels) - 0.5)
    if last:
        ax.set_xlabel(titled(axis))


def value_axis(ax: Axes, measure: Measure, scale: Scale) -> None:
    """Title, unit and scale of the vertical axis."""
    unit = f" [{scale.unit}]" if scale.unit else ""
    ax.set_title(label_of(measure) + unit)
    ends = [line.get_ydata() for line in ax.lines]
    values = np.concatenate([np.asarray(e, dtype=float) for e in ends])
    choose_scale(ax, "y", values, signed=measure.by_size)


def choose_scale(ax: Axes, which: str, values: np.ndarray, *, signed: bool) -> None:
    """Logarithmic when values, of any shape, are positive and very different; else from zero on."""
    known = values[np.isfinite(values)]
    direction = getattr(ax, f"{which}axis")
    if not known.size:
        direction.set_major_locator(NullLocator())
        return
    if not signed and known.min() > 0.0 and known.max() > LOGARITHMIC * known.min():
        getattr(ax, f"set_{which}scale")("log")
        logarithmic_ticks(direction, float(known.min()), float(known.max()))
    elif not signed and 0.0 <= known.min() < 0.5 * known.max():
        getattr(ax, f"set_{which}lim")(0.0, None)
    elif known.min() == known.max() == 0.0:
        getattr(ax, f"set_{which}lim")(-0.05, 1.0)


def logarithmic_ticks(direction: XAxis | YAxis, low: float, high: float) -> None:
    """Ticks without powers: at 1, 2 and 5 when there are few decades."""
    few = high <= 100.0 * low
    direction.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))

    def told(value: float, _: int | None = None) -> str:
        return f"{value:g}"

    direction.set_major_formatter(FuncFormatter(told))
    direction.set_minor_locator(NullLocator())


def add_legend(figure: Figure, ax: Axes) -> None:
    """The legend of a panel, above all of them; makes room for it."""
    handles, labels = ax.get_legend_handles_labels()
    room = int(figure.get_figwidth() / (0.7 + LETTER * max(map(len, labels))))
    columns = min(max(1, room), len(labels), 5)
    figure.set_figheight(figure.get_figheight() + 0.2 * -(-len(labels) // columns))
    figure.legend(
        handles, labels, loc="outside upper left", ncols=columns, handlelength=1.8,
        columnspacing=1.6, borderaxespad=0.1,
    )  # fmt: skip


def titled(axis: Axis) -> str:
    """An axis's name with its unit."""
    return axis.name + (f" [{axis.unit}]" if axis.unit else "")
