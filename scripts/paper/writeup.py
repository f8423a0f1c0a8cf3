"""What is written: tables, claims, figures, the write-up in Markdown and as a page, the README."""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from octarm.errors import OctarmError
from octarm.files import write_files
from paper import figures
from paper.claims import PAGES, TEXTS, Claim, claim, in_words, rounded, worded, words
from paper.evidence import Evidence
from paper.rules import CLAIMS, QUESTIONS
from paper.tables import Table, all_tables, as_csv

PAGE, TABLES, FIGURES = "report.html", "tables", "figures"
PACKAGES = "octarm", "numpy", "mujoco", "dm-control"
START, END = "<!-- claims -->", "<!-- /claims -->"


def all_claims(evidence: Evidence) -> list[Claim]:
    """(a) to (g), and then our own questions of which something was run."""
    cases = [(rule, list(rule(evidence))) for rule in (*CLAIMS, *QUESTIONS)]
    return [claim(rule.__name__, own) for rule, own in cases if own or rule in CLAIMS]


def write_all(evidence: Evidence, out: Path, gains: Path, root: Path | None = None) -> list[Claim]:
    """Writes tables, claims, figures, the write-up and the page into a folder.

    All files in `tables` are the same whenever the same is run, and `claims.json` is but for the
    timings of one claim; `timings.csv` has the others. The tuned gain sets are in the folder
    `gains`. With the `root` of the checkout, what the repository shows is renewed, too:
    `.readme/paper.*`, and the claims in the README. Raises OctarmError if that has no place for
    them, and OSError if writing fails.
    """
    claims = all_claims(evidence)
    tables = all_tables(evidence, gains)
    numbers = content(evidence, claims, tables)
    pictures = list(figures.pictures(evidence))
    said = {"seeds": evidence.effort.seeds, "engine": evidence.effort.engine}
    common: dict[str, Any] = {**said, "claims": claims, "tables": tables}
    common |= {key: worded(words()[key], **said) for key in ("command", "lead")}
    common["setup"] = [worded(text, **said) for text in words()["setup"]]
    page = _rendered(
        "paper.html", **common, pictures=pictures[1:],
        numbers={one.letter: [(row.name, str(row)) for row in one.rows] for one in claims},
        versions=", ".join(f"{name} {version(name)}" for name in PACKAGES),
        gains={label: json.dumps(one.gains) for label, one in evidence.variants.items()},
    )  # fmt: skip
    folders = {"timings": "."}  # of what differs from run to run
    texts = {
        **{f"{folders.get(name, TABLES)}/{name}.csv": as_csv(x) for name, x in tables.items()},
        "claims.json": as_json(numbers),
        "paper.md": _rendered("paper.md", **common, picture_file=f"{FIGURES}/paper.png"),
        PAGE: page,
    }
    files = {out / name: text.encode() for name, text in texts.items()}
    for one in pictures:
        files |= one.files(out / FIGURES)
    if root is not None:
        readme, folder = root / "README.md", root / ".readme"
        text = _rendered("paper.md", **common, picture_file="paper.png")
        files |= {
            readme: with_claims(readme.read_text(encoding="utf-8"), numbers).encode(),
            folder / "paper.json": as_json(numbers).encode(),
            folder / "paper.md": text.encode(),
            **{folder / f"{x.name}.png": x.png for x in pictures if x.name in ("paper", "plants")},
        }
    write_files(files)
    return claims


def content(
    evidence: Evidence, claims: Sequence[Claim], written: Mapping[str, Table]
) -> dict[str, Any]:
    """Verdicts and numbers, ready for JSON."""

    def strings(name: str) -> list[list[str]]:
        rows = [written[name].columns, *written[name].rows] if name in written else []
        return [[*map(in_words, row)] for row in rows]

    return {
        "effort": evidence.effort.name, "seeds": evidence.effort.seeds,
        "engine": evidence.effort.engine,
        "claims": [one.to_dict() for one in claims if one.place],
        "questions": [one.to_dict() for one in claims if not one.place],
        **{name: strings(name) for name in ("best", "plants", "periods")},
        "ranking": [
            {"controller": name, "error_with_noise": [*map(rounded, noisy)],
             "error": [*map(rounded, quiet)]}
            for name, noisy, _, _, _, quiet, *_ in written["ranking"].rows
        ],
    }  # fmt: skip


def as_json(value: Mapping[str, Any]) -> str:
    """The text of a JSON file."""
    return json.dumps(value, indent=1, ensure_ascii=False) + "\n"


def with_claims(readme: str, numbers: Mapping[str, Any]) -> str:
    """A README with the picture and the claims between its two markers, from what `content` gave.

    Raises OctarmError if it does not have the two markers, once each and in order.
    """
    before, start, rest = readme.partition(START)
    _, end, after = rest.partition(END)
    if not start or not end or START in rest or END in before + after:
        raise OctarmError(f"the README must have {START} and after it {END}, once each")
    return f"{before}{START}\n\n{_rendered('readme.md', **numbers).strip()}\n\n{END}{after}"


def _rendered(template: str, **values: Any) -> str:
    """A template of this folder with the texts that all of them share."""
    texts = {key: words()[key] for key in ("title", "picture", "plants_picture")}
    templates = PAGES if template.endswith(".html") else TEXTS
    return templates.get_template(template).render(**texts, **values).strip("\n") + "\n"
