"""What `octarm compare` does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from octarm.commands.rows import rows_of
from octarm.errors import printable
from octarm.files import write_files
from octarm.recordings.comparison import check_comparable, write_comparison
from octarm.reports.run_comparison import RunComparison

PAGE, RECORDING, FIGURES = "comparison.html", "comparison.rrd", "figures"


def compare(folders: Sequence[Path], out: Path) -> None:
    """`octarm compare`: runs in one page and one recording."""
    runs = [rows_of(folder) for folder in folders]
    check_comparable([run.trajectory for run in runs])
    comparison = RunComparison(runs)
    pictures = list(comparison.pictures())
    text = comparison.page([str(folder) for folder in folders], pictures)
    contents = {out / PAGE: text.encode(errors="backslashreplace")}
    for picture in pictures:
        contents |= picture.files(out / FIGURES)
    write_files(contents)
    write_comparison(out / RECORDING, *runs)
    titles = zip(comparison.names, folders, comparison.titles, runs, strict=True)
    for name, folder, title, run in titles:
        tip = run.metrics.get("tip_rms_error")
        rms = "" if tip is None else f"; tip: {1e3 * tip:.3g} mm rms"
        print(f"{name}: {printable(str(folder))}, {title}{rms}")
    for each in comparison.differences:
        print(f"  {each.name}: {'; '.join(map(printable, each.values))}")
    print(printable(comparison.verdict, 2000))
    for line in comparison.ranking():
        print(f"  {printable(line)}")
    print(f"wrote {printable(str(out))}/  ({PAGE}, {RECORDING}, {FIGURES}/)")
