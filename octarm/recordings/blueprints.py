"""How the viewer lays a recording out: the arm, how it tracks, and a tab for each further subject.

There are four kinds of run: plain, sliding (it has a sliding variable), adaptive (it has rules) and
disturbed. They differ in the tabs that exist, and in the one that is open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import VisualizerComponentMapping

from octarm.recordings import heat_map
from octarm.recordings.channels import Channel, has_energy, has_sliding
from octarm.recordings.scene import Scene, input_colors
from octarm.recordings.shapes import module_colors
from octarm.recordings.words import short_title_of

_BOUND = [150, 156, 166]
EVENTS = {"begins": [224, 138, 60], "ends": [255, 90, 95]}  # of a disturbance, of a run that failed
# The lowest and the highest number of each plot, as it is recorded, by its first column.
Extremes = Mapping[str, tuple[float, float]]
_LEGEND = 8  # series at most that a legend can name
_FAR = 2.0  # times the largest value; a bound beyond that is written, not drawn
_ABOUT_ZERO = ("error", "s", "disturbance")  # channels whose plots have zero in the middle
_SHORT = 64  # letters of a title that leaves room for more
_LANE = 0.045  # height of a lane of the state timeline [of the window]


class Curves(NamedTuple):
    """Lines of a plot that stand in one list of numbers, their names for the legend, and colours.

    Attributes:
        entity: its path; the first part names the structure in it.
        path: of the list in the structure, such as `.q_bends[]`.
        width: [pixel].
    """

    entity: str
    path: str
    names: Sequence[str]
    colors: Any
    width: float = 1.5


def reach(size: float) -> tuple[float, float] | None:
    """The ends of an axis about zero with three labels at least; None for no finite size."""
    end = 1.08 * size
    return (span(-end, end) or (-end, end)) if 0.0 < size < math.inf else None


def span(low: float, high: float) -> tuple[float, float] | None:
    """The ends of an axis of numbers from low to high with three labels at least.

    The viewer labels multiples of a power of ten, of that which leaves room for them: with more
    than nine in sight, of the next one. None where there are three anyway, or no finite size.
    """
    size = high - low
    if not 0.0 < size < math.inf:
        return None
    step = 10.0 ** math.ceil(math.log10(size / 8.9))
    first, last = math.ceil(low / step), math.floor(high / step)
    if last - first >= 2:
        return None
    while last - first < 2:
        below = low - (first - 1) * step < (last + 1) * step - high
        first, last = (first - 1, last) if below else (first, last + 1)
    return min(low, first * step) - 0.04 * size, max(high, last * step) + 0.04 * size


class Plots:
    """Plots of the channels of one run, which stand below the entity `root`, over its time.

    Attributes:
        axis: the time, with room for the legends at its end.
        end: of the run [s].
    """

    def __init__(
        self,
        channels: Mapping[str, Channel],
        end: float,
        root: str = "",
        events: Mapping[str, str] | None = None,
        extremes: Extremes | None = None,
    ) -> None:
        """Plots from 0 to `end` [s].

        The extremes tell which plots would be empty and which bounds are far off; None while the
        run goes on. Of the entities of `EVENTS` those that there are have a name for the legend.
        """
        at = rr.TimeRangeBoundary.absolute
        time = rr.TimeRange(start=at(seconds=0.0), end=at(seconds=1.2 * end))
        self.channels, self.axis, self.end = channels, rrb.TimeAxis(view_range=time), end
        self._root, self._events, self._extremes = root, events or {}, extremes

    def curves(self, name: str, part: str = "") -> Curves:
        """The curves of a part of a channel."""
        channel = self.channels[name]
        names = channel.names[channel.parts[part]]
        colors = (input_colors if channel.kind == "inputs" else module_colors)(len(names))
        return Curves(channel.entity, f".{channel.column(part)}[]", names, colors)

    def view(
        self,
        title: str,
        *curves: Curves,
        legend: bool = False,
        ends: tuple[float, float] | None = None,
    ) -> Any:
        """A plot of curves; the viewer chooses the ends of its axis if they are not given."""
        lines: dict[Any, list[Any]] = {}
        path = curves[0].path.removesuffix("[]")
        marks = [
            Curves(f"events/{kind}", path, [name], [EVENTS[kind]], 1.0)
            for kind, name in self._events.items()
        ]
        each = rr.components.AggregationPolicy.Off  # both ends of a line are at one instant
        for some in [*curves, *marks]:
            style = rr.SeriesLines.from_fields(
                names=list(some.names),
                colors=np.asarray(some.colors).astype(np.uint8),
                widths=[some.width] * len(some.names),
                aggregation_policy=each if some in marks else None,
            )
            source = VisualizerComponentMapping(
                "Scalars:scalars",
                "SourceComponent",
                source_component=f"octarm:{some.entity.partition('/')[0]}",
                selector=some.path,
            )
            entity = f"{self._root}{some.entity}"
            lines.setdefault(entity, []).append(style.visualizer(mappings=[source]))
        names = {name for some in (*curves, *marks) for name in some.names}
        legend = legend and 0 < len(names) <= _LEGEND
        return rrb.TimeSeriesView(
            name=title,
            contents=list(lines),
            overrides=lines,
            axis_x=self.axis,
            axis_y=None if ends is None else rrb.ScalarAxis(range=ends),
            plot_legend=rrb.PlotLegend("RightTop") if legend else rrb.PlotLegend(visible=False),
        )

    def bounded(self, title: str, name: str, part: str, legend: bool = False) -> Any:
        """A plot of a part of a channel with lines at its bound, which is written if far off."""
        channel, size = self.channels[name], self._size(name, part)
        curves = [self.curves(name, part)]
        if (bound := channel.bound) is not None:
            lines = channel.lines(part)
            sizes = np.abs(lines)
            if sizes.min() > _FAR * size:
                ends = dict.fromkeys(f"{x:.3g}" for x in (sizes.min(), sizes.max()))
                title = f"{title}   {bound.word} = {' to '.join(ends)}, far off"
            else:
                names = [f"{'± ' if bound.both_sides else ''}{bound.word}"] * len(lines)
                path, colors = f".{part or 'all'}[]", [_BOUND] * len(lines)
                curves.append(Curves(f"bounds/{name}", path, names, colors, 1.0))
                title, size = f"{title}   grey: {bound.word}", max(size, float(sizes.max()))
        ends = reach(size) if name in _ABOUT_ZERO else None
        return self.view(title, *curves, legend=legend, ends=ends)

    def _size(self, name: str, part: str) -> float:
        """The largest size of the numbers of a plot, as recorded; infinite if it is not known."""
        if self._extremes is None:
            return math.inf
        return max(map(abs, self._extremes.get(self.channels[name].column(part), (0.0,))))

    def views(self, name: str) -> list[Any]:
        """A plot for each part of a channel that is not empty, with lines at its bound."""
        channel = self.channels.get(name)
        if channel is None or channel.kind == "rules":
            return []
        named = channel.kind in ("coordinates", "inputs") and name != "E"
        parts = [part for part in channel.parts if self._size(name, part)]
        titles = [channel.label(part) + channel.recorded(part)[1] for part in parts]
        return [
            self.bounded(title, name, part, legend=named and part == parts[0])
            for title, part in zip(titles, parts, strict=True)
        ]

    def tracking(self, part: str) -> list[Any]:
        """Coordinates against the desired ones, and their error."""
        wanted = self.curves("q_d", part)
        names, colors = ["desired"] * len(wanted.names), 0.45 * wanted.colors + 25.0
        wanted = wanted._replace(names=names, colors=colors, width=6.0)
        unit = self.channels["q"].recorded(part)[1]
        title = f"{part}{unit}   wide: desired"
        ends = span(*(self._extremes or {}).get(self.channels["q"].column(part), (0.0, 0.0)))
        both = self.view(title, wanted, self.curves("q", part), legend=True, ends=ends)
        return [both, self.bounded(f"error of {part}{unit}", "error", part)]

    def energy_rate(self) -> Any:
        """How V changes, and what the rate could not exceed if the model were exact."""
        curves = [Curves("signals", ".V_rate", ["V'"], [[120, 160, 200]])]
        if has_sliding(self.channels):
            curves.append(Curves("signals", ".V_claim", ["s . robust part"], [[255, 159, 67]]))
        title = "V' [mW]   orange: its bound were the model exact"
        return self.view(title, *curves, legend=True)

    def states(self, name: str, *contents: str) -> Any:
        """Lanes of states over time."""
        return rrb.StateTimelineView(
            origin="states", name=name, contents=list(contents), time_view=self.axis
        )

    def heats(self) -> dict[str, Any]:
        """The heat map of each channel with a number for each rule."""
        coordinates = len(self.channels["q"].names)
        return {
            name: rrb.Spatial2DView(
                origin=f"heat/{name}",
                contents=["$origin/**", "heat/now"],
                name=f"change of {name}, a row a rule   orange: up, blue: down; largest at left",
                background=[13, 15, 19],
                visual_bounds=rrb.VisualBounds2D(
                    x_range=[-heat_map.LEFT, heat_map.WIDTH + 12],
                    y_range=[-10, heat_map.height(len(channel.names), coordinates) + 30],
                ),
            )
            for name, channel in self.channels.items()
            if channel.kind == "rules"
        }


def blueprint(
    scene: Scene,
    plots: Plots,
    description: Mapping[str, Any],
    lanes: int,
    *,
    listed: bool = False,
    following: bool = False,
) -> rrb.Blueprint:
    """The layout for one run, with so many lanes of states beside those of single coordinates.

    The viewer keeps its list of recordings open if they are `listed`, and shows the last instant if
    it is `following`.
    """
    tabs = _tabs(plots, ledger=bool(description.get("disturbances")))
    sliding = ["s"] if has_sliding(plots.channels) else []
    by_priority = ("adaptation", "disturbances", *sliding, "input", "notes")
    opened = next(name for name in by_priority if name in tabs)
    title = short_title_of(description, _SHORT)  # all of it stands in the notes
    left: Any = scene.view(f"{title}   pale: desired")
    if lanes:
        height = _LANE * (lanes + 2)
        states = plots.states("state", "states/**", "- states/each/**")
        left = rrb.Vertical(left, states, row_shares=[1.0 - height, height])
    tracking = [
        rrb.Horizontal(*plots.tracking(part), name=part) for part in plots.channels["q"].parts
    ]
    right = rrb.Vertical(
        *tracking,
        rrb.Tabs(*tabs.values(), active_tab=list(tabs).index(opened)),
        row_shares=[*[1.0] * len(tracking), 1.15],
    )
    body = rrb.Horizontal(left, right, column_shares=[2, 3])
    return Layout(body, listed=listed, following=following)


def _tabs(plots: Plots, *, ledger: bool) -> dict[str, Any]:
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

    heats = plots.heats()
    tab("s")
    tab("input", channel="tau")
    tab("equivalent")
    tab("robust part", channel="switching")
    tab("V", *([plots.energy_rate()] if has_energy(plots.channels) else []))
    if has_sliding(plots.channels):
        tabs["states"] = plots.states("states", "states/each/**")
    if heats:
        gain = plots.views("E")
        columns, shares = ([rrb.Vertical(*gain)], [2.2, 1.0]) if gain else ([], [1.0])
        first, name = heats.pop(next(iter(heats))), "adaptation"
        tabs[name] = rrb.Horizontal(first, *columns, column_shares=shares, name=name)
        drawn.add("E")
    tab("f^", channel="f_hat")
    if heats:
        tab(", ".join(heats), *heats.values())
    page = rrb.TextDocumentView(origin="ledger", name="asked and delivered")
    tab("disturbances", *([page] if ledger else []), channel="disturbance")
    for name in plots.channels:
        if name not in drawn:
            tab(name)
    tabs["notes"] = rrb.TextDocumentView(origin="notes", name="notes")
    return tabs


class Layout(rrb.Blueprint):
    """A layout with nothing around it but the time; it opens at the first instant, or follows.

    It does not note when each of its parts was made, and is smaller by a tenth.
    """

    def __init__(self, layout: Any, *, listed: bool = False, following: bool = False) -> None:
        play_state = "following" if following else "paused"
        super().__init__(
            layout,
            rrb.TimePanel(timeline="t", play_state=play_state, state="collapsed"),
            rrb.SelectionPanel(state="hidden"),
            *([] if listed else [rrb.BlueprintPanel(state="hidden")]),
        )

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        stream.set_log_time_enabled(False)
        super()._log_to_stream(stream)
