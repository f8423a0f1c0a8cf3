"""Runs in one recording, side by side and at the same time, and how their errors differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from octarm.errors import OctarmError
from octarm.recordings.blueprints import Layout, Plots, reach
from octarm.recordings.notes import markdown_table
from octarm.recordings.recording import RunRecording
from octarm.recordings.rrd import Path, rerun_errors, rrd_file, structures, times
from octarm.recordings.what_differs import Compared
from octarm.simulation.trajectory import Trajectory

# The arrays of a run of one arm, and what `run.json` holds.
Run = tuple[Trajectory, Mapping[str, Any]]


@np.errstate(all="ignore")  # a diverged arm may hold anything
def write_comparison(path: Path, *runs: Run) -> None:
    """Writes two runs or more as one recording, whole or not at all; they appear as A, B and so on.

    They share the time. Where another one has no row at an instant of the first, its error is
    interpolated; the difference ends where the shorter run ends. Raises OctarmError if the numbers
    of modules differ, a run has no rows, or rerun does not take the data, OSError if the file
    cannot be written.
    """
    check_comparable([trajectory for trajectory, _ in runs])
    with rrd_file(path) as stream, rerun_errors(path):
        layout = _Layout(stream, path, runs)
        for entity, (run, _) in zip(layout.entities, runs[1:], strict=True):
            t, larger = difference(runs[0][0], run)
            error = layout.recordings[0].channels["error"]
            lists = {x: error.recorded(x)[0] * larger[:, part] for x, part in error.parts.items()}
            stream.send_columns(entity, times(t), structures(lists, "difference"))
        page = rr.TextDocument(layout.page(), media_type=rr.MediaType.MARKDOWN)
        stream.log("differences", page, static=True)
        stream.send_recording_name(" against ".join(layout.titles))
        stream.send_blueprint(layout.blueprint())


def check_comparable(runs: Sequence[Trajectory]) -> None:
    """Raises OctarmError if arms differ in their numbers of modules, or a run has no rows."""
    modules = list(dict.fromkeys(run.q.shape[1] // 2 for run in runs))
    if len(modules) > 1:
        counts = f"{', '.join(map(str, modules[:-1]))} and {modules[-1]}"
        raise OctarmError(f"the arms have {counts} modules; they cannot be compared")
    if not all(map(len, runs)):
        raise OctarmError("there is nothing to compare: a run has no rows")


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


class _Layout(Compared):
    """How the viewer lays out several runs, which it records: arms, errors, inputs, notes."""

    def __init__(self, stream: rr.RecordingStream, path: Path, runs: Sequence[Run]) -> None:
        super().__init__([description for _, description in runs])
        self.recordings: list[RunRecording] = []
        for name, (run, description) in zip(self.names, runs, strict=True):
            recording = RunRecording(stream, path, description, root=f"{name}/")
            recording.add_all(run)
            recording.finish(description)
            self.recordings.append(recording)
        end = max(float(run.t[-1]) for run, _ in runs)
        self._plots = [recording.plots(end) for recording in self.recordings]
        self._errors = [np.nan_to_num(np.abs(run.error)).max(axis=0) for run, _ in runs]
        # Where the difference of the first run from each other one stands.
        many = len(runs) > 2
        self.entities = [f"difference/{name}" if many else "difference" for name in self.names[1:]]

    def page(self) -> str:
        """In what the runs differ, as Markdown."""
        rows = [[each.name, *each.values] for each in self.differences]
        runs = map("- {}: {}".format, self.names, self.titles)
        heading = f"# What differs\n\n{self.verdict}"
        return "\n\n".join([heading, "\n".join(runs), markdown_table(["", *self.names], rows)])

    def blueprint(self) -> rrb.Blueprint:
        """The layout; all plots of a part have the same range."""
        arms = [
            recording.scene.view(f"{name}: {title}   pale sheath: desired", f"{name}/")
            for name, title, recording in zip(self.names, self.titles, self.recordings, strict=True)
        ]
        inputs = [
            plots.view(f"input forces of {name} [N]", plots.curves("tau"), legend=True)
            for name, plots in zip(self.names, self._plots, strict=True)
        ]
        parts = self.recordings[0].channels["error"].parts
        errors = {part: self._of_errors(part) for part in parts}
        larger = {part: self._of_differences(part) for part in parts}
        if len(arms) == 2:  # one row has room for all
            errors, larger = {part: errors[part] + larger[part] for part in parts}, {}
        pages = [rrb.TextDocumentView(origin=f"{x}/notes", name=x) for x in self.names]
        differing = rrb.TextDocumentView(origin="differences", name="what differs")
        tabs = [differing, _rows("errors", errors), _rows("inputs", {"inputs": inputs})]
        tabs += [_rows("differences of errors", larger)] if larger else []
        tabs += [rrb.Horizontal(*pages, name="notes")]
        columns = math.ceil(math.sqrt(len(arms))) if len(arms) > 3 else len(arms)
        row = rrb.Grid(*arms, grid_columns=columns)
        return Layout(rrb.Vertical(row, rrb.Tabs(*tabs, active_tab=1), row_shares=[0.75, 1]))

    def _of_errors(self, part: str) -> list[Any]:
        """A plot for each run."""
        error = self.recordings[0].channels["error"]
        factor, unit = error.recorded(part)
        largest = factor * float(np.max([sizes[error.parts[part]] for sizes in self._errors]))
        ends = reach(largest) if largest < 1e6 else None
        return [
            plots.view(
                f"error of {part} in {name}{unit}", plots.curves("error", part), ends=ends,
                legend=name == "A",
            )
            for name, plots in zip(self.names, self._plots, strict=True)
        ]  # fmt: skip

    def _of_differences(self, part: str) -> list[Any]:
        """A plot of the difference from each other run, which ranks those alone that it may."""
        plots = Plots(self.recordings[0].channels, self._plots[0].end)
        curves = plots.curves("error", part)._replace(path=f".{part}[]")
        unit, views = plots.channels["error"].recorded(part)[1], list[Any]()
        for name, entity in zip(self.names[1:], self.entities, strict=True):
            end = f"above 0: {name} is nearer" if self.ranked else "not ranked, see what differs"
            text = f"|error| of A less that of {name}, {part}{unit}   {end}"
            views.append(plots.view(text, curves._replace(entity=entity)))
        return views


def _rows(name: str, rows: Mapping[str, Sequence[Any]]) -> Any:
    return rrb.Vertical(*(rrb.Horizontal(*row, name=x) for x, row in rows.items()), name=name)
