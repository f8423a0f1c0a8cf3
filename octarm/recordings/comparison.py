"""Two runs in one recording, side by side and at the same time, and how their errors differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from octarm.errors import OctarmError
from octarm.recordings.blueprints import Layout, Plots
from octarm.recordings.recording import RunRecording
from octarm.recordings.rrd import Path, rerun_errors, rrd_file, structures, times
from octarm.recordings.titles import title_of
from octarm.simulation.trajectory import Trajectory

# The arrays of a run of one arm, and what `run.json` holds.
Run = tuple[Trajectory, Mapping[str, Any]]


@np.errstate(all="ignore")  # a diverged arm may hold anything
def write_comparison(path: Path, first: Run, second: Run) -> None:
    """Writes two runs as one recording, whole or not at all; they appear as A and B.

    They share the time. Where the second has no row at an instant of the first, its error is
    interpolated; the difference ends where the shorter run ends.

    Raises:
        OctarmError: if the numbers of modules differ, a run has no rows, or rerun does not take
            the data.
        OSError: if the file cannot be written.
    """
    runs = [trajectory for trajectory, _ in (first, second)]
    titles = [title_of(description) for _, description in (first, second)]
    a, b = (run.q.shape[1] // 2 for run in runs)
    if a != b:
        raise OctarmError(f"the arms have {a} and {b} modules; they cannot be compared")
    if not all(map(len, runs)):
        raise OctarmError("there is nothing to compare: a run has no rows")
    with rrd_file(path) as stream, rerun_errors(path):
        recordings: list[RunRecording] = []
        for name, (run, description) in (("A", first), ("B", second)):
            recording = RunRecording(stream, path, description, root=f"{name}/")
            recording.add_all(run)
            recording.finish(description)
            recordings.append(recording)
        t, larger = difference(*runs)
        parts = recordings[0].channels["error"].parts
        table = structures({name: larger[:, part] for name, part in parts.items()}, "difference")
        stream.send_columns("difference", times(t), table)
        stream.send_recording_name(f"{titles[0]} against {titles[1]}")
        stream.send_blueprint(_blueprint(recordings, titles, runs))


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
    recordings: Sequence[RunRecording], titles: Sequence[str], runs: Sequence[Trajectory]
) -> rrb.Blueprint:
    end = max(float(run.t[-1]) for run in runs)
    channels = recordings[0].channels
    error, both = channels["error"], Plots(channels, end)
    arms: list[Any] = []
    inputs: list[Any] = []
    pages: list[Any] = []
    rows: dict[str, list[Any]] = {part: [] for part in error.parts}
    for name, recording, title in zip("AB", recordings, titles, strict=True):
        plots = Plots(recording.channels, end, f"{name}/")
        arms.append(recording.scene.view(f"{name}: {title}   pale sheath: desired", f"{name}/"))
        pages.append(rrb.TextDocumentView(origin=f"{name}/notes", name=name))
        forces = f"input forces of {name}{channels['tau'].units['']}"
        inputs.append(plots.view(forces, plots.curves("tau"), legend=True))
        for part, row in rows.items():
            sizes = [np.nan_to_num(np.abs(run.error[:, error.parts[part]])).max() for run in runs]
            largest = float(max(sizes))
            row.append(
                plots.view(
                    f"error of {part} in {name}{error.units[part]}",
                    plots.curves("error", part),
                    legend=name == "A",
                    largest=1.05 * largest if largest < 1e3 else None,
                )
            )
    for part, row in rows.items():
        text = f"|error| of A less that of B, {part}{error.units[part]}   above 0: B is nearer"
        curves = both.curves("error", part)._replace(entity="difference", path=f".{part}[]")
        row.append(both.view(text, curves))
    errors = [rrb.Horizontal(*row, name=part) for part, row in rows.items()]
    tabs = [
        rrb.Vertical(*errors, name="errors"),
        rrb.Horizontal(*inputs, name="inputs"),
        rrb.Horizontal(*pages, name="notes"),
    ]
    return Layout(
        rrb.Vertical(rrb.Horizontal(*arms), rrb.Tabs(*tabs, active_tab=0), row_shares=[1.15, 1])
    )
