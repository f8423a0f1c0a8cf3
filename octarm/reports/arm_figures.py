"""Figures of arms: rest, reach and modes of one, and how chains of modules approach a rod."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from octarm.arm.kinematics import positions
from octarm.arm.modes import Mode
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import hold
from octarm.arm.summary import ArmSummary
from octarm.errors import printable
from octarm.reports import figures
from octarm.reports.figures import COLORS, INK, LINE, MARKERS, Axes, Figure, Picture

Motions = Mapping[str, tuple[np.ndarray, str]]
_DRAWN = 4  # modes
_BEND = 2.0  # of the whole arm at most, as it is drawn [rad]
_BELOW: Any = {"loc": "upper left", "bbox_to_anchor": (0.0, -0.16), "borderaxespad": 0.0}
_SWING = 0.25  # share of the length by which a mode is drawn
_STYLES: dict[str, dict[str, Any]] = {
    "rod": {"color": INK, "linewidth": 3.2, "alpha": 0.35},
    "first": {"color": COLORS[0], "linewidth": 1.3},
    "second": {"color": COLORS[1], "linewidth": 1.3},
    "first, coarse": {"color": COLORS[0], "linewidth": 1.3, "linestyle": (0, (5, 2))},
    "second, coarse": {"color": COLORS[1], "linewidth": 1.3, "linestyle": (0, (5, 2))},
    "dots": {"color": COLORS[2], "marker": "o", "markersize": 3.0, "markevery": 8, "linewidth": 0},
}
_LEVELS = (5.0, 1.0)  # [%], which are marked


def arm_figure(summary: ArmSummary) -> Picture:
    """The picture of one arm, as PNG and SVG."""
    name = summary.arm.name or "arm"
    with figures.figure_style():
        figure, panels = figures.panels_of(3, 4.4)
        _draw_rest(panels[0], summary)
        _draw_modes(panels[1], summary)
        _draw_rates(panels[2], summary)
        title = printable(next(iter(summary.lines())), 90)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
        return figures.save_figure("arm", f"{name}: rest, reach, modes", figure)


def _draw_rest(ax: Axes, summary: ArmSummary) -> None:
    p, n = summary.arm.parameters, summary.arm.parameters.modules
    free = np.concatenate([p.rest_length, p.rest_angle])
    _draw_arm(ax, p, free, LINE, "without weight")
    for side, most in zip((-1.0, 1.0), np.abs(summary.reach.alike), strict=True):
        bend = min(_BEND / n, most)
        _, pose = hold(p, np.full(n, side * bend))
        of = f" (at most {most:.3g})" if bend < most < 2.0 * np.pi else ""
        label = None if side < 0.0 else f"held, {bend:.2g} rad each{of}"
        _draw_arm(ax, p, pose, COLORS[0], label)
    _draw_arm(ax, p, summary.rest, INK, "hanging", plates=True)
    _finish(ax, "at rest, and bent alike")


def _draw_modes(ax: Axes, summary: ArmSummary) -> None:
    p = summary.arm.parameters
    _draw_arm(ax, p, summary.rest, INK, None)
    bending = [(k, m) for k, m in enumerate(summary.modes, 1) if m.slides < 0.5][:_DRAWN]
    for color, (k, mode) in zip(COLORS, bending, strict=False):
        label = f"{k}: {mode.frequency:.3g} Hz"
        _draw_arm(ax, p, _swung(summary, mode), color, label)
    _finish(ax, "slowest bending modes")


def _swung(summary: ArmSummary, mode: Mode) -> np.ndarray:
    """The arm moved along a mode by a fixed share of its length, shape (2N,)."""
    rest, shape = summary.rest, mode.shape
    p = summary.arm.parameters
    length = float(np.sum(p.rest_length))
    small = 1e-6 * length
    moved = _line(p, rest + small * shape) - _line(p, rest)
    travel = np.max(np.linalg.norm(moved, axis=-1)) / small
    largest = float(np.max(np.abs(shape[len(rest) // 2 :])))
    size = min(_SWING * length / max(travel, 1e-12), 0.8 / max(largest, 1e-12))
    return rest + size * shape


def _draw_rates(ax: Axes, summary: ArmSummary) -> None:
    for slides, color, marker in ((False, COLORS[0], "o"), (True, COLORS[1], "s")):
        group = [mode for mode in summary.modes if (mode.slides > 0.5) == slides]
        if group:
            rates = [m.frequency for m in group], [m.damping_ratio for m in group]
            ax.plot(*rates, marker, color=color, label="slides" if slides else "bends")
    rates = np.array([(mode.frequency, mode.damping_ratio) for mode in summary.modes]).T
    for which, values in zip("xy", rates, strict=True):
        figures.choose_scale(ax, which, values, signed=False)
    ax.set_xlabel("natural frequency [Hz]")
    ax.set_ylabel("damping ratio")
    ax.set_title("modes")
    ax.legend(**_BELOW)


def _line(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """The base, the ends of the modules and the tip, shape (N + 2, 2) [m]."""
    ends = positions(q)
    angle = np.sum(q[p.modules :])
    tip = ends[-1] + p.tip_length * np.array([np.cos(angle), np.sin(angle)])
    return np.concatenate([np.zeros((1, 2)), ends, tip[None]])


def _draw_arm(
    ax: Axes, p: ArmParameters, q: np.ndarray, color: str, label: str | None, plates: bool = False
) -> None:
    """A line through the ends of the modules, to the right and down."""
    points = 1e3 * _line(p, q)
    ax.plot(points[:, 1], -points[:, 0], color=color, label=label, linewidth=1.6)
    if plates:
        angles = np.cumsum([0.0, *q[p.modules :]])
        widths = np.array([p.widths[0], *p.widths])
        half = 500.0 * widths * np.array([-np.sin(angles), np.cos(angles)])  # x down, y right
        ends = np.stack([points[:-1].T - half, points[:-1].T + half])
        ax.plot(ends[:, 1], -ends[:, 0], color=color)


def _finish(ax: Axes, title: str) -> None:
    ax.set_title(title)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("to the side [mm]")
    ax.set_ylabel("height [mm]")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(**_BELOW)


def rod_figures(
    modules: Sequence[int],
    errors: Mapping[str, Mapping[str, np.ndarray]],
    motions: Sequence[tuple[str, Motions]],
    duration: float,
) -> Iterator[Picture]:
    """The figures of `octarm validate --rod`: errors, and a rod that is let go.

    There are errors for each case and each layout, of shape (m,) [1] for m numbers of modules, NaN
    where there is none. Motions have the title of a panel, and the tips in it by name, shape (T, 2)
    [m] with x along and y across, each with the name of a style, see `_STYLES`, and a duration [s].
    """
    with figures.figure_style():
        caption = "Errors of chains of N modules against the rod, with slopes 1/N and 1/N²."
        yield figures.save_figure("convergence", caption, _convergence(modules, errors))
        caption = "The tip of an undamped rod that is let go under its weight across."
        yield figures.save_figure("release", caption, _release(motions, duration))


def _convergence(modules: Sequence[int], errors: Mapping[str, Mapping[str, np.ndarray]]) -> Figure:
    figure, panels = figures.panels_of(len(errors), 2.15, sharex=True, sharey=True)
    n = np.array(modules, dtype=float)
    for (case, layouts), ax in zip(errors.items(), panels, strict=True):
        for order in (1, 2):
            ax.plot(n, 100.0 * n**-order, color=LINE, linewidth=1.6, zorder=0)
        for level in _LEVELS:
            ax.axhline(level, color=LINE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
        for i, (layout, values) in enumerate(layouts.items()):
            look = {"color": COLORS[i], "marker": MARKERS[i], "markeredgewidth": 0.0}
            ax.plot(n, 100.0 * np.abs(values), label=layout, **look)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.grid(False)
        figures.logarithmic_ticks(ax.yaxis, 0.01, 100.0)
        ax.yaxis.set_major_formatter("{x:g} %")
        ax.set_xticks(n, [f"{k:g}" for k in n])
        ax.minorticks_off()
        ax.set_ylim(0.004, 400.0)
        ax.set_title(case)
    figures.name_axes(panels, "modules N", "error")
    for order, name, at in ((1, "1/N", 5.5), (2, "1/N²", 11.0)):  # where no curve is
        panels[-2].text(at, 130.0 * at**-order, name, color="#8c8c8c", fontsize=8)
    figures.add_legend(figure, panels[0])
    return figure


def _release(motions: Sequence[tuple[str, Motions]], duration: float) -> Figure:
    figure, panels = figures.panels_of(len(motions), 2.7)
    figure.set_figwidth(5.2 * len(motions))
    for (title, tips), ax in zip(motions, panels, strict=True):
        for name, (tip, style) in tips.items():
            t = np.linspace(0.0, duration, len(tip))
            ax.plot(t, 1e3 * tip[:, 1], label=name, **_STYLES[style])
        ax.set_title(title)
        ax.set_xlabel("time [s]")
        ax.set_xlim(0.0, duration)
        ax.invert_yaxis()
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, fontsize=7.5)
    panels[0].set_ylabel("sag of the tip [mm]")
    return figure
