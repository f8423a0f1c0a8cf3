"""What all figures have in common: colours, style, panels, files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.reports.figures import (
    COLORS,
    INK,
    MARKERS,
    Axes,
    Figure,
    figure_style,
    logarithmic_ticks,
    save_figure,
)
from octarm.reports.figures import Picture as Picture
from paper.variants import (
    AS_PRINTED,
    CONTROLLERS,
    FIXED_PREMISES,
    MATCHED,
    PROPOSED,
    SIGN,
    SMC,
    UNGUARDED,
)

_MAIN = (PROPOSED, SMC, SIGN, "smc-integral", "super-twisting", "afsmc-consequent", "fsmc", "pd",
         "computed-torque", "fuzzy")  # fmt: skip
_ABLATIONS = {
    FIXED_PREMISES: ("#7a8f1f", "--"),
    AS_PRINTED: ("#7d6bd0", ":"),
    UNGUARDED: ("#b0413e", "-"),
    MATCHED: ("#dd9500", "--"),
}
NAMES = {PROPOSED: "AFSMC (proposed)", SMC: "SMC, boundary layer", SIGN: "SMC, sgn"}


class Look(NamedTuple):
    """How a variant is drawn, the same in all figures."""

    color: str
    line: str
    marker: str


def look(label: str) -> Look:
    """The look of a variant; hand-set gains have a dashed line."""
    if label in _ABLATIONS:
        return Look(*_ABLATIONS[label], "x")
    name = label.removesuffix(", hand-set")
    place = _MAIN.index(name)
    line = "-" if name == label else (0, (4, 1.5))
    return Look(COLORS[place], cast(str, line), MARKERS[CONTROLLERS.index(name)])


def title_of(label: str) -> str:
    """The name of a variant in a legend."""
    name, comma, rest = label.partition(", ")
    return NAMES.get(name, name) + comma + rest


def draw(name: str, caption: str, make: Callable[[], Figure]) -> Picture:
    """A figure, drawn in the style of all; without anything that differs from run to run."""
    with figure_style():
        return save_figure(name, caption, make())


def panels(
    rows: int, columns: int, width: float, height: float, **options: Any
) -> tuple[Figure, np.ndarray]:
    """A grid of panels of this size [inch], shape (rows, columns)."""
    figure = NewFigure(figsize=(width * columns, height * rows + 0.4), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def legend(figure: Figure, ax: Axes, columns: int = 5) -> None:
    """One legend for all panels, above them."""
    handles, labels = ax.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        list(unique.values()), list(unique), loc="outside upper center", handlelength=2.2,
        ncols=min(len(unique), columns), columnspacing=1.8,
    )  # fmt: skip


def zero_line(ax: Axes) -> None:
    """A line at zero."""
    ax.axhline(0.0, color=INK, linewidth=0.6, zorder=1)


def logarithmic(ax: Axes, which: str) -> None:
    """Makes an axis logarithmic, with plain numbers at its ticks."""
    getattr(ax, f"set_{which}scale")("log")
    low, high = getattr(ax, f"get_{which}lim")()
    logarithmic_ticks(getattr(ax, f"{which}axis"), low, high)
