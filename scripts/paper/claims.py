"""What a claim of the paper is here: its words, what was measured, and a verdict by a rule."""

from __future__ import annotations

import dataclasses
import enum
import functools
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from octarm.reports.page import templates
from octarm.reports.statistics import Interval


class Verdict(enum.StrEnum):
    """What came of a claim."""

    HOLDS = "holds"
    ONLY_IF = "holds only if"
    FAILS = "does not hold"


class Row(NamedTuple):
    """A number that a verdict rests on.

    Attributes:
        name: what was measured.
        number: median over seeds with its 95 % interval; the number itself, three times, where
            nothing is random.
        unit: of the three; empty for ratios.
        varies: whether it differs from run to run, as timings do.
    """

    name: str
    number: Interval
    unit: str = ""
    varies: bool = False

    def __str__(self) -> str:
        return f"{in_words(self.number)} {self.unit}".rstrip()


def exact(name: str, value: float, unit: str = "", varies: bool = False) -> Row:
    """A row of a number that is not random."""
    return Row(name, Interval(value, value, value), unit, varies)


class Examined(NamedTuple):
    """What examining a claim gave.

    Attributes:
        verdict: by the rule.
        rows: what was measured.
        numbers: that the claim's words in `words.toml` ask for, by name.
    """

    verdict: Verdict
    rows: Sequence[Row]
    numbers: Mapping[str, Any]


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
    rows: Sequence[Row]
    why: str

    @property
    def outcome(self) -> str:
        """The verdict with its condition."""
        return f"{self.verdict} {self.condition}".strip()

    def to_dict(self, *, timings: bool = False) -> dict[str, Any]:
        """For JSON; what is not finite becomes a word.

        Args:
            timings: whether what differs from run to run is there, too.
        """
        rows = [
            {"name": row.name, **{k: rounded(x) for k, x in row.number._asdict().items()},
             "unit": row.unit}
            for row in self.rows
            if timings or not row.varies
        ]  # fmt: skip
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        if not timings and any(row.varies for row in self.rows):
            fields.pop("headline")
        return {**fields, "verdict": str(self.verdict), "rows": rows}


def claim(name: str, examined: Examined) -> Claim:
    """A claim of `words.toml` with what was measured of it."""
    wording = words()["claims"][name]
    numbers = {**examined.numbers, "verdict": examined.verdict, "rows": examined.rows}
    texts = {key: worded(text, **numbers) for key, text in wording.items()}
    if examined.verdict != Verdict.ONLY_IF:
        texts["condition"] = ""
    return Claim(**{"condition": "", **texts}, verdict=examined.verdict, rows=examined.rows)


@functools.cache
def words() -> dict[str, Any]:
    """All texts of the write-up, as Jinja templates."""
    file = Path(__file__).with_name("words.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def worded(text: str, **numbers: Any) -> str:
    """A text of `words.toml` with its numbers, in one line."""
    return " ".join(TEXTS.from_string(text).render(**numbers).split())


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


def in_words(entry: str | int | float | Interval) -> str:
    """An entry of a table; an interval in brackets behind its median."""
    if isinstance(entry, Interval):
        return median(entry) + (f" ({spread(entry)})" if spread(entry) else "")
    return number(entry) if isinstance(entry, float) else str(entry)


def median(entry: str | int | float | Interval) -> str:
    """An entry of a table without its interval."""
    return number(float(entry.value)) if isinstance(entry, Interval) else in_words(entry)


def spread(entry: str | int | float | Interval) -> str:
    """An interval's ends; empty where it has no width, or there is none."""
    if not isinstance(entry, Interval):
        return ""
    low, high = float(entry.low), float(entry.high)
    return "" if low == high or math.isnan(low) else f"{number(low)} .. {number(high)}"


def percent(share: float) -> str:
    """A model error, or another share, in words: -30 %."""
    return "exact" if share == 0.0 else f"{100.0 * share:+.0f} %"


def span(values: Sequence[float | Interval | Row], unit: str = "") -> str:
    """The smallest to the largest of some numbers or medians, those that are finite, in words."""
    numbers = [x.number.value if isinstance(x, Row) else x for x in values]
    plain = [float(x.value if isinstance(x, Interval) else x) for x in numbers]
    finite = [x for x in plain if math.isfinite(x)]
    if not finite:
        return "unknown"
    low, high = number(min(finite)), number(max(finite))
    return f"{low if low == high else f'{low} to {high}'} {unit}".rstrip()


def listed(names: Sequence[str]) -> str:
    """a, b and c."""
    *first, last = names or ("none",)
    return f"{', '.join(first)} and {last}" if first else last


PAGES = templates(Path(__file__).with_name("templates"))
PAGES.filters |= {
    "g": lambda x: f"{x:g}",
    "number": number,
    "in_words": in_words,
    "median": median,
    "spread": spread,
    "percent": percent,
    "span": span,
    "listed": listed,
}
TEXTS = PAGES.overlay(autoescape=False)
