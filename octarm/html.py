"""What pages and cells of notebooks are made of: one stack of templates, tables, and curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup

from octarm.errors import printable

if TYPE_CHECKING:
    import jinja2

_WIDTH, _HEIGHT = 220, 36  # of a small plot [pixel]
_POINTS = 220  # of a curve in it


class Cell(NamedTuple):
    """A cell of a table: text, small lines below it, classes of its style, colour of a dot."""

    text: str
    small: Sequence[str] = ()
    kind: str = ""
    color: str = ""


class Table(NamedTuple):
    """A table of a page, for the macro `table` of `parts.html`.

    Lines set off each `group` of so many rows that belong together.
    """

    head: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]
    group: int = 1


def templates(*folders: Path) -> jinja2.Environment:
    """Templates in folders, and `base.html` and `parts.html`, with which all pages look alike."""
    import jinja2  # those who show nothing need not wait for it

    package = jinja2.PackageLoader("octarm", "reports/templates")
    return jinja2.Environment(
        loader=jinja2.ChoiceLoader([*map(jinja2.FileSystemLoader, folders), package]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def _shown(value: Any) -> Any:
    """What a page shows of a value: text of files line by line as it can be printed."""
    if isinstance(value, str) and not isinstance(value, Markup):
        return "\n".join(map(printable, value.split("\n")))
    return value


def notebook_cell(title: str, lines: Sequence[str], table: Table) -> str:
    """What something shows of itself in a notebook, on light ground and on dark."""
    template = templates().get_template("cell.html")
    return template.render(title=title, lines=lines, content=table)


def small_plot(values: np.ndarray, desired: np.ndarray) -> Markup:
    """A curve over its instants, and a wide pale one below it, each of shape (T,)."""
    both = np.stack([values, desired])[:, :: -(-len(values) // _POINTS) or 1]
    both = np.where(np.abs(both) < 1e6, both, np.nan)  # a diverged arm may be anywhere
    known = both[np.isfinite(both)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    x = np.linspace(2.0, _WIDTH - 2.0, both.shape[1])
    y = 3.0 + (_HEIGHT - 6.0) * (high - both) / (high - low if high > low else 1.0)
    curves = [
        " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, row, strict=True) if np.isfinite(b))
        for row in y
    ]
    style = 'fill="none" stroke="currentColor" stroke-linejoin="round"'
    return Markup(
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img">'
        f'<polyline {style} stroke-width="5" opacity=".25" points="{curves[1]}"/>'
        f'<polyline {style} stroke-width="1.2" points="{curves[0]}"/></svg>'
    )
