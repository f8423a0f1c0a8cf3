"""Two runs in one recording, side by side and at the same time, and how their errors differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun.blueprint as rrb

from octarm.errors import OctarmError
from octarm.recordings.blueprints import Curves, Plots, plot_view, time_axis, wrapped
from octarm.recordings.notes import title_of
from octarm.recordings.recording import RunRecording
from octarm.recordings.rrd import Path, rerun_errors, rrd_file, send_table
from octarm.simulation.trajectory import Trajectory


class Run(NamedTuple):
    """A run and what `run.json` says of it."""

    trajectory: Trajectory
    description: Mapping[str, Any]


def write_comparison(path: Path, first: Run, second: Run) -> None:
    """Writes two runs as one recording, whole or not at all.

    They share the time. Where the second has no row at an instant of the first, its error is
    interpolated; the difference ends where the shorter run ends.

    Args:
        path: the `.rrd` file; its folder must exist.
        first: appears as A.
        second: appears as B; its arm has as many modules.

    Raises:
        OctarmError: if the numbers of modules differ, a run has no rows, or rerun does not take
            the data.
        OSError: if the file cannot be written.
    """
    sizes = [run.trajectory.q.shape[1] // 2 for run in (first, second)]
    if sizes[0] != sizes[1]:
        raise OctarmError(
            f"the arms have {sizes[0]} and {sizes[1]} modules; they cannot be compared"
        )
    if not len(first.trajectory) or not len(second.trajectory):
        raise OctarmError("there is nothing to compare: a run has no rows")
    titles = [title_of(run.description) for run in (first, second)]
    with rrd_file(path) as stream, rerun_errors(path):
        recordings: list[RunRecording] = []
        for root, run in (("A/", first), ("B/", second)):
            recording = RunRecording(stream, path, run.description, root=root)
            recording.add_all(run.trajectory)
            recording.finish(run.description)
            recordings.append(recording)
        t, larger = difference(first.trajectory, second.trajectory)
        parts = recordings[0].channels["error"].parts
        columns = {name: larger[:, part] for name, part in parts.items()}
        send_table(stream, "difference", "difference", t, columns)
        stream.send_recording_name(f"{titles[0]} against {titles[1]}")
        ends = [float(run.trajectory.t[-1]) for run in (first, second)]
        errors = [run.trajectory.error for run in (first, second)]
        stream.send_blueprint(_blueprint(recordings, titles, max(ends), errors))


def difference(first: Trajectory, second: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """By how much the error of the first run is larger than that of the second.

    Returns:
        Instants of the first run up to the end of the shorter one, shape (T,) [s], and
        |e| of the first minus |e| of the second, shape (T, 2N) [m], [rad].
    """
    shared = first.t <= second.t[-1]
    t = first.t[shared]
    other: list[np.ndarray] = [np.interp(t, second.t, error) for error in np.abs(second.error).T]
    return t, np.abs(first.error[shared]) - np.stack(other, axis=1)


def _blueprint(
    recordings: Sequence[RunRecording],
    titles: Sequence[str],
    end: float,
    errors: Sequence[np.ndarray],
) -> rrb.Blueprint:
    axis = time_axis(end)
    arms: list[Any] = []
    pages: list[Any] = []
    inputs: list[Any] = []
    error = recordings[0].channels["error"]
    rows: dict[str, list[Any]] = {part: [] for part in error.parts}
    for name, recording, title in zip("AB", recordings, titles, strict=True):
        plots = Plots(recording.channels, axis, root=f"{name}/")
        view = recording.scene.view(
            f"{name}: {title}   pale sheath: desired", origin=f"{name}/world"
        )
        arms.append(view)
        pages.append(rrb.TextDocumentView(origin=f"{name}/notes", name=name))
        forces = f"input forces of {name}{recording.channels['tau'].units['']}"
        inputs.append(plot_view(forces, [plots.curves("tau")], axis, legend=True))
        for part, row in rows.items():
            size = _scale([values[:, error.parts[part]] for values in errors])
            text = f"error of {part} in {name}{error.units[part]}"
            curves = [plots.curves("error", part)]
            row.append(plot_view(text, curves, axis, legend=name == "A", largest=size))
    for part, row in rows.items():
        like = Plots(recordings[0].channels, axis).curves("error", part)
        curves = Curves("difference", "difference", f".{part}[]", like.names, like.colors)
        text = f"|error| of A less that of B, {part}{error.units[part]}   above 0: B is nearer"
        row.append(plot_view(text, [curves], axis))
    tabs = [
        rrb.Vertical(
            *[rrb.Horizontal(*row, name=part) for part, row in rows.items()], name="errors"
        ),
        rrb.Horizontal(*inputs, name="inputs"),
        rrb.Horizontal(*pages, name="notes"),
    ]
    return wrapped(
        rrb.Vertical(rrb.Horizontal(*arms), rrb.Tabs(*tabs, active_tab=0), row_shares=[1.15, 1])
    )


def _scale(errors: Sequence[np.ndarray]) -> float:
    """Range of the plots of these errors, equal for both runs; 0 if the viewer is to choose it."""
    largest = max(float(np.nan_to_num(np.abs(e)).max()) for e in errors)
    return 1.05 * largest if largest < 1e3 else 0.0
