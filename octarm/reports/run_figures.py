"""The standard figures of a run for a paper: tracking, error, inputs, sliding, adaptation."""

from __future__ import annotations

import itertools
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure as NewFigure
from matplotlib.ticker import MaxNLocator

from octarm.files import write_files
from octarm.palette import MODULES
from octarm.recordings.channels import THOUSANDTHS, Channel, channels_of, has_energy
from octarm.recordings.words import events_of, title_of, wrapped
from octarm.reports import figures
from octarm.reports.figures import FAILED, GRAY, GROUND, INK, Axes, Figure
from octarm.simulation.trajectory import Trajectory

_MOST = 4000  # points a curve; of more only the extremes of each stretch are drawn
_LARGEST = 1e100  # number that an axis shows
_INSTANTS = 1500  # of a heat map at most
_WIDTH = 6.3  # of a figure [inch]
_LETTERS = 82  # of a line of the title
_FAR = 2.0  # times the largest value; a bound beyond that is written, not drawn
_WORDS = {"phi": "φ", "phi / lambda": "φ / λ", "E_max": "E max"}
_GREEK = {"theta": "θ", "alpha": "α", "sigma": "σ"}
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


@np.errstate(all="ignore")  # a diverged arm may hold anything
def write_figures(
    folder: str | os.PathLike[str], run: Trajectory, description: Mapping[str, Any]
) -> list[Path]:
    """Writes each figure as PNG and SVG, all or none; a folder that is missing is made.

    There are always `tracking`, `error` and `inputs`; `sliding` if the controller has a sliding
    variable, `adaptation` if it adapts, `disturbance` if something pushed the arm.

    The run is one of one arm, of which `description` is what `run.json` holds. Returns the files;
    raises OSError if one cannot be written.
    """
    drawn: dict[Path, bytes] = {}
    with figures.figure_style():
        warnings.simplefilter("ignore")  # a number without end is drawn as none
        for name, figure in _Drawing(run, description).figures():
            drawn |= figures.save_figure(name, "", figure).files(Path(folder))
    write_files(drawn)
    return list(drawn)


class _Panel(NamedTuple):
    """One pair of axes: some of the numbers of a channel over time."""

    channel: Channel
    part: slice
    label: str
    unit: str
    styles: Sequence[Mapping[str, str]]  # colour, and label and line style if there are any
    desired: bool = False  # whether q_d is drawn as well
    logarithmic: bool = False


