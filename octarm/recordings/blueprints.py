"""How the viewer lays a recording out: the arm, how it tracks, and a tab for each further subject.

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
from octarm.recordings.channels import Channel, has_energy, has_sliding
from octarm.recordings.scene import Scene, input_colors, module_colors

_BOUND = [150, 156, 166]
_BACKGROUND = [13, 15, 19]
_LEGEND = 8  # series at most that a legend can name
_LANE = 0.045  # height of a lane of the state timeline [of the window]


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


class Plots:
    """Plots of the channels of one run over its time.

    Attributes:
        axis: the time.
    """

    def __init__(
        self, channels: Mapping[str, Channel], axis: rrb.TimeAxis, *, root: str = ""
    ) -> None:
        """Plots of channels that stand below the entity `root`."""
        self._channels, self._root = channels, root
        self.axis = axis

    def curves(self, name: str, part: str = "") -> Curves:
        """The curves of a part of a channel."""
        channel = self._channels[name]
        names = channel.names[channel.parts[part]]
        colors = (input_colors if channel.kind == "inputs" else module_colors)(len(names))
        entity = f"{self._root}{channel.entity}"
        return Curves(entity, channel.entity, f".{channel.column(part)}[]", names, colors)

    def views(self, name: str) -> list[Any]:
        """A plot for each part of a channel, since their scales differ; none without the channel.

        Lines mark the bound of the channel.
        """
        channel = self._channels.get(name)
        if channel is None or channel.kind == "rules":
            return []
        views: list[Any] = []
        for part in channel.parts:
            title = f"{channel.title}, {part}" if part else channel.title
            named = not views and channel.kind in ("coordinates", "inputs") and name != "E"
            views.append(self._view(f"{title}{channel.units[part]}", name, part, legend=named))
        return views

    def tracking(self, part: str) -> list[Any]:
        """Coordinates against the desired ones, and their error."""
        wanted = self.curves("q_d", part)
        wanted = wanted._replace(
            names=["desired"] * len(wanted.names), colors=0.45 * wanted.colors + 25.0, width=6.0
        )
        title = f"{part}{self._channels['q'].units[part]}   wide: desired"
        both = plot_view(title, [wanted, self.curves("q", part)], self.axis, legend=True)
        unit = self._channels["error"].units[part]
        return [both, self._view(f"error of {part}{unit}", "error", part)]

    def energy_rate(self) -> Any:
        """How V changes, and what the rate could not exceed if the model were exact."""
        signals = (f"{self._root}signals", "signals")
        curves = [Curves(*signals, ".V_rate", ["V'"], [[120, 160, 200]])]
        if has_sliding(self._channels):
            curves.append(Curves(*signals, ".V_claim", ["s . robust part"], [[255, 159, 67]]))
        title = "V' [W]   orange: its bound were the model exact"
        return plot_view(title, curves, self.axis, legend=True)

    def _view(self, title: str, name: str, part: str, legend: bool = False) -> Any:
        """A plot of a part of a channel with lines at its bound."""
        bound, curves = self._channels[name].bound, [self.curves(name, part)]
        if bound is not None:
            count = len(bound.lines(self._channels[name].parts[part]))
            names = [f"{'± ' if bound.both_sides else ''}{bound.word}"] * count
            entity = f"{self._root}bounds/{name}"
            colors = [_BOUND] * count
            curves.append(Curves(entity, "bounds", f".{part or 'all'}[]", names, colors, 1.0))
            title = f"{title}   grey: {bound.word}"
        return plot_view(title, curves, self.axis, legend)


def blueprint(
    scene: Scene, channels: Mapping[str, Channel], description: Mapping[str, Any], lanes: int
) -> rrb.Blueprint:
    """The layout for one run.

    Args:
        scene: the arm.
        channels: what the run holds.
        description: of the run; its duration is the range of the plots.
        lanes: of the state timeline, without those of single coordinates.
    """
    plots = Plots(channels, time_axis(float(description.get("duration", 1.0))))
    tabs = _tabs(plots, channels, ledger=bool(description.get("disturbances")))
    by_priority = ("adaptation", "disturbances", *(["s"] if has_sliding(channels) else []), "input")
    opened = next(name for name in by_priority if name in tabs)
    arm: Any = scene.view("arm   pale sheath: desired")
    left = arm
    if lanes:
        height = _LANE * (lanes + 2)
        states = _state_view(plots.axis, "state", ["states/**", "- states/each/**"])
        left = rrb.Vertical(arm, states, row_shares=[1.0 - height, height])
    tracking = [rrb.Horizontal(*plots.tracking(p), name=p) for p in channels["q"].parts]
    right = rrb.Vertical(
        *tracking,
        rrb.Tabs(*tabs.values(), active_tab=list(tabs).index(opened)),
        row_shares=[*[1.0] * len(tracking), 1.15],
    )
    return wrapped(rrb.Horizontal(left, right, column_shares=[2, 3]))


def _tabs(plots: Plots, channels: Mapping[str, Channel], *, ledger: bool) -> dict[str, Any]:
    """The tabs by name, in their order; `ledger`: whether there is a page on the disturbances."""
    tabs: dict[str, Any] = {}
    drawn = {"q", "q_d", "error"}

    def tab(name: str, *views: Any, channel: str = "") -> None:
        drawn.add(channel or name)
        views = (*plots.views(channel or name), *views)
        if len(views) == 1:
            tabs[name] = views[0]
        elif views:
            tabs[name] = rrb.Horizontal(*views, name=name)

    coordinates = len(channels["q"].names)
    heats = [_heat_view(c, coordinates) for c in channels.values() if c.kind == "rules"]
    tab("s")
    tab("input", channel="tau")
    tab("equivalent")
    tab("robust part", channel="switching")
    tab("V", *([plots.energy_rate()] if has_energy(channels) else []))
    if has_sliding(channels):
        tabs["states"] = _state_view(plots.axis, "states", ["states/each/**"])
    if heats:
        gain = plots.views("E")
        columns, shares = ([rrb.Vertical(*gain)], [2.2, 1.0]) if gain else ([], [1.0])
        tabs["adaptation"] = rrb.Horizontal(
            heats[0], *columns, column_shares=shares, name="adaptation"
        )
        drawn.add("E")
    tab("f^", channel="f_hat")
    if heats[1:]:
        names = ", ".join([c.name for c in channels.values() if c.kind == "rules"][1:])
        tab(names, *heats[1:])
    page = rrb.TextDocumentView(origin="ledger", name="asked and delivered")
    tab("disturbances", *([page] if ledger else []), channel="disturbance")
    for name in channels:
        if name not in drawn:
            tab(name)
    tabs["notes"] = rrb.TextDocumentView(origin="notes", name="notes")
    return tabs


def _state_view(axis: rrb.TimeAxis, name: str, contents: list[str]) -> rrb.StateTimelineView:
    """Lanes of states over time."""
    return rrb.StateTimelineView(origin="states", name=name, contents=contents, time_view=axis)


def _heat_view(channel: Channel, coordinates: int) -> rrb.Spatial2DView:
    """The heat map of a channel with a number for each rule."""
    return rrb.Spatial2DView(
        origin=f"heat/{channel.name}",
        contents=["$origin/**", "heat/now"],
        name=f"change of {channel.name}, a row a rule   orange: up, blue: down; largest at left",
        background=_BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-heat_map.LEFT, heat_map.WIDTH + 12],
            y_range=[-10, heat_map.height(len(channel.names), coordinates) + 30],
        ),
    )


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
    """A plot of curves of any entities; from -largest to largest if that is given."""
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


def wrapped(layout: Any) -> rrb.Blueprint:
    """A layout with nothing around it but the time."""
    return _Layout(
        layout,
        rrb.TimePanel(timeline="t", play_state="paused", state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


class _Layout(rrb.Blueprint):
    """A blueprint that does not note when each of its parts was made: it is smaller by a tenth."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        stream.set_log_time_enabled(False)
        super()._log_to_stream(stream)
