"""A run as a `.rrd` file: the arm in 3D and plots, laid out by a blueprint in the file.

The file can be written while the run goes on; `run.npz` of a run that was killed makes it again.

Whatever has a row at every control instant stands in one entity, `signals`, as one structure of
lists: one set of times for all of them makes the file half as large as one entity for each plot.
Plots pick their lists by name, `.q_bends[]`. Lines at bounds stand in `bounds`, at events, from
the lowest to the highest number of each plot, in `events`. Slowly adapting numbers, in
`adaptation`, and the scene are recorded 60 times a second; signals with a number for each fuzzy
rule, 121 at an instant, as a picture. `run.npz` has every bit of all of it, at every instant.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Generator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.interfaces import Rows
from octarm.recordings.blueprints import Extremes, Plots, blueprint
from octarm.recordings.channels import (
    Channel,
    Phases,
    channels_of,
    coordinates_of,
    disturbances_of,
    has_energy,
    has_sliding,
)
from octarm.recordings.heat_map import HeatMap
from octarm.recordings.rrd import Path, rerun_errors, rrd_file, structures, times
from octarm.recordings.scene import DRAWN, Scene
from octarm.recordings.shapes import drawable
from octarm.recordings.words import events_of, notes_of, title_of
from octarm.simulation.trajectory import BLOCK, Trajectory

_FRAME_RATE = 60.0  # of the 3D scene [Hz]
_FIRST_PICTURE = 2000  # rows, after which numbers of rules are drawn in a viewer that follows
_PROPERTIES = ("seed", "duration", "timestep", "control_period", "status", "digest", "command")
_TABLES = ("controller", "parameters", "nominal", "reference", "disturbances", "metrics")
_COLORS = {  # of the phases and of how a run ends: red, green, blue, opacity
    "running": 0x3E5C76FF,
    "reaching": 0xE0A030FF,
    "sliding": 0x48A06AFF,
    "free": 0x3E5C76FF,
    "saturated": 0xE05A4EFF,
    "diverged": 0xE03A3AFF,
    "interrupted": 0x8A6FBFFF,
}


def write_recording(
    path: Path, trajectory: Trajectory, description: Mapping[str, Any], *, name: str = ""
) -> None:
    """Writes a run of one arm as a rerun recording, whole or not at all, into a folder that exists.

    The timeline is `t` [s]. Every signal of the controller is recorded and plotted. Of what
    `run.json` holds, the description, `parameters` are needed. One of several recordings, of which
    the viewer keeps the list open, has a name; else it has the title of the run.

    Raises OctarmError if the trajectory has no rows, the parameters are not those of one such arm,
    or rerun does not take the data or is switched off by RERUN=off, OSError if the file cannot be
    written.
    """
    if len(trajectory) == 0:
        raise OctarmError("there is nothing to record: the trajectory has no rows")
    disturbed = bool(trajectory.disturbance.any() or description.get("disturbances"))
    # One of several has a layout of its own; the viewer takes no other signs in such a name.
    application = re.sub(r"[^\w .:-]", "", name, flags=re.ASCII).strip()[:60] or "octarm"
    with rrd_file(path, application) as stream:
        recording = RunRecording(stream, path, description, disturbed=disturbed, name=name)
        recording.add_all(trajectory)
        recording.finish(description)


@contextlib.contextmanager
def run_recording(path: Path, description: Mapping[str, Any]) -> Generator[RunRecording]:
    """A recording to be written while the run goes on; see `RunRecording` and `rrd_file`."""
    with rrd_file(path) as stream:
        yield RunRecording(stream, path, description)


class RunRecording:
    """Logs a run to a stream: `add` rows in their order, then `finish`.

    Attributes:
        channels: what the run holds; empty before the first rows.
        events: what happened, in words, by the entities of `EVENTS` that the finished recording
            has.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        path: Path,
        description: Mapping[str, Any],
        *,
        disturbed: bool | None = None,
        name: str = "",
        root: str = "",
        following: bool = False,
    ) -> None:
        """Starts the recording of the run that is announced; the path is for error messages.

        The disturbances' force is recorded if it is `disturbed`; if None, if any are listed. With a
        root, an entity with a slash at its end, everything stands below it, and there is neither a
        layout nor a name. A viewer that is `following` the rows as they come needs a layout from
        the beginning, and is not waited for for long. Raises OctarmError if the parameters are not
        those of one arm, or a disturbance is unknown.
        """
        parameters = ArmParameters.from_dict(description["parameters"])
        if parameters.batch_shape:
            raise OctarmError("the parameters must be those of one arm")
        self._stream, self._path, self._name, self._root = stream, path, name, root
        self._description, self._following = description, following
        self._patience = 5.0 if following else 3600.0  # [s]
        self._coordinates = coordinates_of(description)
        disturbances = disturbances_of(description)
        self._disturbed = bool(disturbances) if disturbed is None else disturbed
        finer = description.get("plant") is not None
        self.scene = Scene(parameters, disturbances, disturbed=self._disturbed, finer=finer)
        self.channels: dict[str, Channel] = {}
        self.events: dict[str, str] = {}
        self._extremes: dict[str, tuple[float, float]] = {}
        self._heat_maps: dict[str, HeatMap] = {}
        self._lanes: set[str] = set()
        self._coming = events_of(description)
        self._count, self._stride, self._next_picture = 0, 1, _FIRST_PICTURE
        self._start = self._end = self._planned = 0.0
        self._last: tuple[float, float] | None = None  # t and V

    @np.errstate(all="ignore")  # a diverged arm may hold anything
    def add(self, rows: Rows, layer: np.ndarray | None = None) -> None:
        """Records further rows, which are on disk afterwards.

        The layer phi, shape (2N,) [m/s], [rad/s], that is given with the first rows counts. Raises
        OctarmError if the rows are not those of such an arm, or rerun does not take them.
        """
        if rows["q"].shape[1:] != (len(self._coordinates.names),):
            raise OctarmError("the parameters must be those of an arm with the rows' modules")
        with rerun_errors(self._path):
            first, t = not self._count, rows["t"]
            if first:
                self._begin(rows, layer)
            frames = np.arange(self._count, self._count + len(t)) % self._stride == 0
            self._log_signals(rows, frames)
            frames &= drawable(rows["q"]) & drawable(rows["q_d"])
            if frames.any():
                drawn = {x: rows[x][frames] for x in DRAWN if x in rows}
                for entity, columns in self.scene.frames(drawn).items():
                    self._send(entity, drawn["t"], columns)
            for lane, changes in self._phases.changes(rows).items():
                self._log_state(lane, [(float(t[row]), phase) for row, phase in changes])
            while self._coming and self._coming[0][0] <= t[-1]:
                at, lane, text = self._coming.pop(0)
                self._log_state(lane, [(at, text)])
            self._count, self._end = self._count + len(t), float(t[-1])
            if self._following and first:
                known = {"status": "running", **self._description, "duration": self._planned}
                self._describe(known)
                self._lay_out(known, None)
            if self._following and self._count >= self._next_picture:
                self._next_picture = 4 * self._count
                self._draw_rules()
            # It bounds the memory that waits to be written or sent, and raises errors.
            self._stream.flush(timeout_sec=self._patience)

    def add_all(self, run: Trajectory) -> None:
        """Records a whole run block by block; raises what `add` does."""
        arrays = dict(run.arrays())
        for k in range(0, len(run), BLOCK):
            self.add({name: x[k : k + BLOCK] for name, x in arrays.items()}, run.layer)

    @np.errstate(all="ignore")
    def finish(self, description: Mapping[str, Any]) -> None:
        """Records what is known when the run is over; `description` is now complete."""
        status = str(description.get("status", "ok"))
        with rerun_errors(self._path):
            self._describe(description)
            self._draw_rules()
            self._log_bounds(self._end)
            if status != "ok":
                self._log_state("run", [(self._start, "running"), (self._end, status)])
            self._log_events(status)
            short = status != "ok" or self._end < 0.9 * self._planned
            duration = self._end if short else self._planned
            self._lay_out({**description, "duration": duration}, self._extremes)
            if self._following:
                self._stream.flush(timeout_sec=self._patience)

    def plots(self, end: float, extremes: Extremes | None = None) -> Plots:
        """Plots of the run from 0 to `end` [s], see `Plots`."""
        return Plots(self.channels, end, self._root, self.events, extremes)

    def _begin(self, rows: Rows, layer: np.ndarray | None) -> None:
        """Logs what the first rows tell, and what stays the same."""
        t, names = rows["t"], self._coordinates.names
        self.channels = channels_of(rows, self._description, layer, disturbed=self._disturbed)
        bounds = [c.bound if (c := self.channels.get(name)) else None for name in ("s", "tau")]
        self._phases = Phases(names, *(bound and bound.values for bound in bounds))
        if len(t) > 1:
            rate = (len(t) - 1) / float(t[-1] - t[0])
            self._stride = max(1, round(rate / _FRAME_RATE))
        self._planned = float(self._description.get("duration", t[-1]))
        self._start = float(t[0])
        rules = [channel for channel in self.channels.values() if channel.kind == "rules"]
        self._heat_maps = {channel.name: HeatMap(channel, len(names)) for channel in rules}
        if rules:
            self._log("heat/now", rr.LineStrips2D.from_fields(colors=0xFFFFFFFF, radii=0.8))
        for entity, look in self.scene.looks().items():
            self._log(entity, look)
        self._log_bounds(self._start)

    def _lay_out(self, description: Mapping[str, Any], extremes: Extremes | None) -> None:
        if not self._root:
            lanes = sum(not lane.startswith("each/") for lane in self._lanes)
            plots = self.plots(float(description["duration"]), extremes)
            kind = {"listed": bool(self._name), "following": self._following}
            self._stream.send_blueprint(blueprint(self.scene, plots, description, lanes, **kind))

    def _log_signals(self, rows: Rows, frames: np.ndarray) -> None:
        """Everything with a row at an instant; slow numbers only at the frames."""
        t = rows["t"]
        full: dict[str, np.ndarray] = {}
        slow: dict[str, np.ndarray] = {}
        for name, channel in self.channels.items():
            values = channel.values(rows)
            if channel.kind == "rules":
                self._heat_maps[name].add(t, values)
            elif channel.entity == "adaptation":
                slow |= channel.columns(values[frames])
            else:
                full |= channel.columns(values)
        if has_energy(self.channels):
            full |= self._energy_rate(rows)
        for column, values in (full | slow).items():
            known = values[np.isfinite(values)]
            if known.size:
                plot = column.replace("q_d_", "q_")  # both are in one plot
                ends = (float(known.min()), float(known.max()), *self._extremes.get(plot, ()))
                self._extremes[plot] = min(ends), max(ends)
        self._send("signals", t, structures(full, "signals"))
        if slow and frames.any():
            self._send("adaptation", t[frames], structures(slow, "adaptation"))

    def _log_events(self, status: str) -> None:
        """A line across each plot at each event: from its lowest number to its highest one."""
        coming = [(at, text) for at, _, text in events_of(self._description) if text]
        marks = {
            "begins": [(at, text) for at, text in coming if self._start < at <= self._end],
            "ends": [] if status == "ok" else [(self._end, status)],
        }
        for kind, events in marks.items():
            if events:
                words = {text for _, text in events}
                self.events[kind] = words.pop() if len(words) == 1 else "a disturbance begins"
                at, rows = np.repeat([at for at, _ in events], 3), dict[str, np.ndarray]()
                for plot, ends in self._extremes.items():
                    line = np.tile([*ends, np.nan], len(events))  # it ends at what is no number
                    rows[plot] = line
                    if plot.startswith("q_"):
                        rows[plot.replace("q_", "q_d_")] = line
                self._send(f"events/{kind}", at, structures(rows, "events"))

    def _energy_rate(self, rows: Rows) -> dict[str, np.ndarray]:
        """The rate of V, and its bound by (42) if the model were exact: s^T robust part [mW]."""
        t, V = rows["t"], self.channels["V"].values(rows)[:, 0]
        t_0, V_0 = self._last or (t[0], V[0])
        self._last = float(t[-1]), float(V[-1])
        dt = np.diff(t, prepend=t_0)
        rate = np.diff(V, prepend=V_0) / np.where(dt > 0.0, dt, np.nan)
        columns = {"V_rate": (1e3 * rate).astype(np.float32)}
        if has_sliding(self.channels):
            s, robust = (self.channels[name].values(rows) for name in ("s", "switching"))
            columns["V_claim"] = (1e3 * np.sum(s * robust, axis=1)).astype(np.float32)
        return columns

    def _draw_rules(self) -> None:
        """The heat maps so far; later ones take the place of earlier ones."""
        for name, heat_map in self._heat_maps.items():
            for part, look in heat_map.looks().items():
                self._log(f"heat/{name}/{part}", look)
        if self._heat_maps:
            self._send("heat/now", *next(iter(self._heat_maps.values())).cursor())

    def _log_state(self, lane: str, changes: Sequence[tuple[float, str]]) -> None:
        """Changes of a lane of the state timeline at times [s]."""
        entity = f"states/{lane}"
        if lane not in self._lanes:
            self._lanes.add(lane)
            names, colors = list(_COLORS), list(_COLORS.values())
            self._log(entity, rr.StateConfiguration(values=names, labels=names, colors=colors))
        t, states = zip(*changes, strict=True)
        self._send(entity, np.array(t), rr.StateChange.columns(state=list(states)))

    def _log_bounds(self, at: float) -> None:
        """The bounds of channels, which are lines from the first instant to the last."""
        for name, channel in self.channels.items():
            if channel.bound is not None:
                lines = {part or "all": channel.lines(part)[None] for part in channel.parts}
                self._send(f"bounds/{name}", np.array([at]), structures(lines, "bounds"))

    def _describe(self, description: Mapping[str, Any]) -> None:
        """The run's title, its properties, and its pages of text."""
        if not self._root:
            self._stream.send_recording_name(self._name or title_of(description))
            known = {name: description[name] for name in _PROPERTIES if name in description}
            tables = {name: description[name] for name in _TABLES if name in description}
            known |= {name: json.dumps(table, default=str) for name, table in tables.items()}
            if known:
                self._stream.send_property("run", rr.AnyValues(**known))
        for entity, text in notes_of(description).items():
            self._log(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def _log(self, entity: str, look: Any) -> None:
        self._stream.log(self._root + entity, look, static=True)

    def _send(self, entity: str, t: np.ndarray, columns: Any) -> None:
        self._stream.send_columns(self._root + entity, times(t), columns)
