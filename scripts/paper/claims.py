"""What a claim of the paper is here: its words, what was measured, and a verdict by a rule."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Sequence
from typing import Any

from octarm.reports.statistics import Interval


class Verdict(enum.StrEnum):
    """What came of a claim."""

    HOLDS = "holds"
    ONLY_IF = "holds only if"
    FAILS = "does not hold"
    UNTESTABLE = "not testable"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """A number that a verdict rests on.

    Attributes:
        name: what was measured.
        value: median over seeds, or the number itself where nothing is random.
        low: lower end of the 95 % interval; as large as the value where nothing is random.
        high: upper end.
        unit: of the three; empty for ratios.
        varies: whether it differs from run to run, as timings do.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str = ""
    varies: bool = False

    @classmethod
    def of(cls, name: str, interval: Interval, unit: str = "", factor: float = 1.0) -> Row:
        """A row of an interval, times a factor that belongs to the unit."""
        value, low, high = (factor * float(x) for x in interval)
        return cls(name=name, value=value, low=low, high=high, unit=unit)

    @classmethod
    def exact(cls, name: str, value: float, unit: str = "", varies: bool = False) -> Row:
        """A row of a number that is not random."""
        return cls(name=name, value=value, low=value, high=value, unit=unit, varies=varies)

    def told(self) -> str:
        """The number, its interval and its unit in words."""
        same = self.low == self.high or math.isnan(self.low)
        spread = "" if same else f" ({number(self.low)} .. {number(self.high)})"
        return f"{number(self.value)}{spread}{f' {self.unit}' if self.unit else ''}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim and what came of it.

    Attributes:
        letter: under which it is known here.
        title: what it is about.
        quote: the paper's own words.
        place: where they stand.
        verdict: by the rule.
        condition: what follows `holds only if`; empty otherwise.
        rule: in words.
        headline: the most important numbers in a few words.
        rows: what was measured.
        why: one paragraph.
    """

    letter: str
    title: str
    quote: str
    place: str
    verdict: Verdict
    condition: str
    rule: str
    headline: str
    rows: tuple[Row, ...]
    why: str

    @property
    def told(self) -> str:
        """The verdict in words."""
        return f"{self.verdict} {self.condition}".strip()

    def to_dict(self, *, timings: bool = False) -> dict[str, Any]:
        """For JSON; what is not finite becomes a word.

        Args:
            timings: whether what differs from run to run is there, too.
        """
        content = dataclasses.asdict(self)
        rows: list[dict[str, Any]] = []
        for row in self.rows:
            if timings or not row.varies:
                numbers = {key: rounded(getattr(row, key)) for key in ("value", "low", "high")}
                rows.append({"name": row.name, **numbers, "unit": row.unit})
        if not timings and any(row.varies for row in self.rows):
            content.pop("headline")
        return {**content, "verdict": str(self.verdict), "rows": rows}


def rounded(value: float) -> float | str:
    """To six digits, more than any of them is good for."""
    return float(f"{value:.6g}") if math.isfinite(value) else str(value)


def number(value: float) -> str:
    """Three digits."""
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "-∞"}.get(value, "-")
    if value == 0.0:
        return "0"
    size = abs(value)
    if float(value).is_integer() and size < 1e5:
        return f"{value:.0f}"
    if size >= 1e5 or size < 1e-3:
        return f"{value:.2e}"
    return f"{value:.0f}" if size >= 99.95 else f"{value:#.3g}".rstrip(".")


def percent(share: float) -> str:
    """A model error, or another share, in words: -30 %."""
    return "exact" if share == 0.0 else f"{100.0 * share:+.0f} %"


def span(values: Sequence[float], unit: str = "") -> str:
    """The smallest to the largest of some numbers, those that are finite, in words."""
    known = [float(value) for value in values if math.isfinite(value)]
    if not known:
        return "unknown"
    low, high = number(min(known)), number(max(known))
    told = low if low == high else f"{low} to {high}"
    return f"{told} {unit}".rstrip()


def listed(words: Sequence[str]) -> str:
    """a, b and c."""
    *first, last = words or ("none",)
    return f"{', '.join(first)} and {last}" if first else last
