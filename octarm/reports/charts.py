"""The charts of a sweep's report: degradation, distributions, heat maps, failures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from matplotlib.colors import LogNorm, Normalize, to_rgb

from octarm.palette import look_of
from octarm.reports import figures
from octarm.reports.comparisons import Cells, Comparisons
from octarm.reports.factors import Factor
from octarm.reports.figures import Axes, Figure, Picture
from octarm.reports.frame import Episodes
from octarm.reports.statistics import FEWEST

_MOST_MAPS = 6
_BOXES = (
    "the box holds the middle half, the line in it is the median, whiskers reach to the 5th and "
    "the 95th percentile, points are the extremes."
)


class Scale(NamedTuple):
    """How a measure is displayed: in thousandths of its unit when its values are small.

    Attributes:
        factor: by which its values are multiplied.
        unit: with its prefix; empty for a share.
        title: the name of the measure with this unit.
    """

    factor: float
    unit: str
    title: str


def scales_of(episodes: Episodes) -> list[Scale]:
    """The scales of the measures, the same in all charts and tables of a report."""
    scales: list[Scale] = []
    for measure, values in zip(episodes.measures, episodes.values.T, strict=True):
        sizes = np.abs(values[np.isfinite(values)])
        factor, unit = 1.0, "" if measure.unit == "1" else measure.unit
        if measure.unit in ("m", "rad", "N", "N m") and np.median(sizes) < 0.1:
            factor, unit = 1e3, f"m{unit}"
        words = measure.metric.replace("_", " ") + (f", {measure.of}" if measure.of else "")
        scales.append(Scale(factor, unit, words + (f" [{unit}]" if unit else "")))
    return scales


def pictures(comparisons: Comparisons) -> Iterator[Picture]:
    """All charts of a report."""
    episodes = comparisons.episodes
    diverged = bool(episodes.diverged.any())
    unfinished = len(episodes.seed) < episodes.planned
    which = "all finished episodes" if unfinished else "all episodes"
    with figures.figure_style():
        for factor in episodes.factors:
            caption = f"Median over {which} at each {factor.name}, with its 95 % interval."
            if any(np.any(group.seeds < FEWEST) for group in comparisons.groups):
                caption += f" It is a range where fewer than {FEWEST} seeds have a value."
            if diverged:
                caption += " A curve ends where half of the episodes diverge."
            if unfinished:
                caption += " It has a gap where no episode is finished."
            name = f"degradation-{factor.name}"
            yield figures.save_figure(name, caption, _degradation(comparisons, factor))
        more = " Episodes that diverged lie beyond the end of the axis." if diverged else ""
        caption = f"{which.capitalize()} of each controller: {_BOXES}{more}"
        yield figures.save_figure("distributions", caption, _boxes(comparisons))
        for cells in comparisons.cells[:_MOST_MAPS]:
            title = scales_of(episodes)[0].title
            caption = (
                f"Median {title} over {cells.first.name} and {cells.second.name}; "
                "∞ where half of the episodes diverge."
            )
            if np.isnan(cells.medians[:, 0]).any():
                caption += f" Empty where no {episodes.with_values} has a value."
            name = f"map-{cells.first.name}-{cells.second.name}"
            yield figures.save_figure(name, caption, _map(comparisons, cells))
        if diverged:
            caption = "Share of episodes that diverged, with its 95 % interval."
            yield figures.save_figure("failures", caption, _failures(comparisons))


def _degradation(comparisons: Comparisons, factor: Factor) -> Figure:
    episodes = comparisons.episodes
    measures, names = episodes.measures, episodes.controllers
    figure, panels = figures.panels_of(len(measures), 2.15)
    for j, scale in enumerate(scales_of(episodes)):
        measure, ax = measures[j], panels[j]
        for c, name in enumerate(names):
            medians = [g.medians for g in comparisons.of(factor) if g.controller == name]
            triples = np.array([[end[j] for end in median] for median in medians]).T
            shift = 0.0 if factor.scaled else _shift(c, len(names))
            _curve(ax, factor, name, triples * scale.factor, shift)
        _name_axis(ax, factor, last=j >= len(measures) - figures.row_length(panels))
        ax.set_title(scale.title)
        values = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in ax.lines])
        figures.choose_scale(ax, "y", values, signed=measure.declared.zero_best)
        figures.mark_scale(ax, "y")
    figures.add_legend(figure, panels[0])
    return figure


def _name_axis(ax: Axes, factor: Factor, last: bool = True) -> None:
    """Ticks of the horizontal axis; its name if it is that of a last row."""
    apart = np.diff(factor.places)
    roomy = bool(np.all(12.0 * apart > np.sum(apart)))  # enough for a label at each value
    if not factor.scaled or (roomy and not factor.drawn):
        ax.set_xticks(factor.places, factor.labels)
    if not factor.scaled:
        ax.set_xlim(-0.5, len(factor.labels) - 0.5)
    if last:
        ax.set_xlabel(factor.title)


def _shift(c: int, count: int) -> float:
    """The place of a controller in the row of all at one level, of a width below 1."""
    return 0.7 * ((c + 0.5) / count - 0.5)


def _curve(ax: Axes, factor: Factor, name: str, triples: np.ndarray, shift: float) -> None:
    """Medians with a band of intervals; with bars where the axis has no scale."""
    value, low, high = np.where(np.isfinite(triples), triples, np.nan)
    reach = np.isinf(triples[2]) & np.isfinite(value)
    color, marker = look_of(name)
    x, line = factor.places + shift, "-" if factor.scaled else "none"
    ax.plot(x, value, color=color, marker=marker, label=name, linestyle=line, markeredgewidth=0.0)
    if factor.scaled:
        ax.fill_between(x, low, high, color=color, alpha=0.18, linewidth=0.0)
    else:
        ax.vlines(x, low, high, color=color, linewidth=1.2)
    if reach.any():  # the interval goes on without end
        ax.plot(x[reach], value[reach], "^", color=color, markersize=9, fillstyle="none")


def _boxes(comparisons: Comparisons) -> Figure:
    episodes = comparisons.episodes
    n = len(episodes.controllers)
    labels: list[str] = []
    for group in comparisons.of(None):
        diverged = f", {group.failed} diverged" if group.failed else ""
        labels.append(group.controller + (diverged if group.episodes else ", none finished"))
    margin = max(0.0, figures.LETTER * max(map(len, labels)) - 1.0)
    figure, panels = figures.panels_of(len(episodes.measures), 0.28 * n + 0.75, margin, sharey=True)
    for j, scale in enumerate(scales_of(episodes)):
        measure, ax = episodes.measures[j], panels[j]
        columns = [scale.factor * episodes.values[episodes.controller == c, j] for c in range(n)]
        columns = [column[~np.isnan(column)] for column in columns]
        together = np.concatenate(columns)
        figures.choose_scale(ax, "x", together, signed=measure.declared.zero_best)
        ends = _ends(ax, together)
        for c, column in enumerate(columns):
            if column.size:
                _box(ax, c, look_of(episodes.controllers[c]).color, column, ends)
        ax.set_xlim(*ends)
        ax.set_yticks(range(n), labels)
        ax.set_ylim(n - 0.4, -0.6)
        ax.grid(False, axis="y")
        ax.tick_params(axis="y", length=0)
        ax.set_title(scale.title)
        figures.mark_scale(ax, "x")
    return figure


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


def _box(ax: Axes, c: int, color: str, column: np.ndarray, ends: tuple[float, float]) -> None:
    """The box of a column; what is infinite lies at the end of the axis."""
    column = np.sort(np.clip(column, *ends))
    low, q1, middle, q3, high = np.percentile(column, [5.0, 25.0, 50.0, 75.0, 95.0])
    ax.plot([low, high], [c, c], color=color, linewidth=1.2, solid_capstyle="butt")
    fill = {"color": (*to_rgb(color), 0.25), "edgecolor": color, "linewidth": 1.2}
    ax.barh(c, q3 - q1, left=q1, height=0.56, **fill)
    ax.plot([middle] * 2, [c - 0.28, c + 0.28], color=color, linewidth=2.4, clip_on=False)
    inside = [x for x in (column[0], column[-1]) if ends[0] < x < ends[1]]
    ax.plot(inside, [c] * len(inside), ".", color=color, markersize=3.5)


def _map(comparisons: Comparisons, cells: Cells) -> Figure:
    """A panel for each controller; colours by the median of the first measure."""
    episodes, first, second = comparisons.episodes, cells.first, cells.second
    names, scale = episodes.controllers, scales_of(episodes)[0]
    values = scale.factor * cells.medians[:, 0]
    rows, columns = len(first.labels), len(second.labels)
    figure, panels = figures.panels_of(
        len(names), max(1.5, 0.34 * rows + 0.75), sharey=True, sharex=True
    )
    turned = 30.0 if max(map(len, second.labels)) > 10 else 0.0
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    wide = low > 0.0 and high > figures.LOGARITHMIC * low
    norm = LogNorm(low, high) if wide else Normalize(low, high if high > low else low + 1.0)
    for ax, name, medians in zip(panels, names, values, strict=True):
        ax.set_facecolor(figures.LINE)
        look = {"cmap": "cividis", "edgecolors": figures.GROUND, "linewidth": 1.0}
        ax.pcolormesh(np.ma.masked_invalid(medians), norm=norm, **look)
        for (i, k), value in np.ndenumerate(medians):
            if rows * columns <= 64 and not np.isnan(value):
                text = "∞" if np.isinf(value) else f"{value:.3g}"
                ink = "#fefefe" if norm(value) < 0.55 else "#101010"  # on dark, on bright ground
                ink = figures.INK if np.isinf(value) else ink
                ax.text(k + 0.5, i + 0.5, text, ha="center", va="center", color=ink, fontsize=7.5)
        ax.set_title(name)
        ax.grid(False)
        ax.spines[:].set_visible(False)
        ax.tick_params(length=0)
        ax.set_xticks(np.arange(columns) + 0.5, second.labels, rotation=turned)
        ax.set_yticks(np.arange(rows) + 0.5, first.labels)
    for ax in panels:
        ax.label_outer()
    for ax in panels[-figures.row_length(panels) :]:
        ax.tick_params(labelbottom=True)
    figures.name_axes(panels, second.title, first.title)
    bar = figure.colorbar(
        panels[-1].collections[0], ax=panels, label=scale.title, pad=0.01, aspect=18
    )
    if wide:
        figures.logarithmic_ticks(bar.ax.yaxis, low, high)
    bar.outline.set_visible(False)
    return figure


def _failures(comparisons: Comparisons) -> Figure:
    factors, names = comparisons.episodes.factors, comparisons.episodes.controllers
    figure, panels = figures.panels_of(max(1, len(factors)), 2.3, sharey=True)
    for factor, ax in zip(factors or (None,), panels, strict=True):
        places = np.zeros(1) if factor is None else factor.places
        step = 1.0 if len(places) < 2 else float(np.min(np.diff(places)))
        step *= 0.6 * min(1.0, len(names) / 6.0)
        for c, name in enumerate(names):
            failures = [g.failures for g in comparisons.of(factor) if g.controller == name]
            value, low, high = 100.0 * np.array(failures).T
            x = places + step * _shift(c, len(names))
            color, marker = look_of(name)
            ax.vlines(x, low, high, color=color, linewidth=1.0, alpha=0.7)
            if factor is not None and factor.scaled:
                ax.plot(x, value, color=color, linewidth=0.8, alpha=0.5)
            ax.plot(x, value, marker, color=color, label=name, markersize=4.0)
        if factor is None:
            ax.set_xticks([])
        else:
            _name_axis(ax, factor)
    worst = max(100.0 * group.failures.high for group in comparisons.groups if group.episodes)
    panels[0].set_ylim(-0.03 * worst, 1.03 * worst)
    panels[0].set_title("diverged [%]")
    figures.add_legend(figure, panels[0])
    return figure
