"""Writing what came out: tables, claims, figures, the page, and what the repository shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from octarm.files import whole_file, write_text
from paper import figures, results, tracking, writeup
from paper.claims import Claim
from paper.drawing import Picture
from paper.evidence import Evidence
from paper.page import page
from paper.tables import Table, as_csv
from paper.verdicts import claims

PAGE, CLAIMS, TABLES, FIGURES = "report.html", "claims.json", "tables", "figures"


def write(evidence: Evidence, out: Path, gains: Path) -> list[Claim]:
    """Writes tables, claims, figures, the write-up and the page into a folder.

    All files in `tables` and `claims.json` are the same whenever the same is run; timings stand
    in `timings.csv`.

    Args:
        evidence: what was run.
        out: folder.
        gains: of the tuned gain sets.

    Returns:
        The claims.

    Raises:
        OSError: if something cannot be written.
    """
    found, shown = claims(evidence), results.tables(evidence, gains)
    drawn = [
        tracking.headline(evidence),
        *tracking.pictures(evidence),
        *figures.pictures(evidence),
    ]
    for folder in (TABLES, FIGURES):
        (out / folder).mkdir(parents=True, exist_ok=True)
    for table in [*shown, _rows(found)]:
        write_text(out / TABLES / f"{table.name}.csv", as_csv(table))
    timings = results.timings(evidence)
    write_text(out / "timings.csv", as_csv(timings))
    for picture in drawn:
        _write_picture(picture, out / FIGURES)
    write_text(out / CLAIMS, writeup.as_json(writeup.content(evidence, found, shown)))
    text = writeup.markdown(evidence, found, shown, f"{FIGURES}/paper.png")
    write_text(out / "paper.md", text)
    write_text(out / PAGE, page(evidence, found, drawn[1:], [*shown, timings]))
    return found


def publish(evidence: Evidence, out: Path, gains: Path, root: Path) -> None:
    """Writes what the repository shows: `.readme/paper.*` and the claims in the README.

    Args:
        evidence: what was run.
        out: folder that `write` has written.
        gains: of the tuned gain sets.
        root: of the checkout.

    Raises:
        ValueError: if the README has no place for the claims.
        OSError: if something cannot be written.
    """
    found, shown = claims(evidence), results.tables(evidence, gains)
    written = writeup.content(evidence, found, shown, timings=True)
    folder = root / ".readme"
    readme = root / "README.md"
    text = writeup.with_claims(readme.read_text(encoding="utf-8"), written)
    write_text(folder / "paper.json", writeup.as_json(written))
    write_text(folder / "paper.md", writeup.markdown(evidence, found, shown, "paper.png"))
    with whole_file(folder / "paper.png") as part:
        part.write_bytes((out / FIGURES / "paper.png").read_bytes())
    write_text(readme, text)


def _rows(found: Sequence[Claim]) -> Table:
    """All numbers of all claims but timings."""
    rows = [
        (c.letter, str(c.verdict), c.condition, row.name, row.value, row.low, row.high, row.unit)
        for c in found
        for row in c.rows
        if not row.varies
    ]
    head = ("claim", "verdict", "condition", "measured", "value", "low", "high", "unit")
    return Table("claims", "All numbers of the claims.", head, tuple(rows))


def _write_picture(picture: Picture, folder: Path) -> None:
    write_text(folder / f"{picture.name}.svg", picture.svg)
    with whole_file(folder / f"{picture.name}.png") as part:
        part.write_bytes(picture.png)
