"""How the viewer lays a recording out: the arm, how it tracks, and a tab for what else there is.

There are four kinds of run: plain, sliding (it has a sliding variable), adaptive (it has rules) and
disturbed. They differ in the tabs that exist, and in the one that is open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import VisualizerComponentMapping

from octarm.recordings import heat_map
from octarm.recordings.channels import Channel, bound_lines
from octarm.recordings.recorded_scene import Scene, module_colors

_BOUND = [150, 156, 166]
_LEGEND = 8  # series at most that a legend can name
_LANE = 0.045  # height of a lane of the state timeline [of the window]
_SIGNAL_FIRST = ("equivalent", "switching")


class Curves(NamedTuple):
    """Lines of a plot that stand in one list of numbers, and how they look.

    Attributes:
        entity: its path.
        component: the name of the structure in it.
        path: of the list in the structure, such as `.q_bends[]`.
        names: for the legend.
        colors: red, green, blue, shape (lines, 3).
        width: [pixel].
    """

    entity: str
    component: str
    path: str
    names: Sequence[str]
    colors: Any
    width: float = 1.5


def blueprint(
    scene: Scene,
    channels: Mapping[str, Channel],
    bounds: Mapping[str, np.ndarray],
    description: Mapping[str, Any],
    lanes: int,
) -> rrb.Blueprint:
    """The layout for one run.

    Args:
        scene: the arm.
        channels: what the run holds.
        bounds: of channels on both sides, arrays of shape (...) of their own, see
            `octarm.recordings.channels.bounds_of`.
        description: of the run; its duration is the range of the plots.
        lanes: of the state timeline, that of the run itself not counted.
    """
    plots = _Plots(channels, bounds, float(description.get("duration", 1.0)))
    tabs = _tabs(plots, channels, description)
    first = ("adaptation", "disturbances", "s" if "switching" in channels else "input", "input")
    opened = next(name for name in first if name in tabs)
    arm: Any = scene.view("arm   pale sheath: desired")
    left = arm
    if lanes:
        states = state_view(plots.axis, "state", ["states/**", "- states/each/**"])
        left = rrb.Vertical(
            arm, states, row_shares=[1.0 - _LANE * (lanes + 2), _LANE * (lanes + 2)]
        )
    tracking = [rrb.Horizontal(*plots.pair(part), name=part) for part in ("bends", "slides")]
    right = rrb.Vertical(
        *tracking,
        rrb.Tabs(*tabs.values(), active_tab=list(tabs).index(opened)),
        row_shares=[1, 1, 1.15],
    )
    return wrapped(rrb.Horizontal(left, right, column_shares=[2, 3]))


class _Layout(rrb.Blueprint):
    """A blueprint that does not note when each of its parts was made: it is smaller by a tenth."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        stream.set_log_time_enabled(False)
        super()._log_to_stream(stream)


def wrapped(layout: Any) -> rrb.Blueprint:
    """A layout with nothing around it but the time."""
    return _Layout(
        layout,
        rrb.TimePanel(timeline="t", play_state="paused", state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _tabs(
    plots: _Plots, channels: Mapping[str, Channel], description: Mapping[str, Any]
) -> dict[str, Any]:
    """The tabs by name, in their order."""
    tabs: dict[str, Any] = {}

    def row(name: str, *views: Any) -> None:
        if len(views) == 1:
            tabs[name] = views[0]
        elif views:
            tabs[name] = rrb.Horizontal(*views, name=name)

    row("s", *plots.halves("s"))
    row("input", *plots.whole("tau", legend=True))
    for name in _SIGNAL_FIRST:
        row({"switching": "robust part"}.get(name, name), *plots.halves(name))
    if "V" in channels:
        row("V", *plots.whole("V"), plots.rate())
    if "switching" in channels:
        row("states", state_view(plots.axis, "states", ["states/each/**"]))
    coordinates = len(channels["q"].names)
    rules = [c for c in channels.values() if c.kind == "rules"]
    if rules:
        gain = plots.halves("E")
        columns = [rrb.Vertical(*gain)] if gain else []
        shares = [2.2, 1.0] if columns else [1.0]
        tabs["adaptation"] = rrb.Horizontal(
            heat_view(rules[0], coordinates), *columns, column_shares=shares, name="adaptation"
        )
    row("f^", *plots.halves("f_hat"))
    row(
        ", ".join(rule.name for rule in rules[1:]),
        *[heat_view(rule, coordinates) for rule in rules[1:]],
    )
    if description.get("disturbances") or "disturbance" in channels:
        pages = [rrb.TextDocumentView(origin="ledger", name="asked and delivered")]
        row(
            "disturbances",
            *plots.halves("disturbance"),
            *(pages if description.get("disturbances") else []),
        )
    shown = {"q", "q_d", "error", "s", "tau", "V", "E", "f_hat", "disturbance", *_SIGNAL_FIRST}
    for name, channel in channels.items():
        if name not in shown and channel.kind != "rules":
            halves = channel.kind == "coordinates"
            row(name, *(plots.halves(name) if halves else plots.whole(name)))
    tabs["notes"] = rrb.TextDocumentView(origin="notes", name="notes")
    return tabs


def state_view(axis: rrb.TimeAxis, name: str, contents: list[str]) -> rrb.StateTimelineView:
    """Lanes of states over time."""
    return rrb.StateTimelineView(origin="states", name=name, contents=contents, time_view=axis)


def heat_view(channel: Channel, coordinates: int, root: str = "heat") -> rrb.Spatial2DView:
    """The heat map of numbers of rules."""
    return rrb.Spatial2DView(
        origin=f"{root}/{channel.name}",
        contents=["$origin/**", f"{root}/now"],
        name=f"change of {channel.name}, a row a rule   orange: up, blue: down; largest at left",
        background=[13, 15, 19],
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-heat_map.LEFT, heat_map.WIDTH + 12],
            y_range=[-10, heat_map.height(len(channel.names), coordinates) + 30],
        ),
    )


