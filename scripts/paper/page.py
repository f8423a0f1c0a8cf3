"""The report: one HTML file that needs nothing beside itself."""

from __future__ import annotations

import html
import importlib.resources
import json
import string
from collections.abc import Iterable, Mapping, Sequence

from octarm.reports.figures import inline_svg
from octarm.runs.versions import versions
from paper.claims import Claim, Verdict
from paper.drawing import Picture
from paper.evidence import Evidence
from paper.tables import Table, as_html
from paper.writeup import COMMAND, LEAD, SETUP, TITLE

_KINDS = {Verdict.HOLDS: "holds", Verdict.ONLY_IF: "part", Verdict.FAILS: "fails"}
_TRACKING = ("figure-1", "figure-2")
_BEYOND = ("beyond", "degradation", "rates", "drift")


def page(
    evidence: Evidence,
    claims: Sequence[Claim],
    pictures: Sequence[Picture],
    tables: Sequence[Table],
) -> str:
    """The page as text."""
    template = importlib.resources.files("paper").joinpath("page.html")
    tracking = [p for p in pictures if p.name.startswith(_TRACKING)]
    beyond = [p for p in pictures if p.name in _BEYOND]
    others = [p for p in pictures if p not in tracking and p not in beyond]
    by_name = {table.name: table for table in tables}
    first = [by_name[n] for n in ("ranking", "ablations", "gain-sets", "tuning") if n in by_name]
    outside = [
        by_name[n]
        for n in ("payload", "delay", "loss", "degradation", "rates", "correlation", "drift")
        if n in by_name
    ]
    rest = [t for t in tables if t not in first and t not in outside and t.name != "cells"]
    return string.Template(template.read_text(encoding="utf-8")).substitute(
        title=_escaped(TITLE),
        lead=_escaped(LEAD),
        overview=_overview(claims),
        tracking=_figures(tracking),
        claims="\n".join(map(_claim, claims)),
        ranking=_figures(others) + _tables(first),
        beyond=_figures(beyond) + _tables(outside),
        tables=_folded(rest),
        run=_run(evidence),
        reproduce=f"<pre>{_escaped(COMMAND)}</pre>",
    )


def _overview(claims: Iterable[Claim]) -> str:
    rows = [
        f'<tr><td class="left">({c.letter})</td><td class="left">{_escaped(c.title)}</td>'
        f'<td class="left">{_verdict(c)}</td>'
        f'<td class="left">{_escaped(c.headline)}</td></tr>'
        for c in claims
    ]
    head = "".join(f'<th class="left">{h}</th>' for h in ("", "claim", "verdict", "measured"))
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}'
        "</tbody></table></div>"
    )


def _verdict(claim: Claim) -> str:
    kind = _KINDS.get(claim.verdict, "part")
    return f'<span class="verdict {kind}">{_escaped(claim.told)}</span>'


def _claim(claim: Claim) -> str:
    rows = tuple((row.name, row.told()) for row in claim.rows)
    numbers = Table("", "Medians over seeds, 95 % intervals in brackets.", ("", "measured"), rows)
    return "\n".join(
        [
            f"<h3>({claim.letter}) {_escaped(claim.title)}</h3>",
            f'<p class="quote">“{_escaped(claim.quote)}” ({_escaped(claim.place)})</p>',
            f"<p>{_verdict(claim)}</p>",
            f"<p>{_escaped(claim.why)}</p>",
            f'<p class="rule">The rule: {_escaped(claim.rule)}.</p>',
            f"<details><summary>The {len(rows)} numbers</summary>{as_html(numbers)}</details>",
        ]
    )


def _figures(pictures: Iterable[Picture]) -> str:
    parts: list[str] = []
    for picture in pictures:
        svg = inline_svg(picture.svg, picture.name, picture.caption)
        caption = f"<figcaption>{_escaped(picture.caption)}</figcaption>"
        parts.append(f"<figure>\n{svg}\n{caption}\n</figure>")
    return "\n".join(parts)


def _tables(tables: Iterable[Table]) -> str:
    return "\n".join(f"<h3>{_escaped(t.name)}</h3>\n{as_html(t)}" for t in tables)


def _folded(tables: Iterable[Table]) -> str:
    return "\n".join(
        f"<details><summary>{_escaped(t.name)}</summary>{as_html(t)}</details>" for t in tables
    )


def _run(evidence: Evidence) -> str:
    gains = "\n".join(
        f"{label}: {json.dumps(_plain(evidence.cast[label].gains))}"
        for label in evidence.cast.labels()
    )
    told = ", ".join(f"{name} {version}" for name, version in versions().items())
    return "\n".join(
        [
            *(f"<p>{_escaped(text)}</p>" for text in SETUP),
            f"<p>{evidence.seeds} seeds wherever noise acts. Versions: {_escaped(told)}.</p>",
            f"<details><summary>All gains</summary><pre>{_escaped(gains)}</pre></details>",
        ]
    )


def _plain(gains: Mapping[str, object]) -> dict[str, object]:
    return dict(gains)


def _escaped(text: str) -> str:
    return html.escape(text)
