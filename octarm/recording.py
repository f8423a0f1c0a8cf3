"""A run as a `.rrd` file: the arm in 3D beside plots, laid out by a blueprint in the file.

The arm is drawn as `octarm.scene` has it; the desired arm is a translucent band just behind.
What belongs to module i has one colour: its backbone, and the plots of s_i, theta_i and their kin.
This is the only module that imports rerun.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.experimental import ViewerClient as ViewerClient  # for octarm.viewer

from octarm.files import piped, whole_file
from octarm.lagrange import positions
from octarm.model import coordinate_names, world_position
from octarm.parameters import ArmParameters
from octarm.scene import plate_quaternions, smooth_arm
from octarm.trajectory import Trajectory

_FRAME_RATE = 60.0  # of the 3D scene [Hz]; signals keep their full rate
_BLOCK = 1000  # rows a chunk: fewer cost space, more cost memory and time to verify
_DRAWABLE = 100.0  # [m], [rad]; a diverging arm beyond it would only spoil the scene
_LEGEND = 8  # series at most that a legend can name

_COLORS = ["FF9F43", "40A9FF", "48C987", "E76EBE", "F1D64A", "9B89FF", "4DD0D0", "FF7864"]
_COLUMN, _PLATE, _BASE, _TRAIL = 0xA5ACB6FF, 0xDEE2E8FF, 0x78808CFF, 0xFF4655FF
_DESIRED = 0x96A5BE5A  # translucent


class _Series(NamedTuple):
    """One entity of scalars, shape (T, k), and where it is plotted."""

    tab: str  # empty for the plots that are always in sight
    view: str
    entity: str
    values: np.ndarray
    names: Sequence[str]
    colors: np.ndarray
    width: float = 1.5


def write_recording(
    path: str | os.PathLike[str],
    trajectory: Trajectory,
    parameters: ArmParameters,
    *,
    title: str,
    notes: str = "",
    properties: Mapping[str, object] | None = None,
) -> None:
    """Writes a run as a rerun recording, whole or not at all.

    The timelines are `t` [s] and `step`, the row of the trajectory. What the controller logged is
    recorded and plotted, whatever the names and widths.

    Args:
        path: the `.rrd` file; its folder must exist.
        trajectory: the run of one arm of N modules.
        parameters: of the true arm; its width is drawn.
        title: name of the recording in the viewer.
        notes: Markdown, shown beside the plots.
        properties: what is known of the run: numbers and texts; the rest is kept as JSON.

    Raises:
        ValueError: if the trajectory has no rows, or the parameters are not those of one such arm.
        OSError: if the file cannot be written.
        RuntimeError: if rerun does not take the data, or is switched off by RERUN=off.
    """
    if len(trajectory) == 0:
        raise ValueError("there is nothing to record: the trajectory has no rows")
    if parameters.batch_shape or trajectory.q.shape[1:] != (parameters.coordinates,):
        raise ValueError("the parameters must be those of one arm with the trajectory's modules")
    if os.environ.get("RERUN", "on").lower() in ("0", "off", "false"):
        raise RuntimeError(f"{path} cannot be recorded: RERUN={os.environ['RERUN']} is set")
    with whole_file(path) as part, _strict_mode():
        stream = rr.RecordingStream(
            "octarm", recording_id=trajectory.digest or None, send_properties=False
        )
        try:
            with piped(part) as name:  # rerun itself would hang for ever on a full disk
                stream.save(name)
                with stream:
                    _describe(stream, title, notes, properties or {})
                    _write(stream, trajectory, float(parameters.width), notes)
        except OSError:
            raise
        except Exception as error:
            reason = (str(error) or type(error).__name__).splitlines()[0]
            raise RuntimeError(f"{path} cannot be recorded: {reason}") from error


@contextlib.contextmanager
def _strict_mode() -> Iterator[None]:
    """Lets rerun raise errors; it would otherwise warn of bad data, and drop it."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


def _describe(
    stream: rr.RecordingStream, title: str, notes: str, properties: Mapping[str, object]
) -> None:
    stream.send_recording_name(title)
    values: dict[str, Any] = {}
    for name, value in properties.items():
        plain = isinstance(value, str | int | float)
        values[name] = value if plain else json.dumps(value, default=str)
    if values:
        stream.send_property("run", rr.AnyValues(**values))
    if notes:
        document = rr.TextDocument(notes, media_type=rr.MediaType.MARKDOWN)
        stream.log("notes", document, static=True)


def _write(stream: rr.RecordingStream, run: Trajectory, width: float, notes: str) -> None:
    series, frames = _series(run), _frames(run)
    scene = _scene_view(positions(run.q[frames]), width)
    stream.send_blueprint(_blueprint(scene, series, run.t, notes))
    _log_scene(stream, run, frames, width)
    for one in series:
        _log_series(stream, run, one)


