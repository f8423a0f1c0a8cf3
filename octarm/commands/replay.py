"""What `octarm replay` does."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

from octarm.commands.rows import rows_of
from octarm.commands.terminal import note
from octarm.errors import OctarmError, printable
from octarm.recordings import viewer
from octarm.recordings.comparison import write_comparison
from octarm.recordings.recording import write_recording
from octarm.recordings.rrd import last_instant, telling_instant
from octarm.recordings.titles import LONGEST, conditions_of
from octarm.runs import folder as runs

_SWEEP = "manifest.json"  # a folder with it is a sweep
_MOST = 32  # recordings of a sweep that are opened at once


def replay(folders: Sequence[Path], screenshot: Path | None, time: float | None, web: bool) -> None:
    """`octarm replay`: the viewer on runs, or a picture of it."""
    if screenshot is not None and web:
        raise OctarmError("--screenshot and --web exclude each other")
    with _recordings(folders) as files:
        if screenshot is not None:
            _picture(files, screenshot, time)
        elif web:
            viewer.serve(files, lambda url: print(f"open {url}   (Ctrl-C ends it)", flush=True))
        else:
            viewer.open_viewer(files)


def _picture(files: Sequence[Path], screenshot: Path, time: float | None) -> None:
    end = last_instant(files[0])
    time = telling_instant(files[0]) if time is None else time
    if not 0.0 <= time <= end:
        raise OctarmError(f"time is {time:g} s; the run goes from 0 to {end:g} s")
    viewer.screenshot(files[0], screenshot, others=files[1:], time=time)
    print(f"wrote {printable(str(screenshot))}")


@contextlib.contextmanager
def _recordings(folders: Sequence[Path]) -> Generator[list[Path]]:
    """The recordings to open: of one run, of two runs together, or of a sweep."""
    if not 1 <= len(folders) <= 2:
        raise OctarmError(f"{len(folders)} runs are given; replay shows one, or two side by side")
    with tempfile.TemporaryDirectory(prefix="octarm-") as scratch:
        if len(folders) == 2:
            both = Path(scratch) / "comparison.rrd"
            write_comparison(both, *(rows_of(folder) for folder in folders))
            yield [both]
        elif (folders[0] / _SWEEP).is_file():
            yield _of_sweep(folders[0], Path(scratch))
        else:
            yield [_of_run(folders[0], Path(scratch))]


def _of_sweep(folder: Path, scratch: Path) -> list[Path]:
    """The recordings of the episodes of a sweep, the viewer's list of them open."""
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
        name = _episode_name(file.parent.name, description)
        write_recording(listed[-1], trajectory, description, name=name)
    return listed


def _episode_name(folder: str, description: Mapping[str, Any]) -> str:
    """An episode in a few words, such as `worst: pd, noise 40 %`; its folder is ID-REASON."""
    number, _, reason = folder.partition("-")
    what = ", ".join([description["controller"]["name"], *conditions_of(description)])
    return printable(f"{reason or number}: {what}", LONGEST)


def _of_run(folder: Path, scratch: Path) -> Path:
    """The recording of a run; of one that is partial it is made of its arrays."""
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