class _Plots:
    """Plots of channels over the time of one run."""

    def __init__(
        self, channels: Mapping[str, Channel], bounds: Mapping[str, np.ndarray], duration: float
    ) -> None:
        self._channels, self._bounds = channels, bounds
        self.axis = time_axis(duration)

    def pair(self, part: str) -> list[Any]:
        """Slides or bends against the desired ones, and their error."""
        q, error = self._channels["q"], self._channels["error"]
        wanted = self._half("q_d", part)
        wanted = wanted._replace(
            names=["desired"] * len(wanted.names), colors=0.45 * wanted.colors + 25.0, width=6.0
        )
        unit = q.unit(part)
        return [
            self._view(f"{part}{unit}   wide: desired", wanted, self._half("q", part), legend=True),
            self._view(
                f"error of {part}{error.unit(part)}{self._bounded('error')}",
                self._half("error", part), *self._limits("error", part),
            ),
        ]  # fmt: skip

    def halves(self, name: str) -> list[Any]:
        """Two plots, bends and slides, for their scales differ."""
        channel = self._channels.get(name)
        if channel is None or channel.kind != "coordinates":
            return []
        return [
            self._view(
                f"{channel.title}, {part}{channel.unit(part)}{self._bounded(name)}",
                self._half(name, part), *self._limits(name, part),
                legend=part == "bends" and name != "E",
            )
            for part in ("bends", "slides")
        ]  # fmt: skip

    def whole(self, name: str, legend: bool = False) -> list[Any]:
        """One plot of all numbers."""
        channel = self._channels.get(name)
        if channel is None:
            return []
        colors = module_colors(len(channel.names))
        if channel.kind == "inputs":
            n = len(channel.names) // 2
            colors = np.repeat(module_colors(n), 2, axis=0) * np.tile([[1.0], [0.6]], (n, 1))
        title = f"{channel.title}{channel.unit()}{self._bounded(name)}"
        curves = Curves(channel.entity, channel.entity, f".{name}[]", channel.names, colors)
        return [self._view(title, curves, *self._limits(name, "all"), legend=legend)]

    def rate(self) -> Any:
        """How V changes, and what it could not exceed if the model were exact."""
        curves = [Curves("signals", "signals", ".V_rate", ["V'"], [[120, 160, 200]])]
        if "switching" in self._channels:
            claim = Curves("signals", "signals", ".V_claim", ["s . robust part"], [[255, 159, 67]])
            curves.append(claim)
        return self._view("V' [W]   orange: its bound were the model exact", *curves, legend=True)

    def _half(self, name: str, part: str) -> Curves:
        """The curves of slides or bends."""
        channel = self._channels[name]
        chosen = channel.half(part)
        names = channel.names[chosen]
        entity, colors = channel.entity, module_colors(len(names))
        return Curves(entity, entity, f".{name}_{part}[]", names, colors)

    def _limits(self, name: str, part: str) -> list[Curves]:
        """Lines at the bounds of slides, of bends or of all."""
        if name not in self._bounds or name not in self._channels:
            return []
        count = len(bound_lines(name, self._bounds[name], part))
        word = {"s": "± phi", "error": "± phi / lambda", "E": "E_max", "tau": "± limit"}
        names = [word.get(name, "bound")] * count
        return [Curves(f"bounds/{name}", "bounds", f".{part}[]", names, [_BOUND] * count, 1.0)]

    def _bounded(self, name: str) -> str:
        word = {"s": "phi", "error": "phi / lambda", "E": "its bound", "tau": "limit"}
        return f"   grey: {word.get(name, 'bound')}" if name in self._bounds else ""

    def _view(self, title: str, *curves: Curves, legend: bool = False) -> Any:
        return plot_view(title, curves, self.axis, legend)


def time_axis(duration: float) -> rrb.TimeAxis:
    """The time of a run [s], with room for the legends at its end."""
    at = rr.TimeRangeBoundary.absolute
    return rrb.TimeAxis(
        view_range=rr.TimeRange(start=at(seconds=0.0), end=at(seconds=1.16 * duration))
    )


def plot_view(
    title: str,
    curves: Iterable[Curves],
    axis: rrb.TimeAxis,
    legend: bool = False,
    largest: float | None = None,
) -> rrb.TimeSeriesView:
    """A plot of curves, which may stand anywhere; from -largest to largest if that is given."""
    lines: dict[Any, list[Any]] = {}
    names: set[str] = set()
    for some in curves:
        style = rr.SeriesLines.from_fields(
            names=list(some.names),
            colors=np.asarray(some.colors).astype(np.uint8),
            widths=[some.width] * len(some.names),
        )
        source = VisualizerComponentMapping(
            "Scalars:scalars",
            "SourceComponent",
            source_component=f"octarm:{some.component}",
            selector=some.path,
        )
        lines.setdefault(some.entity, []).append(style.visualizer(mappings=[source]))
        names |= set(some.names)
    legend = legend and 0 < len(names) <= _LEGEND
    return rrb.TimeSeriesView(
        name=title,
        contents=list(lines),
        overrides=lines,
        axis_x=axis if legend else None,
        axis_y=None if not largest else rrb.ScalarAxis(range=(-largest, largest)),
        plot_legend=rrb.PlotLegend("RightTop") if legend else rrb.PlotLegend(visible=False),
    )
