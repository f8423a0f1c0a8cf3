"""Two runs in one recording, side by side and at the same time, with how their errors differ."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from octarm.errors import OctarmError
from octarm.recordings.blueprints import Curves, plot_view, time_axis, wrapped
from octarm.recordings.notes import title_of
from octarm.recordings.recorded_run import RecordedRun
from octarm.recordings.recorded_scene import module_colors
from octarm.recordings.recording import part_of, recording_errors, rrd_file
from octarm.runs.archive import BLOCK
from octarm.simulation.trajectory import Trajectory


class Run(NamedTuple):
    """A run and what `run.json` says of it."""

    trajectory: Trajectory
    description: Mapping[str, Any]


def write_comparison(path: str | os.PathLike[str], first: Run, second: Run) -> None:
    """Writes two runs as one recording, whole or not at all.

    They share the time. Where the second has no row at an instant of the first, its error is
    interpolated; the difference ends where the shorter run ends.

    Args:
        path: the `.rrd` file; its folder must exist.
        first: shown as A.
        second: shown as B; its arm has as many modules.

    Raises:
        ValueError: if the numbers of modules differ, or a run has no rows.
        OSError: if the file cannot be written.
        RuntimeError: if rerun does not take the data.
    """
    sizes = [run.trajectory.q.shape[1] // 2 for run in (first, second)]
    if sizes[0] != sizes[1]:
        raise OctarmError(
            f"the arms have {sizes[0]} and {sizes[1]} modules; they cannot be compared"
        )
    if not len(first.trajectory) or not len(second.trajectory):
        raise OctarmError("there is nothing to compare: a run has no rows")
    titles = [title_of(run.description) for run in (first, second)]
    with rrd_file(path) as stream, recording_errors(path):
        logged: list[RecordedRun] = []
        for root, run in (("A/", first), ("B/", second)):
            one = RecordedRun(stream, run.description, root=root)
            for k in range(0, len(run.trajectory), BLOCK):
                one.add(part_of(run.trajectory, k, k + BLOCK))
            one.finish(run.description)
            logged.append(one)
        _log_difference(stream, first.trajectory, second.trajectory)
        stream.send_recording_name(f"{titles[0]} against {titles[1]}")
        end = max(float(run.trajectory.t[-1]) for run in (first, second))
        stream.send_blueprint(_blueprint(logged, titles, end, _largest(first, second)))


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


def _log_difference(stream: rr.RecordingStream, first: Trajectory, second: Trajectory) -> None:
    t, larger = difference(first, second)
    n = larger.shape[1] // 2
    for k in range(0, len(t), BLOCK):
        stamps = np.round(t[k : k + BLOCK] * 1e9).astype("timedelta64[ns]")
        parts = [larger[k : k + BLOCK, half] for half in (slice(n), slice(n, None))]
        lists = [pa.FixedSizeListArray.from_arrays(pa.array(part.ravel()), n) for part in parts]
        table = pa.StructArray.from_arrays(lists, names=["slides", "bends"])
        columns = rr.DynamicArchetype.columns("octarm", components={"difference": table})
        stream.send_columns("difference", [rr.TimeColumn("t", duration=stamps)], columns)
        stream.flush(timeout_sec=60.0)


def _largest(first: Run, second: Run) -> dict[str, float]:
    """The largest error of slides and bends in both runs, for equal scales."""
    n = first.trajectory.q.shape[1] // 2
    errors = [np.abs(run.trajectory.error) for run in (first, second)]
    found: dict[str, float] = {}
    for part, half in (("slides", slice(n)), ("bends", slice(n, None))):
        largest = max(float(np.nan_to_num(e[:, half]).max()) for e in errors)
        found[part] = 1.05 * largest if largest < 1e3 else 0.0
    return found


def _blueprint(
    logged: Sequence[RecordedRun], titles: Sequence[str], end: float, largest: Mapping[str, float]
) -> rrb.Blueprint:
    axis = time_axis(end)
    arms = [
        run.scene.view(f"{name}: {title}   pale sheath: desired", origin=f"{name}/world")
        for name, run, title in zip("AB", logged, titles, strict=True)
    ]
    rows = [
        rrb.Horizontal(*_row(logged, part, axis, largest[part]), name=part)
        for part in ("bends", "slides")
    ]
    tabs: list[Any] = [rrb.Vertical(*rows, name="errors")]
    tabs += [rrb.Horizontal(*_inputs(logged, axis), name="inputs")]
    pages = [rrb.TextDocumentView(origin=f"{name}/notes", name=name) for name in "AB"]
    tabs.append(rrb.Horizontal(*pages, name="notes"))
    return wrapped(
        rrb.Vertical(rrb.Horizontal(*arms), rrb.Tabs(*tabs, active_tab=0), row_shares=[1.15, 1])
    )


def _row(logged: Sequence[RecordedRun], part: str, axis: rrb.TimeAxis, largest: float) -> list[Any]:
    """The error of A, that of B, and the difference."""
    channel = logged[0].channels["error"]
    names = channel.names[channel.half(part)]
    colors = module_colors(len(names))
    views: list[Any] = []
    for name in "AB":
        curves = Curves(f"{name}/signals", "signals", f".error_{part}[]", names, colors)
        title = f"error of {part} in {name}{channel.unit(part)}"
        views.append(plot_view(title, [curves], axis, legend=name == "A", largest=largest))
    curves = Curves("difference", "difference", f".{part}[]", names, colors)
    title = f"|error| of A less that of B, {part}{channel.unit(part)}   above 0: B is nearer"
    return [*views, plot_view(title, [curves], axis)]


def _inputs(logged: Sequence[RecordedRun], axis: rrb.TimeAxis) -> list[Any]:
    names = logged[0].channels["tau"].names
    n = len(names) // 2
    colors = np.repeat(module_colors(n), 2, axis=0) * np.tile([[1.0], [0.6]], (n, 1))
    return [
        plot_view(
            f"input forces of {name} [N]",
            [Curves(f"{name}/signals", "signals", ".tau[]", names, colors)],
            axis,
            legend=True,
        )
        for name in "AB"
    ]