class _Drawing:
    def __init__(self, run: Trajectory, description: Mapping[str, Any]) -> None:
        self._rows, self._t = dict(run.arrays()), run.t
        self._title = wrapped(title_of(description), _LETTERS)
        self._events = [(at, text) for at, _, text in events_of(description) if text]
        if run.status != "ok":
            self._events.append((float(run.t[-1]), run.status))
        disturbed = bool(run.disturbance.any())
        self._channels = channels_of(self._rows, description, run.layer, disturbed=disturbed)

    def figures(self) -> Iterator[tuple[str, Figure]]:
        rules = [channel for channel in self._channels.values() if channel.kind == "rules"]
        yield "tracking", self._figure(self._panels("q", desired=True))
        yield "error", self._figure(self._panels("error"))
        yield "inputs", self._figure(self._inputs(), height=1.35)
        if "s" in self._channels:
            panels = list(self._panels("s"))
            if has_energy(self._channels):
                V, style = self._channels["V"], {"color": "#333333"}
                panels.append(_Panel(V, slice(None), "V", "J", [style], logarithmic=True))
            yield "sliding", self._figure(panels)
        if rules:
            yield "adaptation", self._figure([*rules, *self._panels("E")], height=1.5)
        if "disturbance" in self._channels:
            yield "disturbance", self._figure(self._panels("disturbance"))

    def _panels(self, name: str, desired: bool = False) -> Iterator[_Panel]:
        if (channel := self._channels.get(name)) is not None:
            for part, where in channel.parts.items():
                looks = zip(channel.names[where], itertools.cycle(MODULES), strict=False)
                styles = [{"color": color, "label": _symbol(name)} for name, color in looks]
                unit = channel.units[part].strip(" []")
                yield _Panel(channel, where, channel.label(part), unit, styles, desired)

    def _inputs(self) -> Iterator[_Panel]:
        channel = self._channels["tau"]
        modules = zip(range(len(channel.names) // 2), itertools.cycle(MODULES), strict=False)
        for i, color in modules:
            first = {"color": color, "label": "column 1", "linestyle": "-"}
            styles = [first, {**first, "label": "column 2", "linestyle": "--"}]
            yield _Panel(channel, slice(2 * i, 2 * i + 2), f"τ, module {i + 1}", "N", styles)

    def _figure(self, panels: Iterable[_Panel | Channel], height: float = 1.9) -> Figure:
        """Panels one below another; a channel of rules becomes a heat map."""
        panels = list(panels)
        room = 0.5 + 0.16 * self._title.count("\n")
        size = (_WIDTH, height * len(panels) + room)
        figure: Figure = NewFigure(figsize=size, layout="constrained")
        axes = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
        figure.suptitle(self._title, x=0.01, ha="left", fontsize=9, fontweight="bold")
        axes[-1].set_xlabel("time [s]")
        if len(self._t) > 1:
            axes[0].set_xlim(self._t[0], 2.0 * self._t[-1] - self._t[-2])
        for ax, panel in zip(axes, panels, strict=True):
            if isinstance(panel, Channel):
                self._draw_rules(figure, ax, panel)
            else:
                self._draw_curves(ax, panel)
            self._draw_events(ax, named=ax is axes[0])
        figure.align_ylabels(axes)
        return figure

    def _draw_events(self, ax: Axes, *, named: bool) -> None:
        for at, text in self._events:
            color = FAILED if at >= self._t[-1] else INK
            ax.axvline(at, color=color, linewidth=1.0, linestyle=(0, (4, 2)), clip_on=False)
            if named:  # within the figure
                share = (at - self._t[0]) / max(self._t[-1] - self._t[0], 1e-9)
                side = "left" if share < 0.1 else "right" if share > 0.9 else "center"
                ax.annotate(
                    text, (at, 1.0), (0, 1), xycoords=("data", "axes fraction"), va="bottom",
                    textcoords="offset points", ha=side, fontsize=7.5, color=color,
                )  # fmt: skip

    def _draw_curves(self, ax: Axes, panel: _Panel) -> None:
        values = _drawable(panel.channel.values(self._rows)[:, panel.part])
        desired = _drawable(self._rows["q_d"][:, panel.part]) if panel.desired else values
        largest = float(np.max(np.abs(np.nan_to_num(np.stack([values, desired])))))
        scale, unit = 1.0, panel.unit
        if unit in THOUSANDTHS and (largest < 0.1 or unit == "m") and largest > 0.0:
            scale, unit = 1e3, THOUSANDTHS[unit]  # lengths are in mm however large
        if panel.logarithmic:
            values = np.maximum(values, 1e-12 * max(largest, 1e-12))
            ax.set_yscale("log")
            ends = float(np.nanmin(values)) * scale, float(np.nanmax(values)) * scale
            figures.logarithmic_ticks(ax.yaxis, *ends)
        else:
            ax.yaxis.set_major_locator(MaxNLocator(5, min_n_ticks=3))
        for style, y, y_d in zip(panel.styles, values.T, desired.T, strict=True):
            if panel.desired:
                ax.plot(*thinned(self._t, scale * y_d), color=style["color"], linewidth=3.0,
                        alpha=0.3)  # fmt: skip
            ax.plot(*thinned(self._t, scale * y), **{"linewidth": 1.0, **style})
        if panel.desired:
            ax.plot([], [], color=GRAY, linewidth=3.0, alpha=0.5, label="desired")
        self._draw_bound(ax, panel, largest, scale, unit)
        if "label" in panel.styles[0]:
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), handlelength=1.4,
                      borderaxespad=0.2)  # fmt: skip
        kind = " (log)" if panel.logarithmic else ""
        ax.set_ylabel(f"{panel.label}{f' [{unit}]' if unit else ''}{kind}")

    def _draw_bound(self, ax: Axes, panel: _Panel, largest: float, scale: float, unit: str) -> None:
        """Lines at the bound of a channel, or its size in words when it is far off."""
        if (bound := panel.channel.bound) is None:
            return
        word = _WORDS.get(bound.word, bound.word)
        lines = [y for y in bound.lines(panel.part) if abs(y) < _LARGEST]
        near = [y for y in lines if abs(y) <= _FAR * largest]
        for y in near:
            label = word if y == near[0] else None
            ax.axhline(scale * y, color=GRAY, linewidth=0.8, linestyle=":", label=label)
        far = sorted({abs(y) for y in lines} - {abs(y) for y in near})
        if far:
            sizes = " to ".join(dict.fromkeys(f"{scale * y:.4g}" for y in (far[0], far[-1])))
            ax.text(
                0.995, 0.03, f"{word} = {sizes} {unit}, off the axis", transform=ax.transAxes,
                ha="right", va="bottom", fontsize=7, color=GRAY, zorder=3,
                bbox={"facecolor": GROUND, "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
            )  # fmt: skip

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
        image = ax.imshow(shade, aspect="auto", cmap="RdBu_r", vmin=-1, vmax=1, extent=extent,
                          rasterized=True, interpolation="nearest")  # fmt: skip
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
    """`theta1` as a symbol; names that are not symbols stay as they are."""
    match = re.fullmatch(r"(theta|alpha|sigma|s)(\d*)", name)
    if match is None:
        return name
    return _GREEK.get(match[1], match[1]) + match[2].translate(_SUBSCRIPTS)
