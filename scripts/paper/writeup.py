"""What is written: tables, claims, figures, the write-up in Markdown and as a page, the README."""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from octarm.errors import OctarmError
from octarm.files import write_files
from octarm.reports import page as report_page
from octarm.reports.statistics import Interval
from paper import figures, tables
from paper.claims import PAGES, TEXTS, Claim, claim, worded, words
from paper.evidence import Evidence
from paper.numbers import in_words, median, rounded, spread
from paper.rules import CLAIMS, QUESTIONS
from paper.tables import Table, all_tables, as_csv, timings

PAGE, TABLES, FIGURES = "report.html", "tables", "figures"
START, END = "<!-- claims -->", "<!-- /claims -->"
_PACKAGES = ("octarm", "numpy", "mujoco", "dm-control")


def all_claims(evidence: Evidence) -> list[Claim]:
    """(a) to (g), and then our own questions of which something was run."""
    cases = [(rule, list(rule(evidence))) for rule in (*CLAIMS, *QUESTIONS)]
    return [claim(rule.__name__, own) for rule, own in cases if own or rule in CLAIMS]


def write_all(evidence: Evidence, out: Path, gains: Path, root: Path | None = None) -> list[Claim]:
    """Writes tables, claims, figures, the write-up and the page into a folder.

    All files in `tables` and `claims.json` are the same whenever the same is run; timings stand
    in `timings.csv`.

    Args:
        evidence: what was run.
        out: folder.
        gains: of the tuned gain sets.
        root: of the checkout, where what the repository shows is to be renewed, too:
            `.readme/paper.*` and the claims in the README.

    Returns:
        The claims.

    Raises:
        OctarmError: if the README has no place for the claims.
        OSError: if something cannot be written.
    """
    claims = all_claims(evidence)
    written = all_tables(evidence, claims, gains)
    drawn = list(figures.pictures(evidence))
    texts = {
        **{f"{TABLES}/{name}.csv": as_csv(table) for name, table in written.items()},
        "timings.csv": as_csv(timings(evidence)),
        "claims.json": as_json(content(evidence, claims, written)),
        "paper.md": markdown(evidence, claims, written, f"{FIGURES}/paper.png"),
        PAGE: page(evidence, claims, drawn[1:], written),
        **{f"{FIGURES}/{one.name}.svg": one.svg for one in drawn},
    }
    files = {out / name: text.encode() for name, text in texts.items()}
    files |= {out / FIGURES / f"{one.name}.png": one.png for one in drawn}
    if root is not None:
        readme, folder = root / "README.md", root / ".readme"
        numbers = content(evidence, claims, written, timings=True)
        files |= {
            readme: with_claims(readme.read_text(encoding="utf-8"), numbers).encode(),
            folder / "paper.json": as_json(numbers).encode(),
            folder / "paper.md": markdown(evidence, claims, written, "paper.png").encode(),
            **{folder / f"{x.name}.png": x.png for x in drawn if x.name in ("paper", "plants")},
        }
    write_files(files)
    return claims


def content(
    evidence: Evidence,
    claims: Sequence[Claim],
    written: Mapping[str, Table],
    *,
    timings: bool = False,
) -> dict[str, Any]:
    """Verdicts and numbers, ready for JSON; with or without what differs from run to run."""
    return {
        "effort": evidence.effort.name,
        "seeds": evidence.effort.seeds,
        "command": words()["command"],
        "claims": [one.to_dict(timings=timings) for one in claims if one.place],
        "questions": [one.to_dict(timings=timings) for one in claims if not one.place],
        **{
            name: _strings(written[name]) if name in written else []
            for name in ("best", "plants", "periods")
        },
        "ranking": [
            {"controller": row[0], "error_with_noise": _triple(row[1]), "error": _triple(row[5])}
            for row in written["ranking"].rows
        ],
    }


def as_json(value: Mapping[str, Any]) -> str:
    """The text of a JSON file."""
    return json.dumps(value, indent=1, ensure_ascii=False) + "\n"


def with_claims(readme: str, numbers: Mapping[str, Any]) -> str:
    """A README with the picture and the claims between its two markers, from what `content` gave.

    Raises:
        OctarmError: if it does not have the two markers, once each and in order.
    """
    before, start, rest = readme.partition(START)
    _, end, after = rest.partition(END)
    if not start or not end or START in rest or END in before + after:
        raise OctarmError(f"the README must have {START} and after it {END}, once each")
    text = _rendered("readme.md", **numbers).strip()
    return f"{before}{START}\n\n{text}\n\n{END}{after}"


def markdown(
    evidence: Evidence, claims: Sequence[Claim], written: Mapping[str, Table], picture: str
) -> str:
    """The write-up."""
    return _rendered(
        "paper.md", picture_file=picture, seeds=evidence.effort.seeds, claims=claims,
        tables=written,
    )  # fmt: skip


def page(
    evidence: Evidence,
    claims: Sequence[Claim],
    pictures: Sequence[figures.Picture],
    written: Mapping[str, Table],
) -> str:
    """The report: one HTML file that needs nothing but itself."""
    return _rendered(
        "paper.html",
        claims=claims,
        pictures=pictures,
        tables={**written, "timings": timings(evidence)},
        layout=_layout,
        numbers=lambda one: Table("", "", ("", "measured"), [(r.name, str(r)) for r in one.rows]),
        seeds=evidence.effort.seeds,
        versions=", ".join(f"{name} {version(name)}" for name in _PACKAGES),
        gains={label: json.dumps(one.gains) for label, one in evidence.variants.items()},
    )


def _layout(table: Table) -> report_page.Table:
    """A table as pages have it; words stand to the left."""
    columns = zip(*table.rows, strict=True)
    kinds = ["left" if any(isinstance(x, str) for x in own) else "" for own in columns]

    def cells(row: Sequence[tables.Entry]) -> list[report_page.Cell]:
        entries = zip(row, kinds, strict=True)
        return [
            report_page.Cell(median(x), [spread(x)] if spread(x) else [], k) for x, k in entries
        ]

    return report_page.Table(cells(table.columns), [cells(row) for row in table.rows])


def _rendered(template: str, **values: Any) -> str:
    texts = words()
    common = {key: texts[key] for key in ("title", "command", "picture", "plants_picture")}
    common |= {"lead": worded(texts["lead"]), "setup": [worded(text) for text in texts["setup"]]}
    templates = PAGES if template.endswith(".html") else TEXTS
    return templates.get_template(template).render(**(common | values)).strip("\n") + "\n"


def _strings(table: Table) -> list[list[str]]:
    """Heads and rows, as the README has them."""
    return [list(table.columns), *([in_words(x) for x in row] for row in table.rows)]


def _triple(entry: tables.Entry) -> list[float | str]:
    values = entry if isinstance(entry, Interval) else (entry,) * 3
    return [rounded(float(x)) for x in values]
