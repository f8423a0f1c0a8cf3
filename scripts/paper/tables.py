"""The tables: numbers in rows, as CSV, HTML and Markdown."""

from __future__ import annotations

import csv
import html
import io
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from octarm.reports.statistics import Interval
from paper.claims import number

Entry = str | int | float | Interval


class Table(NamedTuple):
    """Rows under headings.

    Attributes:
        name: of its file.
        caption: what it shows, and how.
        columns: headings, units in brackets.
        rows: an entry a column; an interval stands for median and 95 % interval.
    """

    name: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Entry, ...], ...]


def as_csv(table: Table) -> str:
    """The text of a CSV file; an interval takes three columns."""
    wide = [any(isinstance(row[j], Interval) for row in table.rows) for j in range(_width(table))]
    head: list[str] = []
    for name, spread in zip(table.columns, wide, strict=True):
        head += [name, f"{name} low", f"{name} high"] if spread else [name]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    for row in table.rows:
        cells: list[str] = []
        for entry, spread in zip(row, wide, strict=True):
            cells += _plain(entry, spread)
        writer.writerow(cells)
    return text.getvalue()


def as_html(table: Table) -> str:
    """A table with its caption."""
    head = "".join(f"<th{_side(table, j)}>{_escaped(c)}</th>" for j, c in enumerate(table.columns))
    rows: list[str] = []
    for row in table.rows:
        cells = (f"<td{_side(table, j)}>{_marked(entry)}</td>" for j, entry in enumerate(row))
        rows.append(f"<tr>{''.join(cells)}</tr>")
    body = "\n".join(rows)
    return (
        f'<div class="scroll"><table><caption>{_escaped(table.caption)}</caption>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )


def as_markdown(columns: Sequence[str], rows: Iterable[Sequence[Entry]]) -> str:
    """A table in Markdown."""
    lines = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for row in rows:
        lines.append(f"| {' | '.join(told(entry).replace('|', '/') for entry in row)} |")
    return "\n".join(lines)


def told(entry: Entry) -> str:
    """An entry in words."""
    if isinstance(entry, Interval):
        value, low, high = (float(x) for x in entry)
        same = low == high or math.isnan(low)
        return number(value) + ("" if same else f" ({number(low)} .. {number(high)})")
    return number(entry) if isinstance(entry, float) else str(entry)


def _width(table: Table) -> int:
    return len(table.columns)


def _plain(entry: Entry, spread: bool) -> list[str]:
    values = [entry]
    if spread:
        values = list(entry) if isinstance(entry, Interval) else [entry, entry, entry]
    return [
        ("" if math.isnan(value) else f"{value:.9g}") if isinstance(value, float) else str(value)
        for value in values
    ]


def _marked(entry: Entry) -> str:
    if isinstance(entry, Interval):
        value, low, high = (float(x) for x in entry)
        if low != high and not math.isnan(low):
            return f"{number(value)}<small>{number(low)} .. {number(high)}</small>"
        return number(value)
    return _escaped(told(entry))


def _side(table: Table, j: int) -> str:
    words = any(isinstance(row[j], str) for row in table.rows)
    return ' class="left"' if words else ""


def _escaped(text: str) -> str:
    return html.escape(text)
