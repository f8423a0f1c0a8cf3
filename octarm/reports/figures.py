"""The one style of figures: fonts, panels, scales, and how a figure is saved."""

from __future__ import annotations

import contextlib
import io
import re
import warnings
from collections.abc import Generator
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.style
import numpy as np
from markupsafe import Markup, escape
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure as NewFigure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

from octarm.palette import COLORS as COLORS
from octarm.palette import MARKERS as MARKERS

# These stand for Matplotlib's classes, whose methods leave the types of keyword arguments unknown.
Axes = Any
Figure = Any

INK, LINE, GROUND = "#24292f", "#d4dae1", "#ffffff"  # as in the style; a page has its own
GRAY, FAILED = "#6b7480", "#c0152f"  # bounds and remarks; where a run failed

LETTER = 0.085  # mean width of a letter [inch]
LOGARITHMIC = 8.0  # largest over smallest value, from which on an axis is logarithmic
_COLUMNS = 4  # of panels
_PIXELS = 1.5  # of a point of a figure: four panels fill the page
_LEAST = 0.93  # on a phone, where it moves sideways within its frame so that it can be read
_STYLE = Path(__file__).with_suffix(".mplstyle")


class Picture(NamedTuple):
    """A figure in both formats, with a caption, and the name of its files without ending."""

    name: str
    caption: str
    svg: str
    png: bytes

    @property
    def inline(self) -> Markup:
        """The figure to stand in a page."""
        return inline_svg(self.svg, self.name.replace(".", "-"), self.caption)

    def files(self, folder: Path) -> dict[Path, bytes]:
        """What to write into a folder: the figure in both formats."""
        place = folder / self.name
        return {Path(f"{place}.svg"): self.svg.encode(), Path(f"{place}.png"): self.png}


@contextlib.contextmanager
def figure_style() -> Generator[None]:
    """The style in which figures are made and saved, whatever a user's own settings are."""
    with matplotlib.style.context(["default", str(_STYLE)]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # the font lacks it, and draws a box
        yield


def save_figure(name: str, caption: str, figure: Figure) -> Picture:
    """Both formats, without anything that differs from run to run; within `figure_style`."""
    vector, raster = io.BytesIO(), io.BytesIO()
    figure.savefig(vector, format="svg", metadata={"Date": None, "Creator": None})
    figure.set_layout_engine("none")  # the layout of the first holds for the second
    figure.savefig(raster, format="png", dpi=200, metadata={"Software": None})
    name = re.sub(r"[^\w.-]", "_", name)
    return Picture(name, caption, vector.getvalue().decode(), raster.getvalue())


def inline_svg(svg: str, prefix: str, label: str) -> Markup:
    """A figure to stand in a page: with the page's colours and font, and ids with a prefix."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", body, flags=re.DOTALL)
    box = re.search(r'viewBox="0 0 ([\d.]+) [\d.]+"', body)
    assert box is not None
    least, most = (share * float(box[1]) for share in (_LEAST, _PIXELS))
    size = f'{box[0]} style="min-width: {least:.0f}px; max-width: {most:.0f}px"'
    head = f'<svg {size} role="img" aria-label="{escape(label)}">'
    body = re.sub(r"<svg[^>]*>", lambda _: head, body, count=1)
    body = re.sub(r'\bid="', f'id="{prefix}-', body)
    body = body.replace("xlink:href=", "href=").replace('href="#', f'href="#{prefix}-')
    body = body.replace("url(#", f"url(#{prefix}-")
    body = re.sub(r"'DejaVu Sans'[^;\"]*", "var(--font)", body)
    body = body.replace(f"fill: {GROUND}", "fill: none").replace(GROUND, "var(--ground)")
    body = body.replace(INK, "var(--ink)").replace(LINE, "var(--line)")
    return Markup(re.sub(r"\n\s*", "\n", body).strip())


def panels_of(
    count: int, height: float, margin: float = 0.0, **options: Any
) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels in rows; the height of a row and the left margin in inches."""
    columns = count if count <= _COLUMNS else -(-count // -(-count // _COLUMNS))
    rows = -(-count // columns)
    size = (max(5.5, 2.75 * columns) + margin, height * rows + 0.25)
    figure = NewFigure(figsize=size, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.06)  # pyright: ignore
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    for ax in grid.flat[count:]:
        ax.remove()
    for ax in grid.flat[:count]:
        ax.yaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))
    return figure, list(grid.flat[:count])


def row_length(panels: list[Axes]) -> int:
    """Number of panels side by side."""
    return panels[0].get_subplotspec().get_gridspec().ncols


def name_axes(panels: list[Axes], x: str, y: str = "") -> None:
    """Names the horizontal axes of the last row of panels, and the vertical ones of the first."""
    for ax in panels[-row_length(panels) :]:
        ax.set_xlabel(x)
    for ax in panels[:: row_length(panels)]:
        ax.set_ylabel(y)


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


def mark_scale(ax: Axes, which: str) -> None:
    """Writes at the corner of a panel whether its axis, x or y, is logarithmic."""
    scale = "log" if getattr(ax, f"get_{which}scale")() == "log" else "linear"
    ax.set_title(scale, loc="right", fontsize=7.5, fontweight="normal", color=GRAY)


def logarithmic_ticks(direction: XAxis | YAxis, low: float, high: float) -> None:
    """Ticks without powers: at 1, 2 and 5 when there are few decades."""
    few = high <= 100.0 * low
    direction.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    direction.set_major_formatter(StrMethodFormatter("{x:g}"))
    direction.set_minor_locator(NullLocator())


def add_legend(figure: Figure, ax: Axes) -> None:
    """The legend of a panel, above all of them; makes room for it."""
    handles, labels = ax.get_legend_handles_labels()
    room = int(figure.get_figwidth() / (0.7 + LETTER * max(map(len, labels))))
    columns = min(max(1, room), len(labels), 5)
    figure.set_figheight(figure.get_figheight() + 0.2 * -(-len(labels) // columns))
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, handlelength=1.8,
                  columnspacing=1.6, borderaxespad=0.1)  # fmt: skip
