"""A picture of an arm: how it hangs, how far it bends, its modes and where they lie."""

from __future__ import annotations

from typing import Any

import numpy as np

from octarm.arm.kinematics import positions
from octarm.arm.modes import Mode
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import hold
from octarm.arm.summary import ArmSummary
from octarm.errors import printable
from octarm.reports.figures import (
    COLORS,
    INK,
    LINE,
    Axes,
    Picture,
    choose_scale,
    figure_style,
    panels_of,
    save_figure,
)

_DRAWN = 4  # modes
_BEND = 2.0  # of the whole arm at most, as it is drawn [rad]
_BELOW: Any = {"loc": "upper left", "bbox_to_anchor": (0.0, -0.16), "borderaxespad": 0.0}
_SWING = 0.25  # share of the length by which a mode is drawn


def arm_figure(summary: ArmSummary) -> Picture:
    """The picture of one arm, as PNG and SVG."""
    name = summary.arm.name or "arm"
    with figure_style():
        figure, panels = panels_of(3, 4.4)
        _draw_rest(panels[0], summary)
        _draw_modes(panels[1], summary)
        _draw_rates(panels[2], summary)
        title = printable(next(iter(summary.lines())), 90)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
        return save_figure("arm", f"{name}: rest, reach, modes", figure)


def _draw_rest(ax: Axes, summary: ArmSummary) -> None:
    """The arm hanging, without weight, and bent as far as the input range allows."""
    p, n = summary.arm.parameters, summary.arm.parameters.modules
    free = np.concatenate([p.rest_length, p.rest_angle])
    _draw_arm(ax, p, free, LINE, "without weight", plates=False)
    for side, most in zip((-1.0, 1.0), np.abs(summary.reach.alike), strict=True):
        bend = min(_BEND / n, most)
        _, pose = hold(p, np.full(n, side * bend))
        of = f" (at most {most * n:.2g})" if bend < most < 2.0 * np.pi else ""
        label = None if side < 0.0 else f"held, bent by {bend * n:.2g} rad{of}"
        _draw_arm(ax, p, pose, COLORS[0], label, plates=False)
    _draw_arm(ax, p, summary.rest, INK, "hanging", plates=True)
    ax.set_title("at rest, and bent alike")
    _finish(ax)


def _draw_modes(ax: Axes, summary: ArmSummary) -> None:
    """Shapes of the slowest modes that bend the arm, side by side on it."""
    p = summary.arm.parameters
    _draw_arm(ax, p, summary.rest, INK, None, plates=False)
    bending = [(k, m) for k, m in enumerate(summary.modes, 1) if m.slides < 0.5][:_DRAWN]
    for color, (k, mode) in zip(COLORS, bending, strict=False):
        label = f"{k}: {mode.frequency:.3g} Hz"
        _draw_arm(ax, p, _swung(summary, mode), color, label, plates=False)
    ax.set_title("slowest bending modes")
    _finish(ax)


def _swung(summary: ArmSummary, mode: Mode) -> np.ndarray:
    """The arm moved along a mode by a fixed share of its length, shape (2N,)."""
    rest, shape = summary.rest, mode.shape
    length = float(np.sum(summary.arm.parameters.rest_length))
    small = 1e-6 * length
    moved = _line(summary.arm.parameters, rest + small * shape)
    travel = np.max(np.linalg.norm(moved - _line(summary.arm.parameters, rest), axis=-1)) / small
    largest = float(np.max(np.abs(shape[len(rest) // 2 :])))
    size = min(_SWING * length / max(travel, 1e-12), 0.8 / max(largest, 1e-12))
    return rest + size * shape


def _draw_rates(ax: Axes, summary: ArmSummary) -> None:
    """Natural frequency and damping ratio of all modes."""
    for slides, color, marker in ((False, COLORS[0], "o"), (True, COLORS[1], "s")):
        group = [mode for mode in summary.modes if (mode.slides > 0.5) == slides]
        if group:
            rates = [m.frequency for m in group], [m.damping_ratio for m in group]
            ax.plot(*rates, marker, color=color, label="slides" if slides else "bends")
    known = np.array([mode.frequency for mode in summary.modes])
    choose_scale(ax, "x", known, signed=False)
    ax.set_xlabel("natural frequency [Hz]")
    ax.set_ylabel("damping ratio")
    choose_scale(ax, "y", np.array([mode.damping_ratio for mode in summary.modes]), signed=False)
    ax.set_title("modes")
    ax.legend(**_BELOW)


def _line(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """The base, the ends of the modules and the tip, shape (N + 2, 2) [m]."""
    ends = positions(q)
    angle = np.sum(q[p.modules :])
    tip = ends[-1] + p.tip_length * np.array([np.cos(angle), np.sin(angle)])
    return np.concatenate([np.zeros((1, 2)), ends, tip[None]])


def _draw_arm(
    ax: Axes, p: ArmParameters, q: np.ndarray, color: str, label: str | None, *, plates: bool
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


def _finish(ax: Axes) -> None:
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("to the side [mm]")
    ax.set_ylabel("height [mm]")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(**_BELOW)
