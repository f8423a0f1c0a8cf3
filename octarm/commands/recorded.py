"""The commands on recorded runs: replay, compare, record, plot, video."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from octarm.commands import kinds
from octarm.commands.terminal import note, surviving_output
from octarm.errors import OctarmError, printable

if TYPE_CHECKING:
    from octarm.runs.folder import Run


def replay(
    *runs: Annotated[Path, kinds.RUN],
    screenshot: Annotated[Path | None, kinds.file(".png")] = None,
    time: Annotated[float | None, kinds.S] = None,
    web: bool = False,
    force: bool = False,
) -> kinds.Work:
    """Open recorded runs in the rerun viewer.

    One run folder, two of them side by side with the difference of their errors, or a sweep folder,
    of which the recorded episodes are opened.

    Args:
        runs: run folder, two run folders, or a sweep folder
        screenshot: write a picture of the viewer instead of opening it; no display
        time: time shown in the picture [s]; that of the largest bend, or the
            end of a run that diverged, when not given
        web: serve the viewer to a browser on this machine; no network
        force: replace a picture that is there

    Examples:
      octarm replay runs/my-run
      octarm replay runs/smc runs/afsmc
      octarm replay runs/my-run --screenshot picture.png --time 4.5
    """
    kinds.check_free(force, screenshot)
    kinds.check_runs(*(run for run in runs if not run.is_file()), sweeps=True)
    from octarm.commands import replay as work

    job = partial(work.replay, runs, screenshot, time, web)
    return surviving_output(job) if screenshot else job


def compare(
    *runs: Annotated[Path, kinds.RUN],
    out: Annotated[Path, kinds.DIR] = Path("comparison"),
    force: bool = False,
) -> kinds.Work:
    """Put two runs or more into one page and one recording.

    First in what they differ, then their metrics and their errors over time. Runs that had
    different things to do (another arm, reference, duration, disturbance or seed) are not ranked.
    Writes a folder: comparison.html, which needs nothing beside itself, and comparison.rrd.

    Args:
        runs: run folders; the first one is A, the next B
        out: folder to write
        force: replace a comparison that is there

    Examples:
      octarm compare runs/smc runs/afsmc
      octarm compare runs/a runs/b runs/c --out comparison-of-gains
    """
    kinds.check_free(force, out / "comparison.html", out / "comparison.rrd")
    kinds.check_runs(*runs)
    if len(runs) < 2:
        raise OctarmError(f"octarm compare needs two runs or more; {len(runs)} given")
    from octarm.commands import replay as work

    return surviving_output(work.compare, runs, out)


def record(
    run: Annotated[Path, kinds.RUN],
    /,
    *,
    out: Annotated[Path | None, kinds.file(".rrd")] = None,
    force: bool = False,
) -> kinds.Work:
    """Rebuild the recording of a run from its arrays.

    The recording is made of run.npz and run.json alone.

    Args:
        run: run folder
        out: recording to write; that of the run is made anew when not given
        force: replace another file that is there

    Examples:
      octarm record runs/my-run
    """
    kinds.check_free(force, out)
    kinds.check_runs(run)
    from octarm.recordings.recording import write_recording
    from octarm.runs import folder as runs

    def job() -> None:
        trajectory, description = rows_of(run)
        target = out or run / runs.RECORDING
        write_recording(target, trajectory, description)
        if target.resolve() == (run / runs.RECORDING).resolve():
            runs.note_recording(run)
        print(f"wrote {printable(str(target))}")

    return surviving_output(job)


def plot(
    run: Annotated[Path, kinds.RUN],
    /,
    *,
    out: Annotated[Path | None, kinds.DIR] = None,
    force: bool = False,
) -> kinds.Work:
    """Draw the standard figures of a run, as PNG and SVG.

    Args:
        run: run folder
        out: folder to write to; RUN-figures when not given
        force: replace figures that are there

    Examples:
      octarm plot runs/my-run --out figures
    """
    out = out or _sibling(run, "-figures")
    kinds.check_free(force, out / "tracking.png")
    kinds.check_runs(run)
    from octarm.reports.run_figures import write_figures

    def job() -> None:
        for path in write_figures(out, *rows_of(run)):
            print(f"wrote {printable(str(path))}")

    return surviving_output(job)


def video(
    run: Annotated[Path, kinds.RUN],
    /,
    *,
    out: Annotated[Path | None, kinds.file(".mp4")] = None,
    width: Annotated[int, kinds.N] = 960,
    height: Annotated[int, kinds.N] = 720,
    rate: Annotated[float, kinds.HZ] = 30.0,
    speed: Annotated[float, kinds.X] = 1.0,
    force: bool = False,
) -> kinds.Work:
    """Film a run with MuJoCo's renderer.

    It needs no display, but one of the libraries EGL and OSMesa; octarm doctor tells.

    Args:
        run: run folder
        out: film to write; RUN.mp4 when not given
        width: width [pixel]
        height: height [pixel]
        rate: pictures a second [Hz]
        speed: how much faster than real time the film runs
        force: replace a film that is there

    Examples:
      octarm video runs/my-run --out run.mp4 --speed 0.5
    """
    out = out or _sibling(run, ".mp4")
    kinds.check_free(force, out)
    kinds.check_runs(run)
    from octarm.recordings.video import choose_renderer, write_video

    choose_renderer()  # before anything imports MuJoCo

    def job() -> None:
        write_video(out, *rows_of(run), size=(width, height), rate=rate, speed=speed)
        print(f"wrote {printable(str(out))}")

    return surviving_output(job)


def _sibling(folder: Path, ending: str) -> Path:
    """A name like the run folder's; the folder itself holds the run and nothing else."""
    return folder.resolve().with_name(folder.resolve().name + ending)


def rows_of(folder: Path) -> Run:
    """The arrays of a run, whole or partial, and its description; raises OctarmError."""
    from octarm.runs import folder as runs

    trajectory, description = runs.map_run(folder)
    if description["status"] == runs.RUNNING:
        end = f"t = {trajectory.t[-1]:.6g} s"
        note(f"the run is partial: it is still going on or was killed, and reaches to {end}")
        ended = {"status": trajectory.status, "message": trajectory.message}
        description = {**description, **ended}
    return runs.Run(trajectory, description)
