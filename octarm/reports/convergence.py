"""The figures of `octarm validate --rod`: errors over the number of modules, and rods let go."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from octarm.reports import figures
from octarm.reports.figures import COLORS, INK, MARKERS, Figure, Picture

Motions = Mapping[str, tuple[np.ndarray, str]]

_STYLES: dict[str, dict[str, Any]] = {
    "rod": {"color": INK, "linewidth": 3.2, "alpha": 0.35},
    "first": {"color": COLORS[0], "linewidth": 1.3},
    "second": {"color": COLORS[1], "linewidth": 1.3},
    "first, coarse": {"color": COLORS[0], "linewidth": 1.3, "linestyle": (0, (5, 2))},
    "second, coarse": {"color": COLORS[1], "linewidth": 1.3, "linestyle": (0, (5, 2))},
    "dots": {"color": COLORS[2], "marker": "o", "markersize": 3.0, "markevery": 8, "linewidth": 0},
}
_LEVELS = (5.0, 1.0)  # [%], which are marked


def pictures(
    modules: Sequence[int],
    errors: Mapping[str, Mapping[str, np.ndarray]],
    motions: Sequence[tuple[str, Motions]],
    duration: float,
) -> Iterator[Picture]:
    """Both figures.

    Args:
        modules: numbers of modules, m of them.
        errors: for each case and each layout, shape (m,) [1]; NaN where there is none.
        motions: the title of a panel, and the tips in it by name, shape (T, 2) [m] with x along
            and y across, each with the name of a style: `rod`, `first` and `second` with their
            `first, coarse` and `second, coarse`, `dots`.
        duration: of the motions [s].
    """
    with figures.figure_style():
        caption = "Errors of chains of N modules against the rod, with slopes 1/N and 1/N²."
        yield figures.save_figure("convergence", caption, _convergence(modules, errors))
        caption = "The tip of an undamped rod that is let go under its weight across."
        yield figures.save_figure("release", caption, _release(motions, duration))


def _convergence(modules: Sequence[int], errors: Mapping[str, Mapping[str, np.ndarray]]) -> Figure:
    """A panel for each case, a line for each layout."""
    figure, panels = figures.panels_of(len(errors), 2.15, sharex=True, sharey=True)
    n = np.array(modules, dtype=float)
    for (case, layouts), ax in zip(errors.items(), panels, strict=True):
        for order in (1, 2):
            ax.plot(n, 100.0 * n**-order, color=figures.LINE, linewidth=1.6, zorder=0)
        for level in _LEVELS:
            ax.axhline(level, color=figures.LINE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
        for i, (layout, values) in enumerate(layouts.items()):
            ax.plot(
                n, 100.0 * np.abs(values), color=COLORS[i], marker=MARKERS[i], label=layout,
                markeredgewidth=0.0,
            )  # fmt: skip
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.grid(False)
        figures.logarithmic_ticks(ax.yaxis, 0.01, 100.0)
        ax.yaxis.set_major_formatter("{x:g} %")
        ax.set_xticks(n, [f"{k:g}" for k in n])
        ax.minorticks_off()
        ax.set_ylim(0.004, 400.0)
        ax.set_title(case)
    figures.name_axes(panels, "modules N", "error")
    for order, name, at in ((1, "1/N", 5.5), (2, "1/N²", 11.0)):  # where no curve is
        panels[-2].text(at, 130.0 * at**-order, name, color="#8c8c8c", fontsize=8)
    figures.add_legend(figure, panels[0])
    return figure


def _release(motions: Sequence[tuple[str, Motions]], duration: float) -> Figure:
    """A panel for each rod: the deflection of its tip over time."""
    figure, panels = figures.panels_of(len(motions), 2.7)
    figure.set_figwidth(5.2 * len(motions))
    for (title, tips), ax in zip(motions, panels, strict=True):
        for name, (tip, style) in tips.items():
            t = np.linspace(0.0, duration, len(tip))
            ax.plot(t, 1e3 * tip[:, 1], label=name, **_STYLES[style])
        ax.set_title(title)
        ax.set_xlabel("time [s]")
        ax.set_xlim(0.0, duration)
        ax.invert_yaxis()
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, fontsize=7.5)
    panels[0].set_ylabel("sag of the tip [mm]")
    return figure
