"""The figure of `octarm validate --rod`: errors over the number of modules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from octarm.reports import figures
from octarm.reports.figures import COLORS, MARKERS, Figure, Picture

_LEVELS = (5.0, 1.0)  # [%], which are marked


def picture(modules: Sequence[int], errors: Mapping[str, Mapping[str, np.ndarray]]) -> Picture:
    """A panel for each case, a line for each layout.

    There are m numbers of modules; errors have the shape (m,) [1], NaN where there is none.
    """
    with figures.figure_style():
        caption = "Errors of chains of N modules against the rod, with slopes 1/N and 1/N²."
        return figures.save_figure("convergence", caption, _convergence(modules, errors))


def _convergence(modules: Sequence[int], errors: Mapping[str, Mapping[str, np.ndarray]]) -> Figure:
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
