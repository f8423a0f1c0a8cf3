"""What a claim of the paper is here: its words, what was measured, and a verdict by a rule."""

import dataclasses
import functools
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from octarm.html import templates
from paper.cases import Case, Verdict, condition, matching, numbers_of, sensitivity, verdict
from paper.numbers import Row, in_words, rounded, span


@dataclasses.dataclass(frozen=True, kw_only=True)
class Claim:
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

    def to_dict(self, *, timings: bool = False) -> dict[str, Any]:
        """For JSON, with or without what differs from run to run; infinity becomes a word."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        if not timings and any(row.varies for row in self.rows):
            fields = {key: fields[key] for key in ("letter", "title", "quote", "place", "rule")}
        else:
            fields["verdict"] = str(self.verdict)
        rows = [
            {"name": row.name, **{k: rounded(x) for k, x in row.number._asdict().items()},
             "unit": row.unit}
            for row in self.rows
            if timings or not row.varies
        ]  # fmt: skip
        return {**fields, "rows": rows}


def claim(name: str, cases: Sequence[Case]) -> Claim:
    """A claim of `words.toml` with what was measured of it."""
    outcome = verdict(cases)

    def of(row: str, **where: str) -> list[Row]:
        return [x for case in matching(cases, where) for x in case.rows if x.name == row]

    def count(**where: str) -> str:
        own = matching(cases, where)
        return f"{sum(case.passes(1.0) for case in own)} of {len(own)}"

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
PAGES.filters |= {"in_words": in_words, "span": span}
TEXTS = PAGES.overlay(autoescape=False)
