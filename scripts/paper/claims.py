"""What a claim of the paper is here: its words, what was measured, and a verdict by one rule.

A claim is a condition on numbers that is looked at case by case. A case is a place in which it was
measured: a gain set, the joints that move, a nominal model, and so on. The claim holds if it does
in all cases, does not hold if it does in none, and else holds only if the cases are narrowed down.
"""

import enum
import functools
import itertools
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from octarm.html import templates
from octarm.reports.statistics import Interval

Entry = str | int | float | Interval  # of a table; an interval is a median and its 95 % interval


class Row(NamedTuple):
    """A number that a verdict rests on."""

    name: str  # what was measured
    number: Interval  # median over seeds with its 95 % interval; without width if not random
    unit: str = ""  # of the three; empty for ratios

    def __str__(self) -> str:
        return f"{in_words(self.number)} {self.unit}".rstrip()


def exact(name: str, value: float, unit: str = "") -> Row:
    """A row of a number that is not random."""
    return Row(name, Interval(value, value, value), unit)


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


class Verdict(enum.StrEnum):
    """What came of a claim."""

    HOLDS = "holds"
    ONLY_IF = "holds only if"
    FAILS = "does not hold"


# What a verdict is tried with.
FACTORS = (0.5, 1.0, 2.0)  # by which the threshold of a rule is multiplied
SENSITIVE = ("gains", "joints", "SMC", "against")  # axes along which a verdict is looked at apart


class Case(NamedTuple):
    """A place in which a claim was measured: it holds there by a range of thresholds."""

    where: Mapping[str, str]  # value of each axis, such as gains, joints and model
    rows: Sequence[Row]  # the numbers
    least: float = 0.0  # smallest factor of the rule's threshold by which it holds [1]
    most: float = math.inf  # largest one [1]


def passed(cases: Sequence[Case], factor: float = 1.0) -> int:
    """In how many cases a claim holds, by a factor of its threshold."""
    return sum(case.least <= factor <= case.most for case in cases)


def verdict(cases: Sequence[Case], factor: float = 1.0) -> Verdict:
    """The rule; a claim without a case does not hold."""
    count = passed(cases, factor)
    if not count:
        return Verdict.FAILS
    return Verdict.HOLDS if count == len(cases) else Verdict.ONLY_IF


def sensitivity(cases: Sequence[Case]) -> tuple[int, int]:
    """In how many variations the verdict is the same, and how many variations there are.

    A variation is a threshold, halved, as it is or doubled, with the cases of one gain set, one
    reading of the joints and one of the controller it is compared with.
    """
    parts: dict[Any, list[Case]] = {}
    for case in cases:
        parts.setdefault(tuple(case.where.get(axis) for axis in SENSITIVE), []).append(case)
    outcomes = [verdict(part, factor) for part in parts.values() for factor in FACTORS]
    return outcomes.count(verdict(cases)), len(outcomes)


def condition(cases: Sequence[Case], phrases: Mapping[str, str]) -> str:
    """Where a claim holds in every case, in words, and in how many of all cases it does.

    It is said by values of one axis, or else of two. There is a phrase for each axis, with {} for
    its value.
    """
    pairs = dict.fromkeys(pair for case in cases for pair in case.where.items())
    dividing = [pair for pair in pairs if len(matching(cases, dict([pair]))) < len(cases)]
    wheres = [(pair,) for pair in dividing]
    wheres += [both for both in itertools.combinations(dividing, 2) if len(dict(both)) == 2]
    holding = [x for x in wheres if verdict(matching(cases, dict(x))) == Verdict.HOLDS]
    names = [
        " and ".join(phrases[axis].format(value) for axis, value in where)
        for where in holding if len(where) == len(holding[0])
    ]  # fmt: skip
    words = " or ".join(names[:2]) or "the cases are picked"
    return f"{words} ({passed(cases)} of {len(cases)} cases)"


def numbers_of(cases: Sequence[Case]) -> list[Row]:
    """The rows of all cases, each with its place in its name."""
    return [
        row._replace(name=f"{row.name} ({', '.join(case.where.values())})")
        for case in cases
        for row in case.rows
    ]


def matching(cases: Sequence[Case], where: Mapping[str, str]) -> list[Case]:
    """The cases at these values of axes."""
    return [case for case in cases if where.items() <= case.where.items()]


class Claim(NamedTuple):
    """A claim, or a question of our own, and what came of it."""

    letter: str  # under which it is known here
    title: str  # what it is about
    quote: str  # the paper's own words; of a question of our own, the question
    place: str  # where they stand; empty for a question
    verdict: Verdict  # by the rule
    condition: str  # what follows `holds only if`; empty otherwise
    rule: str  # in words
    stays: str  # in how many variations of threshold, gains and reading the verdict is the same
    headline: str  # the most important numbers in a few words
    rows: Sequence[Row]  # what was measured
    why: str  # one paragraph

    @property
    def outcome(self) -> str:
        """The verdict with its condition."""
        return f"{self.verdict} {self.condition}".strip()

    def to_dict(self) -> dict[str, Any]:
        """For JSON; infinity becomes a word."""
        names = ("name", *Interval._fields, "unit")
        rows = [(row.name, *map(rounded, row.number), row.unit) for row in self.rows]
        return {**self._asdict(), "rows": [dict(zip(names, row, strict=True)) for row in rows]}


def claim(name: str, cases: Sequence[Case]) -> Claim:
    """A claim of `words.toml` with what was measured of it."""
    outcome = verdict(cases)

    def of(row: str, **where: str) -> list[Row]:
        return [x for case in matching(cases, where) for x in case.rows if x.name == row]

    def count(**where: str) -> str:
        some = matching(cases, where)
        return f"{passed(some)} of {len(some)}"

    texts: dict[str, str] = words()["claims"][name]
    same, total = sensitivity(cases)
    return Claim(
        **{key: worded(text, of=of, count=count) for key, text in texts.items()},
        verdict=outcome,
        condition=condition(cases, words()["phrases"]) if outcome == Verdict.ONLY_IF else "",
        stays=f"{same} of {total}",
        rows=numbers_of(cases),
    )


@functools.cache
def words() -> dict[str, Any]:
    """All texts of the write-up, as Jinja templates."""
    file = Path(__file__).with_name("words.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def worded(text: str, **values: Any) -> str:
    """A text of `words.toml` with its numbers, in one line."""
    return " ".join(TEXTS.from_string(text).render(**values).split())


PAGES = templates(Path(__file__).with_name("templates"))
PAGES.filters |= {"in_parts": in_parts, "in_words": in_words, "span": span}
TEXTS = PAGES.overlay(autoescape=False)
