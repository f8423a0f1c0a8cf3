"""What the commands do that look at runs: replay, record, plot, video."""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from octarm.errors import ExitCode, OctarmError
from octarm.runs import folder as runs
from octarm.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from octarm.options.recordings import Plot, Record, Replay, Video

_SWEEP = "manifest.json"  # a folder with it is a sweep
_MOST = 32  # recordings of a sweep that are opened at once


def replay(options: Replay) -> int:
    """`octarm replay`: the viewer on runs, or a picture of it."""
    from octarm.recordings import viewer

    if options.screenshot is not None and options.web:
        raise OctarmError("--screenshot and --web exclude each other")
    if options.screenshot is not None and options.screenshot.suffix != ".png":
        raise OctarmError(f"screenshot is {str(options.screenshot)!r}; its name must end in .png")
    with _recordings(options.runs) as files:
        if options.screenshot is not None:
            return _picture(options, files)
        if options.web:
            viewer.serve(files, lambda url: print(f"open {url}   (Ctrl-C ends it)", flush=True))
        else:
            viewer.open_viewer(files)
    return ExitCode.FINE


def record(options: Record) -> int:
    """`octarm record`: the recording of a run again, from its arrays and its description."""
    from octarm.recordings.recording import write_recording

    trajectory, description = _rows_of(options.run)
    target = options.run / runs.RECORDING if options.out is None else options.out
    write_recording(target, trajectory, description)
    print(f"wrote {target}")
    return ExitCode.FINE


def plot(options: Plot) -> int:
    """`octarm plot`: the standard figures of a run."""
    from octarm.recordings.plots import write_figures

    trajectory, description = _rows_of(options.run)
    folder = _beside(options.run, "-figures") if options.out is None else options.out
    for path in write_figures(folder, trajectory, description):
        print(f"wrote {path}")
    return ExitCode.FINE


def video(options: Video) -> int:
    """`octarm video`: MuJoCo's picture of a run as a film."""
    from octarm.recordings.video import write_video

    trajectory, description = _rows_of(options.run)
    target = _beside(options.run, ".mp4") if options.out is None else options.out
    write_video(
        target, trajectory, description, size=(options.width, options.height),
        rate=options.rate, speed=options.speed,
    )  # fmt: skip
    print(f"wrote {target}")
    return ExitCode.FINE


def _beside(folder: Path, ending: str) -> Path:
    """A name like the run folder's; the folder itself holds the run and nothing else."""
    return folder.resolve().with_name(folder.resolve().name + ending)


def _picture(options: Replay, files: list[Path]) -> int:
    from octarm.recordings import viewer

    assert options.screenshot is not None
    end = viewer.end_of(files[0])
    shown = 0.5 * end if options.time is None else options.time
    if not 0.0 <= shown <= end:
        raise OctarmError(f"time is {shown:g} s; the run goes from 0 to {end:g} s")
    viewer.screenshot(files[0], options.screenshot, others=files[1:], time=shown)
    print(f"wrote {options.screenshot}")
    return ExitCode.FINE


@contextlib.contextmanager
def _recordings(folders: tuple[Path, ...]) -> Generator[list[Path]]:
    """The recordings to open: of one run, of two runs together, or of a sweep.

    Raises:
        ValueError: if there is nothing to replay.
    """
    if not 1 <= len(folders) <= 2:
        raise OctarmError(f"{len(folders)} runs are given; replay shows one, or two side by side")
    with tempfile.TemporaryDirectory(prefix="octarm-") as scratch:
        if len(folders) == 2:
            from octarm.recordings.comparison import write_comparison

            both = Path(scratch) / "comparison.rrd"
            write_comparison(both, *(_rows_of(folder) for folder in folders))
            yield [both]
        elif (folders[0] / _SWEEP).is_file():
            yield _of_sweep(folders[0], Path(scratch))
        else:
            yield [_of_run(folders[0], Path(scratch))]


def _of_sweep(folder: Path, scratch: Path) -> list[Path]:
    """The recordings of the episodes that were chosen, the viewer's list of them open."""
    from octarm.recordings import viewer

    files = sorted(folder.rglob("*.rrd"))
    if not files:
        raise OctarmError(
            f"{folder} is a sweep without recorded episodes; see [record] in its spec"
        )
    if len(files) > _MOST:
        print(f"octarm: the first {_MOST} of {len(files)} recordings are shown", file=sys.stderr)
    if len(files) == 1:
        return files
    shown: list[Path] = []
    for file in files[:_MOST]:
        shown.append(scratch / f"{len(shown)}-{file.parent.name}.rrd")
        viewer.listed(file, shown[-1])
    return shown


def _of_run(folder: Path, scratch: Path) -> Path:
    """The recording of a run; what can be read of it if the run is partial."""
    from octarm.recordings import viewer

    if folder.suffix == ".rrd" and folder.is_file():
        return folder
    description = runs.read_description(folder)  # raises when this is no run
    recording, partial = folder / runs.RECORDING, folder / runs.PARTIAL
    if recording.is_file():
        if description["status"] == "interrupted":
            print(f"octarm: the run is partial: it was {description['message']}", file=sys.stderr)
        elif description["status"] == runs.RUNNING:
            _say_partial(viewer.end_of(recording))
        return recording
    if not partial.is_file():
        raise OctarmError(f"{folder} has no recording {runs.RECORDING}; octarm record writes one")
    rescued = scratch / runs.RECORDING
    viewer.rescue(partial, rescued)
    _say_partial(viewer.end_of(rescued))
    return rescued


def _rows_of(folder: Path) -> tuple[Trajectory, dict[str, Any]]:
    """The arrays of a run, as far as there are any, and its description.

    Raises:
        ValueError: if there are none.
    """
    trajectory, description = runs.map_run(folder)
    if description["status"] == runs.RUNNING:
        _say_partial(float(trajectory.t[-1]))
        ended = {"status": trajectory.status, "message": trajectory.message}
        return trajectory, {**description, **ended}
    return trajectory, description


def _say_partial(end: float) -> None:
    print(
        "octarm: the run is partial: it is still going on or was killed, and reaches to "
        f"t = {end:.6g} s",
        file=sys.stderr,
    )
