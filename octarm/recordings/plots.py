"""The standard figures of a run for a paper: tracking, error, inputs, sliding, adaptation."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib
import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.arm.coordinates import planar_coordinates
from octarm.disturbances.spelling import from_entry
from octarm.files import whole_file
from octarm.recordings.channels import Channel, bounds_of, channels_of, has_energy
from octarm.recordings.notes import title_of
from octarm.simulation.trajectory import Trajectory

# Stand for Matplotlib's classes, whose methods leave the types of keyword arguments unknown.
Axes = Any
Figure = Any

COLORS = ["#d1660a", "#1f6fb5", "#2a9461", "#b8408f", "#a08a10", "#6a55c8", "#1b8f8f", "#c24a3a"]
_MOST = 4000  # points a curve; of more only the extremes of each stretch are drawn
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


def write_figures(
    folder: str | os.PathLike[str], run: Trajectory, description: Mapping[str, Any]
) -> list[Path]:
    """Writes each figure as PNG and SVG; a folder that is missing is made.

    There are always `tracking`, `error` and `inputs`; `sliding` if the controller has a sliding
    variable, `adaptation` if it adapts, `disturbance` if something pushed the arm.

    Args:
        folder: where to.
        run: of one arm.
        description: what `run.json` holds.

    Returns:
        The files.

    Raises:
        OSError: if a file cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    with cast(Any, matplotlib).rc_context(_STYLE):
        for name, figure in _Drawing(run, description).figures():
            for kind in ("png", "svg"):
                path = folder / f"{name}.{kind}"
                with whole_file(path) as part:
                    # Without a date equal runs give equal files.
                    metadata = {"Date": None} if kind == "svg" else None
                    figure.savefig(part, format=kind, dpi=200, metadata=metadata)
                written.append(path)
    return written


class _Drawing:
    """Draws the figures of one run."""

    def __init__(self, run: Trajectory, description: Mapping[str, Any]) -> None:
        self._rows, self._t, self._title = dict(run.arrays()), run.t, title_of(description)
        coordinates = planar_coordinates(run.q.shape[1] // 2)
        gains = description.get("controller", {}).get("gains", {})
        disturbances = map(from_entry, description.get("disturbances", []))
        bounds = bounds_of(coordinates, run.layer, gains, disturbances)
        disturbed = bool(run.disturbance.any())
        self._channels = channels_of(self._rows, coordinates, bounds, disturbed=disturbed)

    def figures(self) -> Iterator[tuple[str, Figure]]:
        """The figures by name."""
        rules = [channel for channel in self._channels.values() if channel.kind == "rules"]
        yield "tracking", self._coordinates("q", desired=True)
        yield "error", self._coordinates("error")
        yield "inputs", self._inputs()
        if "s" in self._channels:
            yield "sliding", self._sliding()
        if rules:
            yield "adaptation", self._adaptation(rules)
        if "disturbance" in self._channels:
            yield "disturbance", self._coordinates("disturbance")

    def _coordinates(self, name: str, desired: bool = False) -> Figure:
        """A channel with axes for each of its parts."""
        figure, axes = self._figure(len(self._channels[name].parts))
        self._draw_parts(axes, name, self._channels[name].title, desired)
        return figure

    def _inputs(self) -> Figure:
        """Axes for each module, with both of its columns."""
        channel = self._channels["tau"]
        tau = channel.values(self._rows)
        figure, axes = self._figure(tau.shape[1] // 2, height=1.35)
        for i, ax in enumerate(axes):
            for a, style in ((1, "-"), (2, "--")):
                color = COLORS[i % len(COLORS)]
                self._line(ax, tau[:, 2 * i + a - 1], color, f"column {a}", linestyle=style)
            self._finish(ax, channel, slice(None))
            ax.set_ylabel(f"$\\tau$, module {i + 1} [N]")
        return figure

    def _sliding(self) -> Figure:
        """s, then V if there is one."""
        energy, parts = has_energy(self._channels), self._channels["s"].parts
        figure, axes = self._figure(len(parts) + energy)
        self._draw_parts(axes, "s", "$s$")
        if energy:
            V = np.maximum(self._channels["V"].values(self._rows)[:, 0], 1e-12)
            self._line(axes[-1], V, "#333333", "V")
            axes[-1].set_yscale("log")
            axes[-1].set_ylabel("$V$ [J]")
        return figure

    def _adaptation(self, rules: Sequence[Channel]) -> Figure:
        """Numbers of rules as heat maps over time, then E."""
        gains = len(self._channels["E"].parts) if "E" in self._channels else 0
        figure, axes = self._figure(len(rules) + gains, height=1.5)
        for ax, channel in zip(axes, rules, strict=False):
            self._heat_map(figure, ax, channel)
        if gains:
            self._draw_parts(axes[len(rules) :], "E", "$E$")
        return figure

    def _figure(self, rows: int, height: float = 1.9) -> tuple[Figure, list[Axes]]:
        figure = NewFigure(figsize=(6.3, height * rows + 0.5), layout="constrained")
        axes = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
        axes[0].set_title(self._title, loc="left")
        axes[-1].set_xlabel("time [s]")
        axes[0].set_xlim(self._t[0], self._t[-1] if len(self._t) > 1 else None)
        return figure, axes

    def _draw_parts(
        self, axes: Sequence[Axes], name: str, title: str, desired: bool = False
    ) -> None:
        """The parts of a channel, the last one (bends) above."""
        channel = self._channels[name]
        values, wanted = channel.values(self._rows), self._rows["q_d"]
        for ax, (part, where) in zip(axes, reversed(channel.parts.items()), strict=False):
            for i, j in enumerate(range(len(channel.names))[where]):
                color = COLORS[i % len(COLORS)]
                if desired:
                    self._line(ax, wanted[:, j], color, None, linewidth=3.0, alpha=0.3)
                self._line(ax, values[:, j], color, _symbol(channel.names[j]))
            self._finish(ax, channel, where)
            ax.set_ylabel(f"{title}, {part}{channel.units[part]}" if part else title)

    def _finish(self, ax: Axes, channel: Channel, where: slice) -> None:
        """Lines at the bounds of a part of a channel, and the legend."""
        for y in channel.bound.lines(where) if channel.bound is not None else ():
            ax.axhline(y, color="#555555", linewidth=0.6, linestyle=":")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), handlelength=1.4, borderaxespad=0.2)

    def _heat_map(self, figure: Figure, ax: Axes, channel: Channel) -> None:
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
        names = [name.rsplit("_", 1)[0] for name in channel.names[::rules]]
        ax.set_yticks(rules * np.arange(coordinates) + 0.5 * (rules - 1), map(_symbol, names))
        for j in range(1, coordinates):
            ax.axhline(j * rules - 0.5, color="white", linewidth=1.0)
        ax.grid(False)
        ax.set_ylabel(f"change of {_symbol(channel.name)}")
        figure.colorbar(image, ax=ax, label="share of largest", pad=0.01)

    def _line(self, ax: Axes, y: np.ndarray, color: str, label: str | None, **style: Any) -> None:
        t, y = _thinned(self._t, y)
        ax.plot(t, y, color=color, label=label, **style)


def _thinned(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve of at most `_MOST` points that looks the same: extremes of equal stretches."""
    if len(t) <= _MOST:
        return t, y
    size = -(-2 * len(t) // _MOST)
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
