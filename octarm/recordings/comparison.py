"""Runs beside each other: in what they differ, how their errors do, and all in one recording."""

from __future__ import annotations

import itertools
import math
import string
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from octarm.arm.parameters import PARAMETERS
from octarm.errors import OctarmError
from octarm.recordings.blueprints import Layout, Plots, reach
from octarm.recordings.recording import RunRecording
from octarm.recordings.rrd import Path, rerun_errors, rrd_file, structures, times
from octarm.recordings.words import in_words, markdown_table, title_of, units_of
from octarm.runs.description import USUAL
from octarm.simulation.trajectory import Trajectory

# What is not part of a run's task: two laws may differ in it and still be ranked.
_OF_THE_LAW = ("controller", "gain ", "model's ", "version ", "timestep", "control_period", "code ")
_SETTINGS = (
    "duration", "timestep", "control_period", "actuation", "integrator", "engine", "seed",
    "spawn_key", *USUAL,
)  # fmt: skip
_SECONDS = ("duration", "settle", "timestep", "control_period")  # those with this unit

# The arrays of a run of one arm, and what `run.json` holds.
Run = tuple[Trajectory, Mapping[str, Any]]


class Contrast(NamedTuple):
    """Something in which runs differ, with its unit if that is known, and in words for each run.

    Runs that differ in something `of_the_task`, in what a controller has to do rather than in how
    it does it, cannot be ranked by their errors.
    """

    name: str
    values: Sequence[str]
    of_the_task: bool


class Compared:
    """Runs beside each other, in words; `run.json` of each is given.

    Attributes:
        names: A, B and so on.
        ranked: whether they had the same to do, so that one can be better than another.
        verdict: one sentence on that.
    """

    def __init__(self, descriptions: Sequence[Mapping[str, Any]]) -> None:
        self.names = labels(len(descriptions))
        self.titles = [title_of(description) for description in descriptions]
        self.differences = differences(descriptions)
        self.ranked = not any(each.of_the_task for each in self.differences)
        self.verdict = verdict(self.differences)


def differences(descriptions: Sequence[Mapping[str, Any]]) -> list[Contrast]:
    """In what runs differ, whose `run.json` is given; gains only where the controller is the same.

    The seed belongs to the task where there are disturbances, which draw from it.
    """
    tables = [dict(_aspects(description)) for description in descriptions]
    differing: list[Contrast] = []
    for name in dict.fromkeys(name for table in tables for name in table):
        values = [table.get(name) for table in tables]
        law = name.startswith("gain ") and any(d.name == "controller" for d in differing)
        if law or all(value == values[0] for value in values):
            continue
        texts = [in_words(value) for value in values]
        if len(set(texts)) < len(set(map(repr, values))):  # digits that are not printed
            texts = ["–" if value is None else str(value) for value in values]
        task = not name.startswith(_OF_THE_LAW)
        if name in ("seed", "spawn_key"):
            task = any(each.get("disturbances") or "start" in each for each in descriptions)
        differing.append(Contrast(name.replace("_", " ") + _unit(name), texts, task))
    return differing


def verdict(differing: Sequence[Contrast]) -> str:
    """One sentence on whether runs with these differences can be ranked."""
    task = [difference.name for difference in differing if difference.of_the_task]
    if task:
        return f"Not ranked: the runs differ in what they had to do ({', '.join(task)})."
    names = ", ".join(difference.name for difference in differing) or "nothing that is recorded"
    return f"The runs had the same to do; they differ in {names}."


def labels(count: int) -> list[str]:
    """Names for so many runs: A to Z, then AA, AB and so on."""
    words = (map("".join, itertools.product(string.ascii_uppercase, repeat=n)) for n in (1, 2, 3))
    return list(itertools.islice(itertools.chain.from_iterable(words), count))


def _unit(name: str) -> str:
    """The unit of a setting, or of a parameter of the arm or of its model, in brackets."""
    whose, _, parameter = name.partition(" ")
    known = whose in ("arm's", "model's") and parameter in PARAMETERS
    unit = PARAMETERS[parameter].unit if known else "s" if name in _SECONDS else ""
    return unit and f" [{unit}]"


def _aspects(description: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """What a run was made of, by name."""
    controller = description.get("controller", {})
    yield "controller", controller.get("name")
    if (status := description.get("status", "ok")) not in ("ok", "diverged"):
        yield "end", status  # of a run that is there in part
    code = description.get("code", {})
    for entry in description.get("disturbances", []):
        units = {name: f" [{unit}]" for name, unit in units_of(entry, code).items() if unit}
        asked = {k + units.get(k, ""): x for k, x in entry["asked"].items() if x is not None}
        yield f"disturbance {entry['name']}", asked
    for key, value in description.get("reference", {}).items():
        yield "reference" if key == "name" else f"reference's {key}", value
    plant: Mapping[str, Any] = description.get("plant", {})
    for key in ("modules", "layout", "sensing"):
        yield f"plant's {key}", plant.get(key)
    for key in _SETTINGS:
        yield key, description.get(key, USUAL.get(key))
    for name, value in controller.get("gains", {}).items():
        yield f"gain {name.rstrip('_')}", value
    for whose, table in (("model's", "nominal"), ("arm's", "parameters")):
        for name, value in description.get(table, {}).items():
            yield f"{whose} {name}", value
    for name, each in description.get("code", {}).items():
        kind = "" if each["kind"] in ("controller", "metric") else f"{each['kind']} "
        parts = each["path"], f"SHA-256 {each['sha256'][:12]}", each.get("distribution")
        yield f"{kind}code of {name}", ", ".join(filter(None, parts))
    for name, value in description.get("versions", {}).items():
        yield f"version of {name}", value


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

    These are instants of the first one up to the end of the shorter one, shape (T,) [s], and |e| of
    the first minus |e| of the second, shape (T, 2N) [m], [rad].
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
        runs = "\n".join(map("- {}: {}".format, self.names, self.titles))
        rows = [[each.name, *each.values] for each in self.differences]
        table = markdown_table(["", *self.names], rows)
        return f"# What differs\n\n{self.verdict}\n\n{runs}\n\n{table}"

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
