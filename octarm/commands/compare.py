"""What `octarm compare` does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from octarm.commands.redraw import rows_of
from octarm.errors import ExitCode, OctarmError, printable
from octarm.files import write_files
from octarm.recordings.comparison import check_comparable, write_comparison
from octarm.reports.run_comparison import RunComparison

PAGE, RECORDING, FIGURES = "comparison.html", "comparison.rrd", "figures"


def compare(folders: Sequence[Path], out: Path) -> int:
    """`octarm compare`: runs in one page and one recording."""
    if len(folders) < 2:
        raise OctarmError(f"octarm compare needs two runs or more; {len(folders)} given")
    if out.exists() and not out.is_dir():
        raise OctarmError(f"{out} is not a folder; choose another --out")
    runs = [rows_of(folder) for folder in folders]
    check_comparable([run.trajectory for run in runs])
    comparison = RunComparison(runs)
    pictures = list(comparison.pictures())
    text = comparison.page([str(folder) for folder in folders], pictures)
    contents = {out / PAGE: text.encode(errors="backslashreplace")}
    for picture in pictures:
        contents[out / FIGURES / f"{picture.name}.svg"] = picture.svg.encode()
        contents[out / FIGURES / f"{picture.name}.png"] = picture.png
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
    print(f"wrote {printable(str(out))}/  ({PAGE}, {RECORDING}, {FIGURES}/)")
    return ExitCode.FINE
