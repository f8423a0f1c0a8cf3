"""The standard figures of a run for a paper: tracking, error, inputs, sliding, adaptation."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import matplotlib
import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.files import write_files
from octarm.recordings.channels import Channel, channels_of, has_energy
from octarm.recordings.notes import title_of
from octarm.simulation.trajectory import Trajectory

# Stand for Matplotlib's classes, whose methods leave the types of keyword arguments unknown.
Axes = Any
Figure = Any

COLORS = ["#d1660a", "#1f6fb5", "#2a9461", "#b8408f", "#a08a10", "#6a55c8", "#1b8f8f", "#c24a3a"]
_MOST = 4000  # points a curve; of more only the extremes of each stretch are drawn
_LARGEST = 1e100  # number that an axis shows
_INSTANTS = 1500  # of a heat map at most
_STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.9,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "octarm",
    "mathtext.fontset": "stix",
}


@np.errstate(all="ignore")  # a diverged arm may hold anything
def write_figures(
    folder: str | os.PathLike[str], run: Trajectory, description: Mapping[str, Any]
) -> list[Path]:
    """Writes each figure as PNG and SVG, all or none; a folder that is missing is made.

    There are always `tracking`, `error` and `inputs`; `sliding` if the controller has a sliding
    variable, `adaptation` if it adapts, `disturbance` if something pushed the arm.

    Returns:
        The files of the run of one arm, of which `description` is what `run.json` holds.

    Raises:
        OSError: if a file cannot be written.
    """
    drawn: dict[Path, bytes] = {}
    with cast(Any, matplotlib).rc_context(_STYLE), warnings.catch_warnings():
        # A letter that the font lacks is drawn as a box, a number without end as none.
        warnings.simplefilter("ignore")
        for name, figure in _Drawing(run, description).figures():
            for kind in ("svg", "png"):
                content = io.BytesIO()
                # Without a date equal runs give equal files.
                metadata = {"Date": None} if kind == "svg" else None
                figure.savefig(content, format=kind, dpi=200, metadata=metadata)
                figure.set_layout_engine("none")  # that of the first holds for the second
                drawn[Path(folder) / f"{name}.{kind}"] = content.getvalue()
    write_files(drawn)
    return list(drawn)


class _Panel(NamedTuple):
    """One pair of axes: some of the numbers of a channel over time."""

    channel: Channel
    part: slice
    label: str
    styles: Sequence[Mapping[str, str]]  # colour, and label and line style if there are any
    desired: bool = False  # whether q_d is drawn as well
    logarithmic: bool = False


class _Drawing:
    """Draws the figures of one run."""

    def __init__(self, run: Trajectory, description: Mapping[str, Any]) -> None:
        self._rows, self._t, self._title = dict(run.arrays()), run.t, title_of(description)
        disturbed = bool(run.disturbance.any())
        self._channels = channels_of(self._rows, description, run.layer, disturbed=disturbed)

    def figures(self) -> Iterator[tuple[str, Figure]]:
        """The figures by name."""
        rules = [channel for channel in self._channels.values() if channel.kind == "rules"]
        yield "tracking", self._figure(self._panels("q", desired=True))
        yield "error", self._figure(self._panels("error"))
        yield "inputs", self._figure(self._inputs(), height=1.35)
        if "s" in self._channels:
            panels = list(self._panels("s", "$s$"))
            if has_energy(self._channels):
                V, style = self._channels["V"], {"color": "#333333"}
                panels.append(_Panel(V, slice(None), "$V$ [J]", [style], logarithmic=True))
            yield "sliding", self._figure(panels)
        if rules:
            yield "adaptation", self._figure([*rules, *self._panels("E", "$E$")], height=1.5)
        if "disturbance" in self._channels:
            yield "disturbance", self._figure(self._panels("disturbance"))

    def _panels(self, name: str, title: str = "", desired: bool = False) -> Iterator[_Panel]:
        """A panel for each part of a channel, if there is such a channel."""
        if name in self._channels:
            channel = self._channels[name]
            for part, where in channel.parts.items():
                label = f"{title or channel.title}{', ' if part else ''}{part}{channel.units[part]}"
                styles = [
                    {"color": COLORS[i % len(COLORS)], "label": _symbol(name)}
                    for i, name in enumerate(channel.names[where])
                ]
                yield _Panel(channel, where, label, styles, desired)

    def _inputs(self) -> Iterator[_Panel]:
        """A panel for each module, with both of its columns."""
        channel = self._channels["tau"]
        for i in range(len(channel.names) // 2):
            label = f"$\\tau$, module {i + 1}{channel.units['']}"
            styles = [
                {"color": COLORS[i % len(COLORS)], "label": f"column {a}", "linestyle": line}
                for a, line in ((1, "-"), (2, "--"))
            ]
            yield _Panel(channel, slice(2 * i, 2 * i + 2), label, styles)

    def _figure(self, panels: Iterable[_Panel | Channel], height: float = 1.9) -> Figure:
        """Panels one below another; a channel of rules becomes a heat map."""
        panels = list(panels)
        figure = NewFigure(figsize=(6.3, height * len(panels) + 0.5), layout="constrained")
        axes = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
        axes[0].set_title(self._title, loc="left", parse_math=False)
        axes[-1].set_xlabel("time [s]")
        axes[0].set_xlim(self._t[0], self._t[-1] if len(self._t) > 1 else None)
        for ax, panel in zip(axes, panels, strict=True):
            if isinstance(panel, Channel):
                self._draw_rules(figure, ax, panel)
            else:
                self._draw_curves(ax, panel)
        return figure

    def _draw_curves(self, ax: Axes, panel: _Panel) -> None:
        values = _drawable(panel.channel.values(self._rows)[:, panel.part])
        if panel.logarithmic:
            values = np.maximum(values, 1e-12)
            ax.set_yscale("log")
        desired = _drawable(self._rows["q_d"][:, panel.part]) if panel.desired else values
        for style, y, y_d in zip(panel.styles, values.T, desired.T, strict=True):
            if panel.desired:
                ax.plot(*thinned(self._t, y_d), color=style["color"], linewidth=3.0, alpha=0.3)
            ax.plot(*thinned(self._t, y), **style)
        for y in bound.lines(panel.part) if (bound := panel.channel.bound) else ():
            if abs(y) < _LARGEST:
                ax.axhline(y, color="#555555", linewidth=0.6, linestyle=":")
        if "label" in panel.styles[0]:
            ax.legend(
                loc="upper left", bbox_to_anchor=(1.0, 1.02), handlelength=1.4, borderaxespad=0.2
            )
        ax.set_ylabel(panel.label)

    def _draw_rules(self, figure: Figure, ax: Axes, channel: Channel) -> None:
        """The change of numbers of rules; colours by the largest of each coordinate."""
        values = np.nan_to_num(channel.values(self._rows))
        few = np.linspace(0, len(values) - 1, min(len(values), _INSTANTS)).astype(int)
        coordinates = self._rows["q"].shape[1]
        changes = (values - values[0])[few].T.reshape(coordinates, -1, len(few))
        largest = np.abs(changes).max(axis=(1, 2), keepdims=True)
        shade = (changes / np.maximum(largest, 1e-300)).reshape(-1, len(few))
        rules = len(shade) // coordinates
        extent = (float(self._t[0]), float(self._t[-1]), len(shade) - 0.5, -0.5)
        image = ax.imshow(
            shade, aspect="auto", cmap="RdBu_r", vmin=-1, vmax=1, extent=extent, rasterized=True,
            interpolation="nearest",
        )  # fmt: skip
        names = [_symbol(name.rsplit("_", 1)[0]) for name in channel.names[::rules]]
        ax.set_yticks(rules * np.arange(coordinates) + 0.5 * (rules - 1), names)
        for j in range(1, coordinates):
            ax.axhline(j * rules - 0.5, color="white", linewidth=1.0)
        ax.grid(False)
        ax.set_ylabel(f"change of {_symbol(channel.name)}")
        figure.colorbar(image, ax=ax, label="share of largest", pad=0.01)


def _drawable(values: np.ndarray) -> np.ndarray:
    """The numbers, of any shape, with NaN for those beyond what an axis can show."""
    return np.where(np.abs(values) < _LARGEST, values, np.nan)


def thinned(t: np.ndarray, y: np.ndarray, most: int = _MOST) -> tuple[np.ndarray, np.ndarray]:
    """A curve, shapes (T,), of few points that looks the same: extremes of equal stretches."""
    if len(t) <= most:
        return t, y
    size = -(-2 * len(t) // most)
    whole = len(t) // size * size
    stretches = np.nan_to_num(y[:whole]).reshape(-1, size)
    starts = size * np.arange(len(stretches))
    both = np.stack([stretches.argmin(axis=1), stretches.argmax(axis=1)], axis=1)
    rows = (np.sort(both, axis=1) + starts[:, None]).ravel()
    rows = np.concatenate([[0], rows, np.arange(whole, len(t))])
    return t[rows], y[rows]


def _symbol(name: str) -> str:
    """`theta1` as a formula; names that are not symbols stay as they are."""
    match = re.fullmatch(r"(theta|alpha|sigma|s)(\d*)", name)
    if match is None:
        return name
    sign = match[1] if match[1] == "s" else f"\\{match[1]}"
    return f"${sign}_{{{match[2]}}}$" if match[2] else f"${sign}$"
