"""What of one run goes into a recording: the arm, its signals, states, bounds and pages of text.

What has a row a control instant stands in one entity, `signals`, as one structure of lists: one
set of times for all of them makes the file half as large as an entity a plot would. Plots pick
their lists by name, `.q_bends[]`. What adapts, in `adaptation`, and the scene are recorded 60 times
a second; what has a number a rule, as a picture.

An adaptive controller reports 121 numbers at an instant. With q, q_d and tau that is 11 MB for
10 s at 1 kHz, which do not compress, for every bit is new; without the rules it is 4 MB still. So
not everything is recorded with all its bits, see `octarm.recordings.channels`, and the scene is
rounded to what can be seen. `run.npz` has all of it, with every bit, at every instant.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from octarm.arm.mjcf import coordinate_names
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.recordings import states
from octarm.recordings.blueprints import blueprint
from octarm.recordings.channels import Channel, bound_lines, bounds_of, channels_of, values_of
from octarm.recordings.heat_map import HeatMap
from octarm.recordings.notes import notes_of, title_of
from octarm.recordings.recorded_scene import Scene
from octarm.recordings.scene import drawable
from octarm.simulation.trajectory import Trajectory

_FRAME_RATE = 60.0  # of the 3D scene [Hz]
_FIRST_PICTURE = 20_000  # rows, after which numbers of rules are drawn although the run goes on
_KNOWN = ("seed", "duration", "timestep", "control_period", "status", "digest", "command")
_TABLES = ("controller", "parameters", "nominal", "reference", "disturbances", "metrics")


class RecordedRun:
    """Logs a run to a stream: `add` rows in their order, then `finish`.

    Attributes:
        scene: the arm.
        channels: what the run holds; empty before the first rows.
        bounds: of channels, see `octarm.recordings.channels.bounds_of`.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        description: Mapping[str, Any],
        *,
        disturbed: bool | None = None,
        root: str = "",
    ) -> None:
        """A run as `description` announces it.

        Args:
            stream: where it goes.
            description: what `run.json` will hold, as far as it is known.
            disturbed: whether the disturbances' force is recorded; by the description if None.
            root: entity, with a slash at its end, below which everything stands. With one there is
                no blueprint, and the recording is not named after the run.

        Raises:
            ValueError: if the parameters are not those of one arm.
        """
        self._parameters = ArmParameters.from_dict(description["parameters"])
        if self._parameters.batch_shape:
            raise OctarmError("the parameters must be those of one arm")
        self._stream, self._description, self._root = stream, description, root
        listed = description.get("disturbances", [])
        self._disturbed = bool(listed) if disturbed is None else disturbed
        self.scene = Scene(self._parameters, listed)
        self.bounds = bounds_of(description, self._parameters.coordinates)
        self._states = states.States(
            coordinate_names(self._parameters.modules), self.bounds.get("s"), self.bounds.get("tau")
        )
        self._heat_maps: dict[str, HeatMap] = {}
        self.channels: dict[str, Channel] = {}
        self._count, self._stride, self._next_picture = 0, 1, _FIRST_PICTURE
        self._start = self._end = 0.0
        self._planned = 0.0
        self._last: dict[str, np.ndarray] = {}
        self._coming: list[states.Event] = []

    def add(self, rows: Trajectory) -> None:
        """Logs further rows.

        Raises:
            ValueError: if the rows are not those of an arm with these parameters.
        """
        if rows.q.shape[1:] != (self._parameters.coordinates,):
            raise OctarmError("the parameters must be those of an arm with the rows' modules")
        if not self._count:
            self._begin(rows)
        numbers = np.arange(self._count, self._count + len(rows))
        chosen = numbers % self._stride == 0
        self._log_signals(rows, chosen)
        self._log_scene(rows, chosen)
        self._log_states(rows)
        self._count += len(rows)
        self._end = float(rows.t[-1])
        if self._count >= self._next_picture:  # what a killed run leaves has one too
            self._next_picture = 4 * self._count
            self._draw_rules()

    def finish(self, description: Mapping[str, Any]) -> None:
        """Logs what is known when the run is over; `description` is now complete."""
        self._describe(description)
        self._draw_rules()
        self._log_bounds(self._end)
        ended = description.get("status", "ok") != "ok"
        if ended or self._end < 0.9 * self._planned:
            self._lay_out({**description, "duration": self._end})
        if ended:
            ending = (self._end, str(description["status"]))
            self._log_state("run", [(self._start, "running"), ending])

    def _begin(self, rows: Trajectory) -> None:
        self.channels = channels_of(rows, disturbed=self._disturbed)
        if len(rows) > 1:
            rate = (len(rows) - 1) / float(rows.t[-1] - rows.t[0])
            self._stride = max(1, round(rate / _FRAME_RATE))
        for name, channel in self.channels.items():
            if channel.kind == "rules":
                self._heat_maps[name] = HeatMap(channel, self._parameters.coordinates)
        self._planned = float(self._description.get("duration", rows.t[-1]))
        self._start = float(rows.t[0])
        looks = self.scene.looks()
        if self._disturbed:
            looks["world/disturbance"] = self.scene.disturbance_look()
        for entity, look in looks.items():
            self._stream.log(self._root + entity, look, static=True)
        announced = {"status": "running", **self._description, "duration": self._planned}
        self._lay_out(announced)
        self._describe(announced)
        self._log_bounds(self._start)
        self._coming = states.events(self._description.get("disturbances", []))

    def _lay_out(self, description: Mapping[str, Any]) -> None:
        if not self._root:
            coming = {event.lane for event in states.events(description.get("disturbances", []))}
            lanes = ("switching" in self.channels) + ("tau" in self.bounds) + len(coming)
            lanes += description.get("status", "ok") not in ("ok", "running")
            layout = blueprint(self.scene, self.channels, self.bounds, description, lanes)
            self._stream.send_blueprint(layout)

    def _log_signals(self, rows: Trajectory, chosen: np.ndarray) -> None:
        """Everything with a row an instant; what is slow only at the chosen ones."""
        values = values_of(rows, disturbed=self._disturbed)
        full: dict[str, np.ndarray] = {}
        slow: dict[str, np.ndarray] = {}
        for name, channel in self.channels.items():
            if channel.kind == "rules":
                self._heat_maps[name].add(rows.t, values[name])
            elif channel.entity == "adaptation":
                slow |= channel.fields(values[name][chosen])
            else:
                full |= channel.fields(values[name])
        self._send("signals", rows.t, full | self._derived(rows))
        if slow and chosen.any():
            self._send("adaptation", rows.t[chosen], slow)

    def _derived(self, rows: Trajectory) -> dict[str, np.ndarray]:
        """The rate of V, and its bound by (42) if the model were exact: s^T robust part [W]."""
        if "V" not in self.channels or rows.signals["V"].shape[1:] != (1,):
            return {}
        V, t = rows.signals["V"][:, 0], rows.t
        V_0, t_0 = self._last.get("V", V[:1]), self._last.get("t", t[:1])
        self._last = {"V": V[-1:], "t": t[-1:]}
        dt = np.diff(t, prepend=t_0)
        rate = np.diff(V, prepend=V_0) / np.where(dt > 0.0, dt, np.nan)
        found = {"V_rate": rate.astype(np.float32)}
        parts = [rows.signals.get(name) for name in ("s", "switching")]
        if all(part is not None and part.shape == rows.q.shape for part in parts):
            s, robust = parts
            found["V_claim"] = np.sum(s * robust, axis=1).astype(np.float32)  # pyright: ignore
        return found

    def _log_scene(self, rows: Trajectory, chosen: np.ndarray) -> None:
        chosen = chosen & drawable(rows.q) & drawable(rows.q_d)
        if not chosen.any():
            return
        disturbance = rows.disturbance[chosen] if self._disturbed else None
        moving = self.scene.frames(
            rows.t[chosen], rows.q[chosen], rows.q_d[chosen], rows.tau[chosen], disturbance
        )
        times = _times(rows.t[chosen])
        for entity, columns in moving.items():
            self._stream.send_columns(self._root + entity, times, columns)

    def _draw_rules(self) -> None:
        """The heat maps so far; later ones take the place of earlier ones."""
        for name, heat_map in self._heat_maps.items():
            heat_map.log(self._stream, f"{self._root}heat/{name}")
        for heat_map in list(self._heat_maps.values())[:1]:
            heat_map.log_cursor(self._stream, f"{self._root}heat/now")

    def _log_states(self, rows: Trajectory) -> None:
        for lane, changes in self._states.changes(rows.tau, rows.signals).items():
            self._log_state(lane, [(float(rows.t[row]), state) for row, state in changes])
        while self._coming and self._coming[0].at <= rows.t[-1]:
            event = self._coming.pop(0)
            self._log_state(event.lane, [(event.at, event.state)])

    def _log_state(self, lane: str, changes: list[tuple[float, str]]) -> None:
        """Changes of a lane of the state timeline at times [s]."""
        entity = f"states/{lane}"
        if entity not in self._last:
            self._last[entity] = np.empty(0)
            names = list(states.COLORS)
            colors = [int(color + "FF", 16) for color in states.COLORS.values()]
            style = rr.StateConfiguration(values=names, labels=names, colors=colors)
            self._stream.log(self._root + entity, style, static=True)
        times = _times(np.array([time for time, _ in changes]))
        named = rr.StateChange.columns(state=[state for _, state in changes])
        self._stream.send_columns(self._root + entity, times, named)

    def _log_bounds(self, at: float) -> None:
        """The bounds of channels, which are lines from the first instant to the last."""
        for name, bound in self.bounds.items():
            if name in self.channels:
                parts = ("slides", "bends", "all")
                table = {part: np.array([bound_lines(name, bound, part)]) for part in parts}
                self._send(f"bounds/{name}", np.array([at]), table, "bounds")

    def _send(
        self,
        entity: str,
        t: np.ndarray,
        fields: Mapping[str, np.ndarray],
        component: str = "",
    ) -> None:
        """Rows at times t [s] as one structure of lists, each of shape (T, k)."""
        table = pa.StructArray.from_arrays([_list(x) for x in fields.values()], names=list(fields))
        columns = rr.DynamicArchetype.columns("octarm", components={component or entity: table})
        self._stream.send_columns(self._root + entity, _times(t), columns)

    def _describe(self, description: Mapping[str, Any]) -> None:
        if not self._root:
            self._stream.send_recording_name(title_of(description))
            known = {name: description[name] for name in _KNOWN if name in description}
            for name in _TABLES:
                if name in description:
                    known[name] = json.dumps(description[name], default=str)
            if known:
                self._stream.send_property("run", rr.AnyValues(**known))
        for entity, text in notes_of(description).items():
            document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
            self._stream.log(self._root + entity, document, static=True)


def _times(t: np.ndarray) -> list[rr.TimeColumn]:
    stamps = np.round(t * 1e9).astype("timedelta64[ns]")  # rerun would truncate
    return [rr.TimeColumn("t", duration=stamps)]


def _list(values: np.ndarray) -> pa.Array:
    """Numbers of shape (T,), or lists of numbers of shape (T, k), all of the same length."""
    # Arrow takes the memory as it is; arrays in a file may begin at any byte of it.
    flat = pa.array(np.require(values, requirements=["C", "ALIGNED"]).ravel())
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
