"""What the commands do that draw runs again from their arrays: record, plot, video, compare."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from octarm.errors import OctarmError, printable
from octarm.files import write_files
from octarm.runs import folder as runs

PAGE, RECORDING, FIGURES = "comparison.html", "comparison.rrd", "figures"  # of octarm compare


def record(run: Path, out: Path | None) -> None:
    """`octarm record`: the recording of a run again, from its arrays and its description."""
    from octarm.recordings.recording import write_recording

    trajectory, description = rows_of(run)
    target = out or run / runs.RECORDING
    write_recording(target, trajectory, description)
    if target.resolve() == (run / runs.RECORDING).resolve():
        runs.note_recording(run)
    print(f"wrote {printable(str(target))}")


def plot(run: Path, out: Path) -> None:
    """`octarm plot`: the standard figures of a run."""
    from octarm.reports.run_figures import write_figures

    trajectory, description = rows_of(run)
    for path in write_figures(out, trajectory, description):
        print(f"wrote {printable(str(path))}")


def video(run: Path, out: Path, *, size: tuple[int, int], rate: float, speed: float) -> None:
    """`octarm video`: MuJoCo's picture of a run as a film, `size` its width and height [pixel]."""
    from octarm.recordings.video import write_video

    trajectory, description = rows_of(run)
    write_video(out, trajectory, description, size=size, rate=rate, speed=speed)
    print(f"wrote {printable(str(out))}")


def compare(folders: Sequence[Path], out: Path) -> None:
    """`octarm compare`: runs in one page and one recording."""
    from octarm.recordings.comparison import check_comparable, write_comparison
    from octarm.reports.run_comparison import RunComparison

    if out.exists() and not out.is_dir():
        raise OctarmError(f"{out} is not a folder; choose another --out")
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
    print(f"wrote {printable(str(out))}/  ({PAGE}, {RECORDING}, {FIGURES}/)")


def rows_of(folder: Path) -> runs.Run:
    """The arrays of a run, as far as there are any, and its description.

    Raises OctarmError if there are none.
    """
    trajectory, description = runs.map_run(folder)
    if description["status"] == runs.RUNNING:
        end = float(trajectory.t[-1])
        print(
            "octarm: the run is partial: it is still going on or was killed, and reaches to "
            f"t = {end:.6g} s",
            file=sys.stderr,
        )
        ended = {"status": trajectory.status, "message": trajectory.message}
        return runs.Run(trajectory, {**description, **ended})
    return runs.Run(trajectory, description)
