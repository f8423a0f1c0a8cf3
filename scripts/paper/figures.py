"""The figures of the studies: overshoot, ranking, ablations, degradation, beyond, drift, rates."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from octarm.reports.figures import Axes, Figure
from octarm.reports.statistics import Interval
from paper.claims import percent
from paper.drawing import (
    Picture,
    draw,
    legend,
    logarithmic,
    look,
    panels,
    title_of,
    zero_line,
)
from paper.evidence import Evidence
from paper.measured import MOVING, Cell
from paper.quantities import error_mean, error_of
from paper.series import LONG
from paper.studies import BENDS, BEYOND, MODELS, NOISE, RATE, SLIDES, WRONG, study_of_rate
from paper.variants import CONTROLLERS, PROPOSED, SIGN, SMC, by_hand


def pictures(evidence: Evidence) -> Iterator[Picture]:
    """All figures that there are numbers for; figures 1 and 2 stand in `paper.tracking`."""
    yield draw(
        "overshoot",
        "Overshoot without noise over the error of the nominal model, in both readings. The "
        "paper's 3 % is the dotted line.",
        lambda: _overshoot(evidence),
    )
    yield draw(
        "ranking",
        "Error of the controllers with the gains they are shipped with, theta1 and theta2, in "
        "percent of the motion: without noise (hollow) and with 40 % noise (full, medians over "
        "seeds with 95 % intervals), for the three nominal models.",
        lambda: _ranking(evidence),
    )
    yield draw(
        "ablations",
        "Error under 40 % noise over that of afsmc, seed by seed, with 95 % intervals; left of 1 "
        "is better than afsmc.",
        lambda: _ablations(evidence),
    )
    if evidence.effort.noises:
        yield draw(
            "degradation",
            f"Error over the strength of the noise, model at {percent(WRONG)}: medians over seeds "
            "and their 95 % intervals. The paper's noise is the dotted line.",
            lambda: _degradation(evidence),
        )
    if evidence.effort.complete:
        yield draw(
            "beyond",
            f"Beyond the paper: payload at the tip, delay of actuation, loss of force of all "
            f"columns; tuned gains, model at {percent(WRONG)}, no noise. A curve ends where the "
            "arm leaves its limits.",
            lambda: _beyond(evidence),
        )
        yield draw(
            "rates",
            f"Control at other rates with gains that were tuned at 2 kHz, model at "
            f"{percent(WRONG)}: error and chattering with 40 % noise, and chattering without.",
            lambda: _rates(evidence),
        )
    if evidence.effort.long:
        yield draw(
            "drift",
            "The gain E of theta1 under 40 % noise with and without safeguards: medians and "
            "5-95 % bands over seeds, and the arms that are left.",
            lambda: _drift(evidence),
        )


def _overshoot(evidence: Evidence) -> Figure:
    readings = [(r, j) for r in (BENDS, SLIDES) for j in MOVING[r]]
    figure, grid = panels(1, len(readings), 2.6, 2.5)
    models = np.array(evidence.effort.mismatches)
    for ax, (reference, joint) in zip(grid[0], readings, strict=True):
        for label in (SMC, by_hand(SMC), PROPOSED, by_hand(PROPOSED)):
            cells = [Cell(label, reference=reference, mismatch=m) for m in models.tolist()]
            if all(map(evidence.measured.has, cells)):
                y = [evidence.measured.median(c, f"overshoot_{joint}").value for c in cells]
                _line(ax, label, 100.0 * models, np.array(y), marker=False)
        zero_line(ax)
        ax.axhline(3.0, color="#5f6b77", linewidth=0.9, linestyle=":")
        ax.set_title(f"overshoot of {joint} [%]")
        ax.set_xlabel("error of the nominal model [%]")
    legend(figure, grid[0, 0])
    return figure


def _ranking(evidence: Evidence) -> Figure:
    known = [n for n in CONTROLLERS if evidence.measured.has(Cell(n, noise=NOISE))]
    order = sorted(known, key=lambda name: error_mean(evidence, name, NOISE).value)
    figure, grid = panels(1, len(MODELS), 3.1, 0.25 * len(order) + 0.6, sharey=True, sharex=True)
    for ax, model in zip(grid[0], MODELS, strict=True):
        for place, name in enumerate(order):
            noisy, quiet = (Cell(name, mismatch=model, noise=n) for n in (NOISE, 0.0))
            _dot(ax, name, error_of(evidence, noisy), place)
            value = 100.0 * evidence.measured.median(quiet, "error").value
            ax.plot(value, place, "o", color=look(name).color, fillstyle="none")
        logarithmic(ax, "x")
        ax.set_title(f"nominal model {percent(model)}")
        ax.set_xlabel("error [% of the motion]")
        ax.set_yticks(range(len(order)), order)
        ax.tick_params(axis="y", length=0)
    grid[0, 0].invert_yaxis()
    return figure


def _ablations(evidence: Evidence) -> Figure:
    labels = ["afsmc-consequent", SMC, "smc-integral", *evidence.cast.ablations]
    labels = [n for n in labels if evidence.measured.has(Cell(n, noise=NOISE))]
    readings = [
        r
        for r in (BENDS, SLIDES)
        if any(evidence.measured.has(Cell(n, reference=r, noise=NOISE)) for n in labels)
    ]
    figure, grid = panels(1, len(readings), 4.6, 0.42 * len(labels) + 0.7, sharey=True)
    shades = {-0.3: ("o", -0.2), 0.0: ("s", 0.0), 0.3: ("^", 0.2)}
    for ax, reference in zip(grid[0], readings, strict=True):
        for place, label in enumerate(labels):
            for model, (marker, shift) in shades.items():
                own = Cell(label, reference=reference, mismatch=model, noise=NOISE)
                if evidence.measured.has(own):
                    base = own._replace(label=PROPOSED)
                    ratio = evidence.measured.ratio(own, base, "error")
                    _dot(ax, label, ratio, place + shift, marker)
        ax.axvline(1.0, color="#5f6b77", linewidth=0.9, linestyle=":")
        ax.set_xscale("log")
        ax.set_title(", ".join(MOVING[reference]))
        ax.set_xlabel("error over that of afsmc")
        ax.set_yticks(range(len(labels)), [title_of(label) for label in labels])
        ax.tick_params(axis="y", length=0)
    for model, (marker, _) in shades.items():
        grid[0, 0].plot([], [], marker, color="#5f6b77", label=f"nominal model {percent(model)}")
    grid[0, 0].invert_yaxis()
    _plain_ticks(grid[0])
    legend(figure, grid[0, 0])
    return figure


def _degradation(evidence: Evidence) -> Figure:
    figure, grid = panels(1, 2, 4.2, 2.8)
    noises = [0.0, *evidence.effort.noises]
    labels = [
        n for n in CONTROLLERS if evidence.measured.has(Cell(n, "degradation", mismatch=WRONG))
    ]
    for ax, quantity, title in zip(
        grid[0],
        ("error", "rms_error_theta1"),
        ("error of all joints [% of the motion]", "rms error of theta1 [mrad]"),
        strict=True,
    ):
        for label in labels:
            cells = [Cell(label, "degradation", mismatch=WRONG, noise=n) for n in noises]
            own = [evidence.measured.median(cell, quantity) for cell in cells]
            factor = 100.0 if quantity == "error" else 1e3
            _band(ax, label, 100.0 * np.array(noises), own, factor)
        ax.axvline(100.0 * NOISE, color="#5f6b77", linewidth=0.9, linestyle=":")
        ax.set_title(title)
        ax.set_xlabel("rms of the noise [% of the input's amplitude]")
        ax.set_ylim(0.0, None)
    legend(figure, grid[0, 0])
    return figure


def _beyond(evidence: Evidence) -> Figure:
    figure, grid = panels(1, len(BEYOND), 3.3, 2.9)
    units = {"payload": ("payload [kg]", 1.0), "delay": ("delay [ms]", 1e3),
             "loss": ("loss of force [%]", 100.0)}  # fmt: skip
    for ax, (name, (axis, values, _)) in zip(grid[0], BEYOND.items(), strict=True):
        field, (title, factor) = axis.removeprefix("actuation-"), units[name]
        for label in CONTROLLERS:
            start = Cell(label, "beyond", mismatch=WRONG)
            own = [error_of(evidence, start._replace(**{field: value})).value for value in values]
            _line(ax, label, factor * np.array(values), np.array(own))
        logarithmic(ax, "y")
        ax.set_xlabel(title)
        ax.set_title("error [% of the motion]")
    legend(figure, grid[0, 0])
    figure.set_figheight(figure.get_figheight() + 0.3)
    return figure


def _rates(evidence: Evidence) -> Figure:
    figure, grid = panels(1, 3, 3.2, 2.6)
    rates = np.array(sorted({*evidence.effort.rates, RATE}))
    labels = (PROPOSED, SMC, "super-twisting", SIGN)
    shown = (("error", NOISE, "error, 40 % noise [% of the motion]"),
             ("chattering", NOISE, "chattering, 40 % noise [% of weight]"),
             ("chattering", 0.0, "chattering, no noise [% of weight]"))  # fmt: skip
    for ax, (quantity, noise, title) in zip(grid[0], shown, strict=True):
        for label in labels:
            cells = [Cell(label, study_of_rate(r), mismatch=WRONG, noise=noise) for r in rates]
            _band(ax, label, rates, [evidence.measured.median(c, quantity) for c in cells], 100.0)
        ax.set_xscale("log")
        logarithmic(ax, "y")
        ax.set_xticks(rates, [f"{rate:g}" for rate in rates], minor=False)
        ax.set_xticks([], minor=True)
        ax.set_xlabel("control rate [Hz]")
        ax.set_title(title)
    legend(figure, grid[0, 0])
    return figure


def _drift(evidence: Evidence) -> Figure:
    figure, grid = panels(1, 2, 4.2, 2.6)
    for label, name in LONG.items():
        series = evidence.series[name]
        joint = series.E.shape[2] // 2  # theta1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of instants at which no arm is left
            own = np.where(series.E[:, :, joint] > 0.0, series.E[:, :, joint], np.nan)
            low, middle, high = np.nanpercentile(own, [5.0, 50.0, 95.0], axis=1)
        color = look(label).color
        grid[0, 0].plot(series.t, middle, color=color, label=title_of(label))
        grid[0, 0].fill_between(series.t, low, high, color=color, alpha=0.18, linewidth=0.0)
        left = np.mean(~np.isnan(series.E[:, :, joint]), axis=1)
        grid[0, 1].plot(series.t, 100.0 * left, color=color)
    logarithmic(grid[0, 0], "y")
    grid[0, 0].set_title("gain E of theta1 [N m]")
    grid[0, 1].set_title("arms within their limits [%]")
    grid[0, 1].set_ylim(-3.0, 103.0)
    for ax in grid[0]:
        ax.set_xlabel("time [s]")
    legend(figure, grid[0, 0])
    return figure


def _line(ax: Axes, label: str, x: np.ndarray, y: np.ndarray, *, marker: bool = True) -> None:
    style = look(label)
    ax.plot(
        x, np.where(np.isfinite(y), y, np.nan), color=style.color, linestyle=style.line,
        marker=style.marker if marker else "", label=title_of(label), markeredgewidth=0.0,
    )  # fmt: skip


def _band(
    ax: Axes, label: str, x: np.ndarray, own: Sequence[Interval], factor: float = 1.0
) -> None:
    """Medians with a band of intervals."""
    value, low, high = factor * np.array([tuple(map(float, interval)) for interval in own]).T
    _line(ax, label, x, value)
    good = np.isfinite(low + high)
    ax.fill_between(
        x, np.where(good, low, np.nan), np.where(good, high, np.nan),
        color=look(label).color, alpha=0.18, linewidth=0.0,
    )  # fmt: skip


def _dot(ax: Axes, label: str, own: Interval, y: float, marker: str = "o") -> None:
    """A median with its interval, sideways."""
    value, low, high = (float(x) for x in own)
    if np.isfinite(value):
        ax.plot([low, high], [y, y], color=look(label).color, linewidth=1.2)
        ax.plot(value, y, marker, color=look(label).color, markersize=5)


def _plain_ticks(axes: Sequence[Axes]) -> None:
    """Numbers without powers on a logarithmic axis of few decades."""
    for ax in axes:
        low, high = ax.get_xlim()
        ticks = [
            t for t in (0.2, 0.3, 0.5, 0.7, 0.8, 1, 1.2, 1.5, 2, 3, 5, 10, 20) if low <= t <= high
        ]
        ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
        ax.set_xticks([], minor=True)
