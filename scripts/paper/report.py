"""Writing what came out: tables, claims, figures, the page, and what the repository shows."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from octarm.errors import OctarmError
from octarm.files import whole_file, write_text
from octarm.reports import page as pages
from octarm.reports.figures import Picture
from octarm.reports.statistics import Interval
from octarm.runs.versions import versions
from paper import tables
from paper.claims import Verdict, filled, in_words, number, rounded, spread, texts
from paper.evidence import Evidence
from paper.figures import HEADLINE, pictures
from paper.tables import Table, markdown
from paper.verdicts import claims

PAGE, CLAIMS, TABLES, FIGURES = "report.html", "claims.json", "tables", "figures"
COMMAND = "python scripts/reproduce_paper.py"
START, END = "<!-- claims -->", "<!-- /claims -->"
KINDS = {Verdict.HOLDS: "holds", Verdict.ONLY_IF: "part", Verdict.FAILS: "fails"}

_SECTIONS = {  # of the page: tables by name
    "ranking": ("ranking", "ablations", "gain-sets", "tuning"),
    "beyond": ("payload", "delay", "loss", "degradation", "rates", "correlation", "drift"),
}
_BEYOND = ("beyond", "degradation", "rates", "drift")  # figures


class Report:
    """What came of a run, ready to be written."""

    def __init__(self, evidence: Evidence, gains: Path) -> None:
        """Judges the claims and fills the tables.

        Args:
            evidence: what was run.
            gains: folder of the tuned gain sets.
        """
        self._evidence = evidence
        self.claims = claims(evidence)
        self.tables = tables.tables(evidence, gains)

    def content(self, *, timings: bool = False) -> dict[str, Any]:
        """Verdicts and numbers, ready for JSON; with or without what differs from run to run."""
        ranking = next(table for table in self.tables if table.name == "ranking")
        return {
            "effort": self._evidence.effort.name,
            "seeds": self._evidence.effort.seeds,
            "command": COMMAND,
            "claims": [claim.to_dict(timings=timings) for claim in self.claims],
            "ranking": [
                {
                    "controller": row[0],
                    "error_with_noise": rounded(row[1]),
                    "error": rounded(row[5]),
                }
                for row in ranking.rows
            ],
        }

    def markdown(self, picture: str) -> str:
        """The write-up; `picture` is where its picture stands."""
        return self._render("paper.md.j2", picture=picture, table=markdown)

    def page(self, drawn: Sequence[Picture]) -> str:
        """The page: one HTML file that needs nothing else."""
        timings = tables.timings(self._evidence)
        by_name = {table.name: table for table in (*self.tables, timings)}
        sections = {
            section: [by_name[name] for name in names if name in by_name]
            for section, names in _SECTIONS.items()
        }
        placed = {"cells", *(name for names in _SECTIONS.values() for name in names)}
        tracking = [p for p in drawn if p.name.startswith(("figure-1", "figure-2"))]
        beyond = [p for p in drawn if p.name in _BEYOND]
        others = [p for p in drawn if p not in (*tracking, *beyond) and p.name != HEADLINE]
        return self._render(
            "page.html.j2",
            sections=sections,
            rest=[table for name, table in by_name.items() if name not in placed],
            tracking=tracking,
            beyond=beyond,
            others=others,
            kinds=KINDS,
            as_cells=_as_cells,
            numbers=lambda rows: _as_cells(Table("", ("", "measured"), rows)),
            gains={
                label: json.dumps(dict(v.gains)) for label, v in self._evidence.variants.items()
            },
            versions=", ".join(f"{name} {version}" for name, version in versions().items()),
        )

    def write(self, out: Path) -> None:
        """Writes tables, claims, figures, the write-up and the page into a folder.

        All files in `tables` and `claims.json` are the same whenever the same is run; timings stand
        in `timings.csv`.

        Raises:
            OSError: if something cannot be written.
        """
        drawn = list(pictures(self._evidence))
        for folder in (TABLES, FIGURES):
            (out / folder).mkdir(parents=True, exist_ok=True)
        for table in (*self.tables, tables.numbers(self.claims)):
            write_text(out / TABLES / f"{table.name}.csv", table.csv())
        write_text(out / "timings.csv", tables.timings(self._evidence).csv())
        for picture in drawn:
            write_text(out / FIGURES / f"{picture.name}.svg", picture.svg)
            _write_bytes(out / FIGURES / f"{picture.name}.png", picture.png)
        write_text(out / CLAIMS, as_json(self.content()))
        write_text(out / "paper.md", self.markdown(f"{FIGURES}/{HEADLINE}.png"))
        write_text(out / PAGE, self.page(drawn))

    def publish(self, out: Path, root: Path) -> None:
        """Writes what the repository shows: `.readme/paper.*` and the claims in the README.

        Args:
            out: folder that `write` has written.
            root: of the checkout.

        Raises:
            OctarmError: if the README has no place for the claims.
            OSError: if something cannot be written.
        """
        content, folder, readme = self.content(timings=True), root / ".readme", root / "README.md"
        text = with_claims(readme.read_text(encoding="utf-8"), content["claims"])
        write_text(folder / "paper.json", as_json(content))
        write_text(folder / "paper.md", self.markdown("paper.png"))
        _write_bytes(folder / "paper.png", (out / FIGURES / f"{HEADLINE}.png").read_bytes())
        write_text(readme, text)

    def _render(self, template: str, **values: Any) -> str:
        return (
            _templates()
            .get_template(template)
            .render(
                claims=self.claims,
                tables={table.name: table for table in self.tables},
                seeds=self._evidence.effort.seeds,
                command=COMMAND,
                words={name: filled(text) for name, text in texts()["page"].items()},
                overview=claims_table([claim.to_dict(timings=True) for claim in self.claims]),
                **values,
            )
        )


def as_json(value: Mapping[str, Any]) -> str:
    """The text of a JSON file."""
    return json.dumps(value, indent=1, ensure_ascii=False) + "\n"


def claims_table(written: Sequence[Mapping[str, Any]]) -> str:
    """The claims in Markdown, each from what `Claim.to_dict` gave."""
    rows = [
        (
            f"({claim['letter']})",
            f"“{claim['quote']}”",
            f"**{claim['verdict']}** {claim['condition']}".strip(),
            claim["headline"],
        )
        for claim in written
    ]
    return markdown(("", "the paper says", "here it", "measured"), rows)


def with_claims(readme: str, written: Sequence[Mapping[str, Any]]) -> str:
    """A README with the picture and the claims between its two markers.

    Raises:
        OctarmError: if it does not have the two markers, once each and in order.
    """
    before, start, rest = readme.partition(START)
    _, end, after = rest.partition(END)
    if not (start and end) or START in rest or END in before + after:
        raise OctarmError(f"the README must have {START} and after it {END}, once each")
    picture = f"![{texts()['page']['picture']}](.readme/paper.png)"
    more = "Every number behind a verdict, and its rule: [.readme/paper.md](.readme/paper.md)."
    return "\n\n".join((f"{before}{START}", picture, claims_table(written), more, f"{END}{after}"))


@functools.cache
def _templates() -> jinja2.Environment:
    return pages.templates(Path(__file__).parent)


def _as_cells(table: Table) -> pages.Table:
    """A table of the page."""
    kinds = ["left" if table.is_words(j) else "" for j in range(len(table.columns))]
    head = [pages.Cell(name, kind=kind) for name, kind in zip(table.columns, kinds, strict=True)]
    rows = [
        [
            pages.Cell(number(float(entry.value)), [spread(entry)] if spread(entry) else [], kind)
            if isinstance(entry, Interval)
            else pages.Cell(in_words(entry), kind=kind)
            for entry, kind in zip(row, kinds, strict=True)
        ]
        for row in table.rows
    ]
    return pages.Table(head, rows, len(rows))


def _write_bytes(path: Path, content: bytes) -> None:
    with whole_file(path) as part:
        part.write_bytes(content)
