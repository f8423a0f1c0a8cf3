"""Numbers with their intervals, and how they are written."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from octarm.reports.statistics import Interval

Entry = str | int | float | Interval  # of a table; an interval is a median and its 95 % interval


class Row(NamedTuple):
    """A number that a verdict rests on."""

    name: str  # what was measured
    number: Interval  # median over seeds with its 95 % interval; without width if not random
    unit: str = ""  # of the three; empty for ratios
    varies: bool = False  # whether it differs from run to run, as timings do

    def __str__(self) -> str:
        return f"{in_words(self.number)} {self.unit}".rstrip()


def exact(name: str, value: float, unit: str = "", varies: bool = False) -> Row:
    """A row of a number that is not random."""
    return Row(name, Interval(value, value, value), unit, varies)


def rounded(value: float) -> float | str:
    """To six digits, more than any of them is good for."""
    return float(f"{value:.6g}") if math.isfinite(value) else str(value)


def number(value: float) -> str:
    """Three digits."""
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "-∞"}.get(value, "-")
    size = abs(value)
    if value.is_integer() and size < 1e5:
        return f"{value + 0.0:.0f}"
    if size >= 1e5 or size < 1e-3:
        return f"{value:.2e}"
    return f"{value:.0f}" if size >= 99.95 else f"{value:#.3g}".rstrip(".")


def in_parts(entry: Entry) -> tuple[str, str]:
    """An entry of a table, and the ends of its interval; empty where it has no width, or none."""
    if not isinstance(entry, Interval):
        return number(entry) if isinstance(entry, float) else str(entry), ""
    value, low, high = map(float, entry)
    ends = "" if low == high or math.isnan(low) else f"{number(low)} .. {number(high)}"
    return number(value), ends


def in_words(entry: Entry) -> str:
    """An entry of a table; an interval in brackets behind its median."""
    value, ends = in_parts(entry)
    return f"{value} ({ends})" if ends else value


def percent(share: float) -> str:
    """A model error, or another share, in words: -30 %."""
    return "exact" if share == 0.0 else f"{100.0 * share:+.0f} %"


def span(rows: Sequence[Row], unit: str = "") -> str:
    """The smallest to the largest of some medians, those that are finite, in words."""
    finite = [float(row.number.value) for row in rows if math.isfinite(row.number.value)]
    if not finite:
        return "unknown"
    low, high = number(min(finite)), number(max(finite))
    return f"{low if low == high else f'{low} to {high}'} {unit}".rstrip()