def _send(
    stream: rr.RecordingStream, run: Trajectory, rows: np.ndarray, columns: dict[str, Any]
) -> None:
    """Sends rerun's columns, by entity, for some rows of the run."""
    t = np.round(run.t[rows] * 1e9).astype("timedelta64[ns]")  # rerun would truncate
    times = [rr.TimeColumn("t", duration=t), rr.TimeColumn("step", sequence=rows)]
    for entity, column in columns.items():
        stream.send_columns(entity, times, column)
    stream.flush(timeout_sec=60.0)  # bounds what waits in memory, and raises errors


def _blocks(count: int) -> Iterator[np.ndarray]:
    return (np.arange(k, min(k + _BLOCK, count)) for k in range(0, count, _BLOCK))


def _series(run: Trajectory) -> list[_Series]:
    """All that is plotted. rerun draws in the order of names, so that `q` lies over `desired`."""
    n = run.q.shape[-1] // 2
    desired = _split("", "desired", run.q_d, "rad", "m")
    inputs = [f"column_{a}_{i}" for i in range(1, n + 1) for a in (1, 2)]
    shades = np.repeat(_colors(n), 2, axis=0) * np.tile([[1.0], [0.6]], (n, 1))
    out = [one._replace(colors=0.45 * one.colors + 25.0, width=6.0) for one in desired]
    out += _split("", "q", run.q, "rad", "m")
    out += _split("error", "error", run.error, "rad", "m")
    out += [_Series("tau", "tau [N]", "tau", run.tau, inputs, shades)]
    for name, signal in run.signals.items():
        entity = f"signals/{rr.escape_entity_path_part(name)}"
        values = signal.reshape(len(run), -1)
        if values.shape[1] == 2 * n:
            out += _split(name, entity, values)
        elif values.size:
            out.append(_Series(name, name, entity, values, [], _colors(values.shape[1])))
    if run.disturbance.any():
        out += _split("disturbance", "disturbance", run.disturbance, "N m", "N")
    first = ["", "error", "s", "tau"]
    return sorted(out, key=lambda one: first.index(one.tab) if one.tab in first else len(first))


def _split(tab: str, entity: str, values: np.ndarray, *units: str) -> list[_Series]:
    """One value a coordinate, shape (T, 2N): angles and slides apart, for their scales differ."""
    n = values.shape[1] // 2
    out = []
    for k, (kind, part) in enumerate((("angles", slice(n, None)), ("slides", slice(n)))):
        unit = f" [{units[k]}]" if units else ""
        view = f"{tab}, {kind}{unit}" if tab else f"{kind}{unit}   thin: true, wide: desired"
        names = coordinate_names(n)[part]
        out.append(_Series(tab, view, f"{entity}/{kind}", values[:, part], names, _colors(n)))
    return out


def _colors(count: int) -> np.ndarray:
    return np.resize([list(bytes.fromhex(color)) for color in _COLORS], (count, 3))


def _log_series(stream: rr.RecordingStream, run: Trajectory, series: _Series) -> None:
    style = rr.SeriesLines(
        names=list(series.names) or None,
        colors=series.colors.astype(np.uint8),
        widths=[series.width] * len(series.colors),
    )
    stream.log(series.entity, style, static=True)
    for rows in _blocks(len(run)):
        scalars = rr.Scalars.columns(scalars=series.values[rows])
        _send(stream, run, rows, {series.entity: scalars})


def _frames(run: Trajectory) -> np.ndarray:
    """Rows that the scene shows, about 60 a second."""
    span = run.t[-1] - run.t[0]
    rate = (len(run) - 1) / span if span > 0.0 else _FRAME_RATE
    rows = np.arange(0, len(run), max(1, round(rate / _FRAME_RATE)))
    return rows[np.abs(run.q[rows]).max(axis=-1) < _DRAWABLE]


