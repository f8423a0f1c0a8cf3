"""Figures 1 and 2 of the paper on this arm, and the one that stands in the README."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from octarm.arm.mjcf import coordinate_names, nominal_parameters
from octarm.reports.figures import INK, Axes, Figure
from paper.claims import percent
from paper.drawing import Picture, draw, legend, look, panels, title_of, zero_line
from paper.evidence import Evidence
from paper.measured import MOVING
from paper.series import Series, name_of, readings, shown
from paper.studies import BENDS, MODELS, NOISE, SLIDES
from paper.variants import PROPOSED, SMC

_UNITS = {BENDS: ("rad", "mrad"), SLIDES: ("m", "mm")}
_READING = {BENDS: "theta1 and theta2", SLIDES: "s1 and s2"}


def pictures(evidence: Evidence) -> Iterator[Picture]:
    """Figures 1 and 2 in both readings."""
    for reference in readings(evidence.effort):
        ending = {BENDS: "bends", SLIDES: "slides"}[reference]
        yield draw(
            f"figure-1-{ending}",
            f"Figure 1 of the paper on this arm: tracking of {_READING[reference]} without "
            "disturbance, and the errors, for three nominal models. Nothing is random here.",
            lambda r=reference: _figure(evidence, r, 0.0),
        )
        yield draw(
            f"figure-2-{ending}",
            f"Figure 2 of the paper on this arm: the same under band-limited white noise of 40 % "
            f"of the input's amplitude. Lines are medians, bands hold 5 to 95 % of "
            f"{evidence.seeds} seeds, instant by instant.",
            lambda r=reference: _figure(evidence, r, NOISE),
        )


def headline(evidence: Evidence) -> Picture:
    """The README's picture: errors of theta1 without and with noise."""
    return draw(
        "paper",
        "Errors of theta1 without noise (above) and under 40 % noise (below)",
        lambda: _headline(evidence),
    )


def _figure(evidence: Evidence, reference: str, noise: float) -> Figure:
    joints = MOVING[reference]
    unit, small = _UNITS[reference]
    figure, grid = panels(2 * len(joints), len(MODELS), 3.1, 1.45, sharex=True, sharey="row")
    for column, model in enumerate(MODELS):
        for row, joint in enumerate(joints):
            motion, error = grid[2 * row, column], grid[2 * row + 1, column]
            place = coordinate_names(nominal_parameters().modules).index(joint)
            for label in shown(evidence.effort):
                series = evidence.series[name_of(label, reference)]
                wanted = series.q_d[:, place]
                if label == shown(evidence.effort)[0]:
                    motion.plot(series.t, wanted, color=INK, linewidth=3.2, alpha=0.25,
                                label="desired")  # fmt: skip
                own = series.of(model, noise)[:, :, place]
                _draw(motion, label, series, own)
                _draw(error, label, series, 1e3 * (own - wanted[:, None]))
            zero_line(error)
            if column == 0:
                motion.set_ylabel(f"{joint} [{unit}]")
                error.set_ylabel(f"error [{small}]")
        grid[0, column].set_title(f"nominal model {percent(model)}")
        grid[-1, column].set_xlabel("time [s]")
        grid[-1, column].set_xlim(0.0, evidence.effort.short)
        grid[-1, column].set_xticks(np.arange(evidence.effort.short))
    for row in range(len(joints)):
        _limit(evidence, grid[2 * row + 1, 0], reference, noise, joints[row])
    legend(figure, grid[0, 0])
    figure.align_ylabels(grid[:, 0])
    return figure


def _headline(evidence: Evidence) -> Figure:
    figure, grid = panels(2, len(MODELS), 3.3, 1.75, sharex=True, sharey="row")
    place = nominal_parameters().modules  # theta1
    for row, noise in enumerate((0.0, NOISE)):
        for column, model in enumerate(MODELS):
            ax = grid[row, column]
            for label in (SMC, PROPOSED):
                series = evidence.series[name_of(label, BENDS)]
                own = series.of(model, noise)[:, :, place] - series.q_d[:, None, place]
                _draw(ax, label, series, 1e3 * own)
            zero_line(ax)
            ax.set_xlim(0.0, evidence.effort.short)
            ax.set_xticks(np.arange(evidence.effort.short))
        told = "40 % noise" if noise else "no noise"
        grid[row, 0].set_ylabel(f"error of theta1 [mrad]\n{told}")
    for column, model in enumerate(MODELS):
        grid[0, column].set_title(f"nominal model {percent(model)}")
        grid[1, column].set_xlabel("time [s]")
    legend(figure, grid[0, 0])
    return figure


def _draw(ax: Axes, label: str, series: Series, own: np.ndarray) -> None:
    """A line; for several arms the median and a band."""
    style = look(label)
    low, middle, high = np.percentile(own, [5.0, 50.0, 95.0], axis=1)
    ax.plot(series.t, middle, color=style.color, label=title_of(label), linewidth=1.1)
    if own.shape[1] > 1:
        ax.fill_between(series.t, low, high, color=style.color, alpha=0.22, linewidth=0.0)


def _limit(evidence: Evidence, ax: Axes, reference: str, noise: float, joint: str) -> None:
    """Keeps the errors of SMC within a layer and of the proposed one in view."""
    place = coordinate_names(nominal_parameters().modules).index(joint)
    largest = 0.0
    for label in (SMC, PROPOSED):
        series = evidence.series[name_of(label, reference)]
        late = series.t > 0.5
        for model in MODELS:
            own = series.of(model, noise)[late, :, place] - series.q_d[late, None, place]
            largest = max(largest, float(np.nanpercentile(np.abs(own), 99.9)))
    ax.set_ylim(-1.5e3 * largest, 1.5e3 * largest)
