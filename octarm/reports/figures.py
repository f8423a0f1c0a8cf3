"""The figures of a sweep's report: degradation, distributions, heat maps, failures."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm, Normalize, to_rgb

from octarm.reports.episodes import Axis
from octarm.reports.findings import Cells, Entry, Report
from octarm.reports.panels import (
    COLORS,
    GROUND,
    INK,
    LETTER,
    LINE,
    LOGARITHMIC,
    MARKERS,
    STYLE,
    Axes,
    Figure,
    add_legend,
    choose_scale,
    label_of,
    logarithmic_ticks,
    name_axis,
    panels_of,
    row_length,
    scale_of,
    titled,
    value_axis,
)

_MOST_MAPS = 6
_BOXES = (
    "All episodes of each controller: the box holds the middle half, the line in it is the median, "
    "whiskers reach to the 5th and the 95th percentile, points are the extremes."
)
_FAILURES = "Share of episodes that diverged, with its 95 % interval (Wilson)."


class Picture(NamedTuple):
    """A figure in both formats.

    Attributes:
        name: of the file, without its ending.
        caption: what it shows.
        svg: text.
        png: bytes.
    """

    name: str
    caption: str
    svg: str
    png: bytes


def pictures(report: Report) -> Iterator[Picture]:
    """All figures of a report."""
    own = {k: v for k, v in matplotlib.rcParamsDefault.items() if not k.startswith("backend")}
    with cast(Any, matplotlib).rc_context({**own, **STYLE}):
        diverged = bool(report.episodes.diverged.any())
        for axis in report.episodes.axes:
            caption = f"Median over all episodes at each {axis.name}, with its 95 % interval."
            if diverged:
                caption += " A curve ends where half of the episodes diverge."
            yield _saved(f"degradation-{axis.name}", caption, _degradation(report, axis))
        more = " Episodes that diverged lie beyond the end of the axis." if diverged else ""
        yield _saved("distributions", _BOXES + more, _boxes(report))
        for cells in report.cells[:_MOST_MAPS]:
            name = f"map-{cells.first.name}-{cells.second.name}"
            measure = report.episodes.measures[0]
            where = f"{cells.first.name} and {cells.second.name}"
            caption = (
                f"Median {label_of(measure)} [{scale_of(report, measure).unit}] over {where}; "
                "∞ where half of the episodes diverge."
            )
            yield _saved(name, caption, _map(report, cells))
        if diverged:
            yield _saved("failures", _FAILURES, _failures(report))


def _saved(name: str, caption: str, figure: Figure) -> Picture:
    """Both formats, without anything that differs from run to run."""
    name = re.sub(r"[^\w.-]", "_", name)
    vector, raster = io.BytesIO(), io.BytesIO()
    figure.savefig(vector, format="svg", metadata={"Date": None, "Creator": None})
    figure.set_layout_engine("none")  # what was found for the first holds for the second
    figure.savefig(raster, format="png", dpi=200, metadata={"Software": None})
    return Picture(name, caption, vector.getvalue().decode(), raster.getvalue())


def _degradation(report: Report, axis: Axis) -> Figure:
    """A panel a measure, a line a controller."""
    measures = report.episodes.measures
    figure, panels = panels_of(len(measures), 2.15)
    for j, (measure, ax) in enumerate(zip(measures, panels, strict=True)):
        scale = scale_of(report, measure)
        for c, name in enumerate(report.episodes.controllers):
            found = [e.medians for e in report.of(axis) if e.controller == name]
            triples = np.array([[m.value[j], m.low[j], m.high[j]] for m in found]).T
            shift = 0.0 if axis.scaled else _shift(c, len(report.episodes.controllers))
            _curve(ax, axis, c, name, triples * scale.factor, shift)
        name_axis(ax, axis, last=j >= len(measures) - row_length(panels))
        value_axis(ax, measure, scale)
    add_legend(figure, panels[0])
    return figure


def _shift(c: int, count: int) -> float:
    """Where a controller stands beside the others, of whom two values are 1 apart."""
    return 0.7 * ((c + 0.5) / count - 0.5)


def _curve(ax: Axes, axis: Axis, c: int, name: str, triples: np.ndarray, shift: float) -> None:
    """Medians with a band of intervals; with bars where the axis has no scale."""
    value, low, high = np.where(np.isfinite(triples), triples, np.nan)
    reach = np.isinf(triples[2]) & np.isfinite(value)
    color, marker = COLORS[c % len(COLORS)], MARKERS[c % len(MARKERS)]
    x = axis.places + shift
    ax.plot(
        x, value, color=color, marker=marker, label=name, linestyle="-" if axis.scaled else "none",
        markeredgewidth=0.0,
    )  # fmt: skip
    if axis.scaled:
        ax.fill_between(x, low, high, color=color, alpha=0.18, linewidth=0.0)
    else:
        ax.vlines(x, low, high, color=color, linewidth=1.2)
    if reach.any():  # the interval goes on without end
        ax.plot(x[reach], value[reach], "^", color=color, markersize=9, fillstyle="none")


def _boxes(report: Report) -> Figure:
    """A panel a measure, a box a controller."""
    episodes = report.episodes
    n, labels = len(episodes.controllers), [_with_failures(entry) for entry in report.of(None)]
    margin = max(0.0, LETTER * max(map(len, labels)) - 1.0)
    figure, panels = panels_of(len(episodes.measures), 0.28 * n + 0.75, margin, sharey=True)
    for j, (measure, ax) in enumerate(zip(episodes.measures, panels, strict=True)):
        scale = scale_of(report, measure)
        columns = [scale.factor * episodes.values[episodes.controller == c, j] for c in range(n)]
        columns = [column[~np.isnan(column)] for column in columns]
        together = np.concatenate(columns)
        choose_scale(ax, "x", together, signed=measure.by_size)
        ends = _ends(ax, together)
        for c, column in enumerate(columns):
            if column.size:
                _box(ax, c, column, ends)
        ax.set_xlim(*ends)
        ax.set_yticks(range(n), labels)
        ax.set_ylim(n - 0.4, -0.6)
        ax.grid(False, axis="y")
        ax.tick_params(axis="y", length=0)
        ax.set_title(label_of(measure) + (f" [{scale.unit}]" if scale.unit else ""))
    return figure


def _with_failures(entry: Entry) -> str:
    return f"{entry.controller}, {entry.failed} diverged" if entry.failed else entry.controller


def _ends(ax: Axes, values: np.ndarray) -> tuple[float, float]:
    """The ends of an axis on which all values lie that are finite."""
    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    if ax.get_xscale() == "log":
        margin = (high / low) ** 0.06
        return low / margin, high * margin
    if low == high == 0.0:
        return -0.05, 1.0
    margin = 0.06 * (high - low or abs(high))
    return (0.0 if 0.0 <= low < 0.5 * high else low - margin), high + margin


def _box(ax: Axes, c: int, column: np.ndarray, ends: tuple[float, float]) -> None:
    """The box of a column; what is infinite lies at the end of the axis."""
    column = np.sort(np.clip(column, *ends))
    low, q1, middle, q3, high = np.percentile(column, [5.0, 25.0, 50.0, 75.0, 95.0])
    color = COLORS[c % len(COLORS)]
    ax.plot([low, high], [c, c], color=color, linewidth=1.2, solid_capstyle="butt")
    ax.barh(c, q3 - q1, left=q1, height=0.56, color=_tint(color), edgecolor=color, linewidth=1.2)
    middles = [c - 0.28, c + 0.28]
    ax.plot([middle, middle], middles, color=color, linewidth=2.4, clip_on=False)
    inside = [x for x in (column[0], column[-1]) if ends[0] < x < ends[1]]
    ax.plot(inside, [c] * len(inside), ".", color=color, markersize=3.5)


def _tint(color: str) -> tuple[float, ...]:
    return (*to_rgb(color), 0.25)


def _map(report: Report, cells: Cells) -> Figure:
    """A panel a controller; colours by the median of the first measure."""
    measure, names = report.episodes.measures[0], report.episodes.controllers
    scale = scale_of(report, measure)
    values = scale.factor * cells.medians[:, 0]
    rows, columns = len(cells.first.labels), len(cells.second.labels)
    figure, panels = panels_of(len(names), max(1.5, 0.34 * rows + 0.75), sharey=True, sharex=True)
    turned = 30.0 if max(map(len, cells.second.labels)) > 10 else 0.0
    norm = _norm(values)
    image = None
    for ax, name, own in zip(panels, names, values, strict=True):
        ax.set_facecolor(LINE)
        shown = np.ma.masked_invalid(own)
        image = ax.pcolormesh(shown, cmap="cividis", norm=norm, edgecolors=GROUND, linewidth=1.0)
        for (i, k), value in np.ndenumerate(own):
            if rows * columns <= 64 and not np.isnan(value):
                told = "∞" if np.isinf(value) else f"{value:.3g}"
                ink = INK if np.isinf(value) else "#fefefe" if norm(value) < 0.55 else "#101010"
                ax.text(k + 0.5, i + 0.5, told, ha="center", va="center", color=ink, fontsize=7.5)
        ax.set_title(name)
        ax.grid(False)
        ax.spines[:].set_visible(False)
        ax.tick_params(length=0)
        ax.set_xticks(np.arange(columns) + 0.5, cells.second.labels, rotation=turned)
        ax.set_yticks(np.arange(rows) + 0.5, cells.first.labels)
    for ax in panels:
        ax.label_outer()
    length = row_length(panels)
    for ax in panels[-length:]:
        ax.tick_params(labelbottom=True)
        ax.set_xlabel(titled(cells.second))
    for ax in panels[::length]:
        ax.set_ylabel(titled(cells.first))
    if image is not None:
        label = label_of(measure) + (f" [{scale.unit}]" if scale.unit else "")
        bar = figure.colorbar(image, ax=panels, label=label, pad=0.01, aspect=18)
        if isinstance(norm, LogNorm):
            logarithmic_ticks(bar.ax.yaxis, float(norm.vmin or 1.0), float(norm.vmax or 1.0))
        bar.outline.set_visible(False)
    return figure


def _norm(values: np.ndarray) -> Normalize:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if low > 0.0 and high > LOGARITHMIC * low:
        return LogNorm(low, high)
    return Normalize(low, high if high > low else low + 1.0)


def _failures(report: Report) -> Figure:
    """A panel an axis, or one for the whole sweep."""
    axes, names = report.episodes.axes, report.episodes.controllers
    figure, panels = panels_of(max(1, len(axes)), 2.3, sharey=True)
    for axis, ax in zip(axes or (None,), panels, strict=True):
        places = np.zeros(1) if axis is None else axis.places
        step = 1.0 if len(places) < 2 else float(np.min(np.diff(places)))
        step *= 0.6 * min(1.0, len(names) / 6.0)
        for c, name in enumerate(names):
            own = [entry for entry in report.of(axis) if entry.controller == name]
            value, low, high = 100.0 * np.array([entry.failures for entry in own]).T
            x = places + step * _shift(c, len(names))
            color, marker = COLORS[c % len(COLORS)], MARKERS[c % len(MARKERS)]
            ax.vlines(x, low, high, color=color, linewidth=1.0, alpha=0.7)
            if axis is not None and axis.scaled:
                ax.plot(x, value, color=color, linewidth=0.8, alpha=0.5)
            ax.plot(x, value, marker, color=color, label=name, markersize=4.0)
        if axis is None:
            ax.set_xticks([])
        else:
            name_axis(ax, axis)
    worst = max(100.0 * entry.failures.high for entry in report.entries if entry.episodes)
    panels[0].set_ylim(-0.03 * worst, 1.03 * worst)
    panels[0].set_title("diverged [%]")
    add_legend(figure, panels[0])
    return figure
