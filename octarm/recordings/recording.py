"""A run as a `.rrd` file: the arm in 3D and plots, laid out by a blueprint in the file.

The file can be written while the run goes on, and can be read up to the last block if the process
is killed.

Whatever has a row at every control instant stands in one entity, `signals`, as one structure of
lists: one set of times for all of them makes the file half as large as one entity for each plot.
Plots pick their lists by name, `.q_bends[]`. Lines at bounds stand in `bounds`, at events, from
the lowest to the highest number of each plot, in `events`. Slowly adapting numbers, in
`adaptation`, and the scene are recorded 60 times a second; signals with a number for each fuzzy
rule as a picture.

An adaptive controller reports 121 numbers at an instant. With q, q_d and tau that is 11 MB for
10 s at 1 kHz, which do not compress, for every bit is new; without the rules it is 4 MB still. So
not everything is recorded with all its bits, see `octarm.recordings.channels`, and the scene is
rounded to what can be seen. `run.npz` has all of it, with every bit, at every instant.
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
from octarm.recordings.blueprints import blueprint
from octarm.recordings.channels import (
    REACHING,
    Channel,
    Phases,
    channels_of,
    coordinates_of,
    disturbances_of,
    has_energy,
    has_sliding,
)
from octarm.recordings.heat_map import HeatMap
from octarm.recordings.notes import notes_of
from octarm.recordings.rrd import Path, rerun_errors, rrd_file, structures, times
from octarm.recordings.scene import DRAWN, Scene
from octarm.recordings.shapes import drawable
from octarm.recordings.titles import events_of, title_of
from octarm.simulation.trajectory import BLOCK, Trajectory

_FRAME_RATE = 60.0  # of the 3D scene [Hz]
_FIRST_PICTURE = 20_000  # rows, after which numbers of rules are drawn although the run goes on
_PROPERTIES = ("seed", "duration", "timestep", "control_period", "status", "digest", "command")
_TABLES = ("controller", "parameters", "nominal", "reference", "disturbances", "metrics")
_COLORS = {  # of the phases and of how a run ends, as hexadecimal red, green, blue, opacity
    "running": "3E5C76FF",
    "reaching": "E0A030FF",
    "sliding": "48A06AFF",
    "free": "3E5C76FF",
    "saturated": "E05A4EFF",
    "diverged": "E03A3AFF",
    "interrupted": "8A6FBFFF",
}


def write_recording(
    path: Path, trajectory: Trajectory, description: Mapping[str, Any], *, name: str = ""
) -> None:
    """Writes a run as a rerun recording, whole or not at all.

    The timeline is `t` [s]. Every signal of the controller is recorded and plotted, whatever its
    name and width.

    Args:
        path: the `.rrd` file; its folder must exist.
        trajectory: the run of one arm of N modules.
        description: what `run.json` holds; `parameters` are needed, the rest may be missing.
        name: of one of several recordings, for which the viewer keeps its list of them open; the
            title of the run when empty.

    Raises:
        OctarmError: if the trajectory has no rows, the parameters are not those of one such arm,
            or rerun does not take the data or is switched off by RERUN=off.
        OSError: if the file cannot be written.
    """
    if len(trajectory) == 0:
        raise OctarmError("there is nothing to record: the trajectory has no rows")
    disturbed = bool(trajectory.disturbance.any() or description.get("disturbances"))
    end = float(trajectory.t[-1])
    short = end < 0.9 * float(description.get("duration", end))
    announced = {**description, "duration": end} if short else description
    # One of several has a layout of its own; the viewer takes no other signs in such a name.
    application = re.sub(r"[^\w .:-]", "", name, flags=re.ASCII).strip()[:60] or "octarm"
    with rrd_file(path, application) as stream:
        recording = RunRecording(stream, path, announced, disturbed=disturbed, live=False)
        recording.name = name
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
        scene: the arm.
        channels: what the run holds; empty before the first rows.
        largest: the largest size of each number of a channel so far, by the name of the channel.
        name: of one of several recordings; empty if it is alone.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        path: Path,
        description: Mapping[str, Any],
        *,
        disturbed: bool | None = None,
        root: str = "",
        live: bool = True,
        following: bool = False,
    ) -> None:
        """Starts the recording of the run that is announced.

        Args:
            stream: where it goes.
            path: of the file, for error messages.
            description: what `run.json` will hold, as far as it is known.
            disturbed: whether the disturbances' force is recorded; if None, if any are listed.
            root: entity, with a slash at its end, below which everything stands. With one there is
                no blueprint, and the recording is not named after the run.
            live: whether it may be looked at before it is finished, so that it needs a layout from
                the beginning; the final one knows what there is to see.
            following: whether a viewer shows the rows as they come, and is not waited for for long.

        Raises:
            OctarmError: if the parameters are not those of one arm, or a disturbance is unknown.
        """
        parameters = ArmParameters.from_dict(description["parameters"])
        if parameters.batch_shape:
            raise OctarmError("the parameters must be those of one arm")
        self._stream, self._path, self._root, self._live = stream, path, root, live
        self._description, self._following = description, following
        self._coordinates = coordinates_of(description)
        disturbances = disturbances_of(description)
        self._disturbed = bool(disturbances) if disturbed is None else disturbed
        self.scene = Scene(
            parameters,
            list(disturbances.values()),
            disturbed=self._disturbed,
            finer=description.get("plant") is not None,
        )
        self.channels: dict[str, Channel] = {}
        self.largest: dict[str, np.ndarray] = {}
        self._extremes: dict[str, np.ndarray] = {}  # of each plot, in the units of the recording
        self.name = ""
        self._heat_maps: dict[str, HeatMap] = {}
        self._lanes: set[str] = set()
        self._late: set[str] = set()  # phases that name what is not sliding
        self._events = events_of(description)
        self._marks: dict[str, list[tuple[float, str]]] = {"begins": [], "ends": []}
        self._eventful = len({name for _, name, _ in self._events})
        self._count, self._stride = 0, 1
        self._next_picture = _FIRST_PICTURE // 10 if following else _FIRST_PICTURE
        self._start = self._end = self._planned = 0.0
        self._last: tuple[float, float] | None = None  # t and V

    @np.errstate(all="ignore")  # a diverged arm may hold anything
    def add(self, rows: Rows, layer: np.ndarray | None = None) -> None:
        """Records further rows, which are on disk afterwards.

        Args:
            rows: see `octarm.interfaces.Rows`.
            layer: half width phi of the boundary layer, shape (2N,) [m/s], [rad/s], if the
                controller has one; the one given with the first rows counts.

        Raises:
            OctarmError: if the rows are not those of an arm with these parameters, or rerun does
                not take them.
        """
        if rows["q"].shape[1:] != (len(self._coordinates.names),):
            raise OctarmError("the parameters must be those of an arm with the rows' modules")
        with rerun_errors(self._path):
            if not self._count:
                self._begin(rows, layer)
            t, count = rows["t"], self._count + len(rows["t"])
            frames = np.arange(self._count, count) % self._stride == 0
            self._log_signals(rows, frames)
            frames &= drawable(rows["q"]) & drawable(rows["q_d"])
            if frames.any():
                drawn = {x: rows[x][frames] for x in DRAWN if x in rows}
                for entity, columns in self.scene.frames(drawn).items():
                    self._send(entity, drawn["t"], columns)
            for lane, changes in self._phases.changes(rows).items():
                self._log_state(lane, [(float(t[row]), phase) for row, phase in changes])
            while self._events and self._events[0][0] <= t[-1]:
                at, lane, text = self._events.pop(0)
                self._log_state(lane, [(at, text)])
                if text and at > self._start:
                    self._marks["begins"].append((at, text))
            self._count, self._end = count, float(t[-1])
            if self._count >= self._next_picture:  # what a killed run leaves has one too
                self._next_picture = 4 * self._count
                self._draw_rules()
            self._flush()

    def _flush(self) -> None:
        """Bounds the memory that waits to be written or sent, and raises errors."""
        self._stream.flush(timeout_sec=5.0 if self._following else 3600.0)

    def add_all(self, run: Trajectory) -> None:
        """Records a whole run block by block; raises what `add` does."""
        arrays = dict(run.arrays())
        for k in range(0, len(run), BLOCK):
            self.add({name: x[k : k + BLOCK] for name, x in arrays.items()}, run.layer)

    @np.errstate(all="ignore")
    def finish(self, description: Mapping[str, Any]) -> None:
        """Records what is known when the run is over; `description` is now complete."""
        with rerun_errors(self._path):
            self._describe(description)
            self._draw_rules()
            self._log_bounds(self._end)
            ended = description.get("status", "ok") != "ok"
            short = ended or self._end < 0.9 * self._planned
            duration = self._end if short else self._planned
            if ended:
                ending = (self._end, str(description["status"]))
                self._log_state("run", [(self._start, "running"), ending])
                self._marks["ends"].append(ending)
            self._log_events()
            self._lay_out({**description, "duration": duration}, self.largest)
            if self._following:
                self._flush()

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
        announced = {"status": "running", **self._description, "duration": self._planned}
        if self._live:
            self._lay_out(announced)
        self._describe(announced)
        self._log_bounds(self._start)

    def _lay_out(
        self, description: Mapping[str, Any], largest: Mapping[str, np.ndarray] | None = None
    ) -> None:
        if not self._root:
            lanes = has_sliding(self.channels) + (self.channels["tau"].bound is not None)
            lanes += self._eventful + (description.get("status", "ok") not in ("ok", "running"))
            layout = blueprint(
                self.scene,
                self.channels,
                description,
                lanes,
                largest,
                None if largest is None else self.events(),
                None if largest is None else self._extremes,
                listed=bool(self.name),
                following=self._following,
            )
            self._stream.send_blueprint(layout)

    def _log_signals(self, rows: Rows, frames: np.ndarray) -> None:
        """Everything with a row at an instant; slow numbers only at the frames."""
        t = rows["t"]
        full: dict[str, np.ndarray] = {}
        slow: dict[str, np.ndarray] = {}
        for name, channel in self.channels.items():
            values = channel.values(rows)
            sizes = np.nan_to_num(np.abs(values), posinf=np.inf).max(axis=0)
            self.largest[name] = np.maximum(self.largest.get(name, 0.0), sizes)
            if channel.kind == "rules":
                self._heat_maps[name].add(t, values)
            elif channel.entity == "adaptation":
                slow |= channel.columns(values[frames])
            else:
                full |= channel.columns(values)
        if has_energy(self.channels):
            full |= self._energy_rate(rows)
        for column, values in (full | slow).items():
            self._extend(column.replace("q_d_", "q_"), values)
        self._send("signals", t, structures(full, "signals"))
        if slow and frames.any():
            self._send("adaptation", t[frames], structures(slow, "adaptation"))

    def _extend(self, plot: str, values: np.ndarray) -> None:
        """Takes further numbers into account of which the plot with this first column has to do."""
        values = values[np.isfinite(values)]
        if values.size:
            known = self._extremes.get(plot, values)
            low, high = min(np.min(values), np.min(known)), max(np.max(values), np.max(known))
            self._extremes[plot] = np.array([low, high], dtype=float)

    def events(self) -> dict[str, str]:
        """What happened, by the entities of `EVENTS` that the recording has, in words."""
        words = {kind: dict.fromkeys(text for _, text in x) for kind, x in self._marks.items() if x}
        return {
            kind: next(iter(texts)) if len(texts) == 1 else "a disturbance begins"
            for kind, texts in words.items()
        }

    def _log_events(self) -> None:
        """A line across each plot at each event: from its lowest number to its highest one."""
        for kind in self.events():
            at = np.array([t for t, _ in self._marks[kind]])
            rows: dict[str, np.ndarray] = {}
            for plot, (low, high) in self._extremes.items():
                rows[plot] = np.tile([low, high, np.nan], len(at))  # the line ends at what is none
                if plot.startswith("q_"):
                    rows[plot.replace("q_", "q_d_")] = rows[plot]
            if rows:
                self._send(f"events/{kind}", np.repeat(at, 3), structures(rows, "events"))

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
        for heat_map in list(self._heat_maps.values())[:1]:
            self._send("heat/now", *heat_map.cursor())

    def _log_state(self, lane: str, changes: Sequence[tuple[float, str]]) -> None:
        """Changes of a lane of the state timeline at times [s]."""
        entity = f"states/{lane}"
        if lane not in self._lanes:
            self._lanes.add(lane)
            self._look_of_states(entity, _COLORS)
        t, states = zip(*changes, strict=True)
        if new := {text for text in states if text.startswith(f"{REACHING}: ")} - self._late:
            self._late |= new  # each of them is amber
            late = dict.fromkeys(sorted(self._late), _COLORS[REACHING])
            self._look_of_states(entity, _COLORS | late)
        self._send(entity, np.array(t), rr.StateChange.columns(state=list(states)))

    def _look_of_states(self, entity: str, looks: Mapping[str, str]) -> None:
        names, colors = list(looks), [int(color, 16) for color in looks.values()]
        self._log(entity, rr.StateConfiguration(values=names, labels=names, colors=colors))

    def _log_bounds(self, at: float) -> None:
        """The bounds of channels, which are lines from the first instant to the last."""
        for name, channel in self.channels.items():
            if (bound := channel.bound) is not None:
                lines = {
                    part or "all": channel.recorded(part)[0] * np.array([bound.lines(where)])
                    for part, where in channel.parts.items()
                }
                self._send(f"bounds/{name}", np.array([at]), structures(lines, "bounds"))

    def _describe(self, description: Mapping[str, Any]) -> None:
        """The run's title, its properties, and its pages of text."""
        if not self._root:
            self._stream.send_recording_name(self.name or title_of(description))
            known = {name: description[name] for name in _PROPERTIES if name in description}
            for name in _TABLES:
                if name in description:
                    known[name] = json.dumps(description[name], default=str)
            if known:
                self._stream.send_property("run", rr.AnyValues(**known))
        for entity, text in notes_of(description).items():
            self._log(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def _log(self, entity: str, look: Any) -> None:
        self._stream.log(self._root + entity, look, static=True)

    def _send(self, entity: str, t: np.ndarray, columns: Any) -> None:
        self._stream.send_columns(self._root + entity, times(t), columns)
