"""The standard figures of a run for a paper: tracking, error, inputs, sliding, adaptation."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

import matplotlib
import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.files import whole_file
from octarm.recordings.channels import Channel, bound_lines, bounds_of, channels_of, values_of
from octarm.recordings.notes import title_of
from octarm.simulation.trajectory import Trajectory

# Stand for Matplotlib's classes, whose methods leave the types of keyword arguments unknown.
Axes = Any
Figure = Any

COLORS = ["#d1660a", "#1f6fb5", "#2a9461", "#b8408f", "#a08a10", "#6a55c8", "#1b8f8f", "#c24a3a"]
_MOST = 4000  # points a curve; of more only the extremes of each stretch are drawn
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

    The figures are `tracking`, `error` and `inputs`; `sliding` if the controller has a sliding
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
        for name, figure in figures(run, description):
            for kind in ("png", "svg"):
                path = folder / f"{name}.{kind}"
                with whole_file(path) as part:
                    # Without a date equal runs give equal files.
                    metadata = {"Date": None} if kind == "svg" else None
                    figure.savefig(part, format=kind, dpi=200, metadata=metadata)
                written.append(path)
    return written


def figures(run: Trajectory, description: Mapping[str, Any]) -> Iterator[tuple[str, Figure]]:
    """The figures of a run by name."""
    draw = _Drawing(run, description)
    yield "tracking", draw.halves("q", desired=True)
    yield "error", draw.halves("error")
    yield "inputs", draw.inputs()
    if "s" in draw.channels:
        yield "sliding", draw.sliding()
    if any(channel.kind == "rules" for channel in draw.channels.values()):
        yield "adaptation", draw.adaptation()
    if "disturbance" in draw.channels:
        yield "disturbance", draw.halves("disturbance")


class _Drawing:
    """What figures are made of."""

    def __init__(self, run: Trajectory, description: Mapping[str, Any]) -> None:
        disturbed = bool(run.disturbance.any())
        self.run, self._title = run, title_of(description)
        self.channels = channels_of(run, disturbed=disturbed)
        self._values = values_of(run, disturbed=disturbed)
        self._bounds = bounds_of(description, run.q.shape[1])

    def halves(self, name: str, desired: bool = False) -> Figure:
        """Bends above slides."""
        figure, axes = self._figure(2)
        for ax, part in zip(axes, ("bends", "slides"), strict=True):
            self._half(ax, name, part, desired)
            ax.set_ylabel(f"{self.channels[name].title}, {part}{self.channels[name].unit(part)}")
        return figure

    def inputs(self) -> Figure:
        """Both columns of each module."""
        n = self.run.q.shape[1] // 2
        figure, axes = self._figure(n, height=1.35)
        tau, bound = self._values["tau"], self._bounds.get("tau")
        for i, ax in enumerate(axes):
            for a, style in ((1, "-"), (2, "--")):
                color = COLORS[i % len(COLORS)]
                self._line(ax, tau[:, 2 * i + a - 1], color, f"column {a}", linestyle=style)
            if bound is not None:
                for y in bound_lines("tau", bound, "all"):
                    ax.axhline(y, color="#555555", linewidth=0.6, linestyle=":")
            ax.set_ylabel(f"$\\tau$, module {i + 1} [N]")
            _legend(ax)
        return figure

    def sliding(self) -> Figure:
        """s, then V if there is one."""
        has_energy = "V" in self.channels and self.channels["V"].kind == "scalar"
        figure, axes = self._figure(3 if has_energy else 2)
        for ax, part in zip(axes, ("bends", "slides"), strict=False):
            self._half(ax, "s", part, False)
            ax.set_ylabel(f"$s$, {part}{self.channels['s'].unit(part)}")
        if has_energy:
            V = np.maximum(self._values["V"][:, 0], 1e-12)
            self._line(axes[2], V, "#333333", "V")
            axes[2].set_yscale("log")
            axes[2].set_ylabel("$V$ [J]")
        return figure

    def adaptation(self) -> Figure:
        """Numbers of rules as heat maps over time, then E."""
        rules = [c for c in self.channels.values() if c.kind == "rules"]
        has_gain = "E" in self.channels
        figure, axes = self._figure(len(rules) + 2 * has_gain, height=1.5)
        for ax, channel in zip(axes, rules, strict=False):
            self._heat(figure, ax, channel)
        for ax, part in zip(axes[len(rules) :], ("bends", "slides"), strict=False):
            self._half(ax, "E", part, False)
            ax.set_ylabel(f"$E$, {part}{self.channels['E'].unit(part)}")
        return figure

    def _figure(self, rows: int, height: float = 1.9) -> tuple[Figure, list[Axes]]:
        figure = NewFigure(figsize=(6.3, height * rows + 0.5), layout="constrained")
        axes = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
        axes[0].set_title(self._title, loc="left")
        axes[-1].set_xlabel("time [s]")
        axes[0].set_xlim(self.run.t[0], self.run.t[-1] if len(self.run) > 1 else None)
        return figure, axes

    def _half(self, ax: Axes, name: str, part: str, desired: bool) -> None:
        channel = self.channels[name]
        values, half = self._values[name], channel.half(part)
        n = len(channel.names) // 2
        for i, label in enumerate(channel.names[half]):
            color = COLORS[i % len(COLORS)]
            j = i + (half.start or 0)
            if desired:
                wanted = self._values["q_d"][:, j]
                self._line(ax, wanted, color, None, linewidth=3.0, alpha=0.3)
            self._line(ax, values[:, j], color, _symbol(label))
        if name in self._bounds and n:
            for y in bound_lines(name, self._bounds[name], part):
                ax.axhline(y, color="#555555", linewidth=0.6, linestyle=":")
        _legend(ax)

    def _heat(self, figure: Figure, ax: Axes, channel: Channel) -> None:
        """The change of numbers of rules; colours by the largest of each coordinate."""
        values = np.nan_to_num(self._values[channel.name])
        values = values - values[0]
        few = np.linspace(0, len(values) - 1, min(len(values), 1500)).astype(int)
        values = values[few].T
        coordinates = self.run.q.shape[1]
        rules = len(values) // coordinates
        largest = np.abs(values).reshape(coordinates, -1).max(axis=1)
        shade = values / np.maximum(np.repeat(largest, rules), 1e-300)[:, None]
        extent = (float(self.run.t[0]), float(self.run.t[-1]), len(values) - 0.5, -0.5)
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
        t, y = _thinned(self.run.t, y)
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


def _legend(ax: Axes) -> None:
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), handlelength=1.4, borderaxespad=0.2)


def _symbol(name: str) -> str:
    """`theta1` as a formula."""
    for word, sign in (
        ("theta", "\\theta"),
        ("alpha", "\\alpha"),
        ("sigma", "\\sigma"),
        ("s", "s"),
    ):
        rest = name.removeprefix(word)
        if rest != name and (rest.isdigit() or not rest):
            return f"${sign}_{{{rest}}}$" if rest else f"${sign}$"
    return name
