"""What `octarm replay` and `octarm compare` do."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from octarm.commands.recorded import rows_of
from octarm.commands.terminal import note
from octarm.errors import OctarmError, printable
from octarm.files import write_files
from octarm.recordings import viewer
from octarm.recordings.comparison import check_comparable, write_comparison
from octarm.recordings.recording import write_recording
from octarm.recordings.rrd import last_instant, telling_instant
from octarm.recordings.words import LONGEST, conditions_of
from octarm.runs import folder as runs

_SWEEP = "manifest.json"  # a folder with it is a sweep
_PAGE, _COMPARISON, _FIGURES = "comparison.html", "comparison.rrd", "figures"
_MOST = 32  # recordings of a sweep that are opened at once


def replay(folders: Sequence[Path], screenshot: Path | None, time: float | None, web: bool) -> None:
    """`octarm replay`: the viewer on runs, or a picture of it."""
    if screenshot is not None and web:
        raise OctarmError("--screenshot and --web exclude each other")
    with tempfile.TemporaryDirectory(prefix="octarm-") as scratch:
        files = _recordings(folders, Path(scratch))
        if screenshot is not None:
            end = last_instant(files[0])
            time = telling_instant(files[0]) if time is None else time
            if not 0.0 <= time <= end:
                raise OctarmError(f"time is {time:g} s; the run goes from 0 to {end:g} s")
            viewer.screenshot(files[0], screenshot, others=files[1:], time=time)
            print(f"wrote {printable(str(screenshot))}")
        elif web:
            viewer.serve(files, lambda url: print(f"open {url}   (Ctrl-C ends it)", flush=True))
        else:
            viewer.open_viewer(files)


def _recordings(folders: Sequence[Path], scratch: Path) -> list[Path]:
    """The recordings to open: of one run, of two runs together, or of a sweep."""
    if not 1 <= len(folders) <= 2:
        raise OctarmError(f"{len(folders)} runs are given; replay shows one, or two side by side")
    if len(folders) == 2:
        write_comparison(scratch / _COMPARISON, *map(rows_of, folders))
        return [scratch / _COMPARISON]
    if (folders[0] / _SWEEP).is_file():
        return _of_sweep(folders[0], scratch)
    return [_of_run(folders[0], scratch)]


def _of_sweep(folder: Path, scratch: Path) -> list[Path]:
    """The recordings of the episodes of a sweep."""
    files = sorted(folder.rglob("*.rrd"))
    if not files:
        raise OctarmError(
            f"{folder} is a sweep without recorded episodes; see [record] in its spec"
        )
    if len(files) > _MOST:
        note(f"the first {_MOST} of {len(files)} recordings are shown")
    if len(files) == 1:
        return files
    listed: list[Path] = []
    for file in files[:_MOST]:
        listed.append(scratch / f"{len(listed)}-{file.parent.name}.rrd")
        trajectory, description = rows_of(file.parent)
        number, _, reason = file.parent.name.partition("-")
        what = ", ".join([description["controller"]["name"], *conditions_of(description)])
        name = printable(f"{reason or number}: {what}", LONGEST)
        write_recording(listed[-1], trajectory, description, name=name)
    return listed


def _of_run(folder: Path, scratch: Path) -> Path:
    """The recording of a run; of one that has not ended it is made of its arrays."""
    if folder.suffix == ".rrd" and folder.is_file():
        return folder
    description = runs.read_description(folder)  # raises when this is no run
    recording = folder / runs.RECORDING
    if description["status"] == runs.RUNNING:
        recording = scratch / runs.RECORDING
        write_recording(recording, *rows_of(folder))
    elif not recording.is_file():
        raise OctarmError(f"{folder} has no recording {runs.RECORDING}; octarm record writes one")
    elif description["status"] == "interrupted":
        message = printable(description.get("message", ""), 200)
        note(f"the run is partial: it was {message}")
    return recording


def compare(folders: Sequence[Path], out: Path) -> None:
    """`octarm compare`: runs in one page and one recording."""
    from octarm.reports.run_comparison import RunComparison  # takes a second to import

    compared = [rows_of(folder) for folder in folders]
    check_comparable([run.trajectory for run in compared])
    comparison = RunComparison(compared)
    pictures = list(comparison.pictures())
    text = comparison.page([str(folder) for folder in folders], pictures)
    contents = {out / _PAGE: text.encode(errors="backslashreplace")}
    for picture in pictures:
        contents |= picture.files(out / _FIGURES)
    write_files(contents)
    write_comparison(out / _COMPARISON, *compared)
    titles = zip(comparison.names, folders, comparison.titles, compared, strict=True)
    for name, folder, title, run in titles:
        tip = run.metrics.get("tip_rms_error")
        rms = "" if tip is None else f"; tip: {1e3 * tip:.3g} mm rms"
        print(f"{name}: {printable(str(folder))}, {title}{rms}")
    for each in comparison.differences:
        print(f"  {each.name}: {'; '.join(map(printable, each.values))}")
    print(printable(comparison.verdict, 2000))
    for line in comparison.ranking():
        print(f"  {printable(line)}")
    print(f"wrote {printable(str(out))}/  ({_PAGE}, {_COMPARISON}, {_FIGURES}/)")
