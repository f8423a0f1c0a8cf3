"""What a claim of the paper is here: its words, what was measured, and a verdict by a rule.

All words stand in `texts.toml`; this module has what turns numbers into words.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import importlib.resources
import math
import tomllib
from collections.abc import Sequence
from typing import Any, NamedTuple

import jinja2

from octarm.reports.statistics import Interval
from paper import studies


class Verdict(enum.StrEnum):
    """What came of a claim."""

    HOLDS = "holds"
    ONLY_IF = "holds only if"
    FAILS = "does not hold"


class Row(NamedTuple):
    """A number that a verdict rests on.

    Attributes:
        name: what was measured.
        value: median over seeds with its 95 % interval, or a number where nothing is random.
        unit: empty for ratios.
        varies: whether it differs from run to run, as timings do.
    """

    name: str
    value: Interval | float
    unit: str = ""
    varies: bool = False

    @property
    def text(self) -> str:
        """The number, its interval and its unit."""
        return f"{in_words(self.value)} {self.unit}".rstrip()


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

    @classmethod
    def written(cls, letter: str, verdict: Verdict, rows: Sequence[Row], **values: Any) -> Claim:
        """A claim with its words filled in.

        Args:
            letter: of the claim in `texts.toml`.
            verdict: by its rule.
            rows: what was measured.
            **values: what its words are filled with.
        """
        only_if = verdict == Verdict.ONLY_IF
        words = {
            name: filled(text, verdict=str(verdict), only_if=only_if, **values)
            for name, text in texts()["claims"][letter].items()
        }
        words["condition"] = words["condition"] if only_if else ""
        return cls(letter=letter, verdict=verdict, rows=tuple(rows), **words)

    @property
    def numbers(self) -> list[tuple[str, str]]:
        """Names and texts of the rows."""
        return [(row.name, row.text) for row in self.rows]

    @property
    def outcome(self) -> str:
        """The verdict and its condition."""
        return f"{self.verdict} {self.condition}".strip()

    def to_dict(self, *, timings: bool = False) -> dict[str, Any]:
        """For JSON; what is not finite becomes a word.

        Args:
            timings: whether what differs from run to run is there, too.
        """
        content = dataclasses.asdict(self) | {"verdict": str(self.verdict)}
        content["rows"] = [
            {
                "name": row.name,
                **dict(zip(("value", "low", "high"), rounded(row.value), strict=True)),
                "unit": row.unit,
            }
            for row in self.rows
            if timings or not row.varies
        ]
        if not timings and any(row.varies for row in self.rows):
            content.pop("headline")
        return content


@functools.cache
def texts() -> dict[str, Any]:
    """The content of `texts.toml`."""
    return tomllib.loads(
        importlib.resources.files("paper").joinpath("texts.toml").read_text("utf-8")
    )


def filled(text: str, **values: Any) -> str:
    """A template of `texts.toml` with its numbers, on one line."""
    return " ".join(environment().from_string(text).render(**values).split())


def environment(**options: Any) -> jinja2.Environment:
    """Templates that know the constants of the studies, and how numbers are put into words."""
    made = jinja2.Environment(undefined=jinja2.StrictUndefined, **options)
    made.filters |= {"number": number, "percent": percent, "span": span, "listed": listed}
    made.globals |= {name: value for name, value in vars(studies).items() if name.isupper()}
    return made


def ends(entry: Any) -> tuple[Any, Any, Any]:
    """A median and its interval; thrice the same where there is none."""
    return tuple(entry) if isinstance(entry, Interval) else (entry, entry, entry)


def rounded(entry: Any) -> list[float | str]:
    """These three to six digits, more than any of them is good for; words if not finite."""
    return [float(f"{x:.6g}") if math.isfinite(x) else str(x) for x in map(float, ends(entry))]


def number(value: float) -> str:
    """Three digits."""
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "-∞"}.get(value, "-")
    size = abs(value)
    if float(value).is_integer() and size < 1e5:
        return f"{abs(value) if value == 0.0 else value:.0f}"
    if size >= 1e5 or size < 1e-3:
        return f"{value:.2e}"
    return f"{value:.0f}" if size >= 99.95 else f"{value:#.3g}".rstrip(".")


def spread(interval: Interval) -> str:
    """The ends of an interval; empty where it has no width."""
    same = interval.low == interval.high or math.isnan(interval.low)
    return "" if same else f"{number(interval.low)} .. {number(interval.high)}"


def in_words(entry: str | float | Interval) -> str:
    """An entry of a table, or a number behind a verdict."""
    if isinstance(entry, Interval):
        limits = spread(entry)
        return number(entry.value) + (f" ({limits})" if limits else "")
    return number(entry) if isinstance(entry, float) else str(entry)


def percent(share: float) -> str:
    """A model error, or another share, in words: -30 %."""
    return "exact" if share == 0.0 else f"{100.0 * share:+.0f} %"


def span(values: Sequence[float], unit: str = "") -> str:
    """The smallest to the largest of some numbers, those that are finite, in words."""
    known = [float(value) for value in values if math.isfinite(value)]
    if not known:
        return "unknown"
    low, high = number(min(known)), number(max(known))
    return f"{low if low == high else f'{low} to {high}'} {unit}".rstrip()


def listed(words: Sequence[str]) -> str:
    """a, b and c."""
    *first, last = words or ("none",)
    return f"{', '.join(first)} and {last}" if first else last