def _log_scene(
    stream: rr.RecordingStream, run: Trajectory, frames: np.ndarray, width: float
) -> None:
    for entity, look in _looks(run.q.shape[-1] // 2, width).items():
        stream.log(entity, look, static=True)
    for block in _blocks(len(frames)):
        rows, previous = frames[block], frames[np.maximum(block - 1, 0)]
        q = run.q[rows]
        turns = plate_quaternions(q)
        tip = [positions(run.q[k])[:, -1:] for k in (previous, rows)]
        columns = [smooth_arm(q, side * width) for side in (-0.5, 0.5)]
        edges = [smooth_arm(run.q_d[rows], side * width) for side in (-0.7, 0.7)]
        band = np.stack(edges, axis=-2)
        band[..., 1] += 0.15 * width  # behind the arm, so as not to cut it
        plates = rr.InstancePoses3D.columns(
            translations=world_position(positions(q)).reshape(-1, 3),
            quaternions=turns.reshape(-1, 4),
        )
        mesh = rr.Mesh3D.columns(vertex_positions=band.reshape(-1, 3))
        content = {
            "world/backbone": _strips(smooth_arm(q)),
            "world/columns": _strips(np.concatenate(columns, axis=1)),
            "world/plates": plates.partition([turns.shape[1]] * len(rows)),
            "world/desired": mesh.partition([band[0].size // 3] * len(rows)),
            "world/trail": _strips(world_position(np.stack(tip, axis=2))),
        }
        _send(stream, run, rows, content)


def _looks(n: int, width: float) -> dict[str, Any]:
    """What of the scene stays the same."""
    lines = rr.LineStrips3D.from_fields
    disc = {"radii": 0.7 * width, "fill_mode": "solid"}
    above = [0.0, 0.0, 0.075 * width]
    corner = 2 * np.arange(smooth_arm(np.zeros(2 * n)).size // 3 - 1)[:, None]
    band = corner + np.array([0, 1, 2, 1, 3, 2])
    return {
        "world": rr.ViewCoordinates.RIGHT_HAND_Z_UP,
        "world/base": rr.Cylinders3D(lengths=0.15 * width, centers=above, colors=_BASE, **disc),
        "world/plates": rr.Cylinders3D(lengths=0.08 * width, colors=_PLATE, **disc),
        "world/backbone": lines(colors=_colors(n), radii=0.11 * width),
        "world/columns": lines(colors=_COLUMN, radii=0.07 * width),
        "world/desired": rr.Mesh3D.from_fields(
            triangle_indices=band.reshape(-1, 3), albedo_factor=_DESIRED
        ),
        "world/trail": lines(colors=_TRAIL, radii=0.03 * width),
    }


def _strips(curves: np.ndarray) -> Any:
    frames, count, *shape = curves.shape
    strips = curves.reshape(-1, *shape).astype(np.float32)
    return rr.LineStrips3D.columns(strips=strips).partition([count] * frames)


def _scene_view(ends: np.ndarray, width: float) -> rrb.Spatial3DView:
    """A camera in front of all places that the arm reaches, a little to the side."""
    depth = ends[..., 0].max(initial=0.0) + width
    reach = np.abs(ends[..., 1]).max(initial=0.0) + width
    middle = np.array([0.0, 0.0, 0.5 * (width - depth)])
    position = middle + 1.05 * max(depth, 1.3 * reach) * np.array([0.33, -0.92, 0.18])
    now = rr.TimeRangeBoundary.cursor_relative
    last_second = rrb.VisibleTimeRanges(timeline="t", start=now(seconds=-1.0), end=now())
    return rrb.Spatial3DView(
        origin="world",
        name="arm   pale band: desired",
        eye_controls=rrb.EyeControls3D(position=position, look_target=middle, eye_up=[0, 0, 1]),
        line_grid=False,
        overrides={"world/trail": last_second},
    )


def _blueprint(scene: Any, series: list[_Series], t: np.ndarray, notes: str) -> rrb.Blueprint:
    margin = 0.16 * (t[-1] - t[0]) + 1e-3  # on the right, for the legends
    at = rr.TimeRangeBoundary.absolute
    shown = rr.TimeRange(start=at(seconds=t[0]), end=at(seconds=t[-1] + margin))
    tabs: dict[str, dict[str, list[_Series]]] = {}
    for one in series:
        tabs.setdefault(one.tab, {}).setdefault(one.view, []).append(one)
    plots = {tab: [_plot(v, tabs[tab][v], shown) for v in tabs[tab]] for tab in tabs}
    motion = plots.pop("")
    pages: list[Any] = [rrb.Horizontal(*plots[tab], name=tab) for tab in plots]
    if notes:
        pages.append(rrb.TextDocumentView(origin="notes", name="notes"))
    right = rrb.Vertical(*motion, rrb.Tabs(*pages, active_tab=0))
    return rrb.Blueprint(
        rrb.Horizontal(scene, right, column_shares=[2, 3]),
        rrb.TimePanel(timeline="t", play_state="paused", state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _plot(title: str, series: list[_Series], shown: rr.TimeRange) -> rrb.TimeSeriesView:
    named = len(series[0].names)
    return rrb.TimeSeriesView(
        name=title,
        contents=[one.entity for one in series],
        axis_x=rrb.TimeAxis(view_range=shown),
        plot_legend=rrb.PlotLegend("RightTop", visible=0 < named <= _LEGEND),
    )
