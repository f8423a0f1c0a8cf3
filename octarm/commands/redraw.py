"""What the commands do that draw a run again from its arrays: record, plot, video."""

from __future__ import annotations

import sys
from pathlib import Path

from octarm.errors import printable
from octarm.runs import folder as runs


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


def rows_of(folder: Path) -> runs.Run:
    """The arrays of a run, as far as there are any, and its description.

    Raises:
        OctarmError: if there are none.
    """
    trajectory, description = runs.map_run(folder)
    if description["status"] == runs.RUNNING:
        say_partial(float(trajectory.t[-1]))
        ended = {"status": trajectory.status, "message": trajectory.message}
        return runs.Run(trajectory, {**description, **ended})
    return runs.Run(trajectory, description)


def say_partial(end: float) -> None:
    """Says on stderr that a run ends early, at a time [s]."""
    print(
        "octarm: the run is partial: it is still going on or was killed, and reaches to "
        f"t = {end:.6g} s",
        file=sys.stderr,
    )
