"""The figures: 1 and 2 of the paper, the README's, and those of the studies."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.figure import Figure as NewFigure

from octarm.reports.figures import (
    COLORS,
    INK,
    MARKERS,
    Axes,
    Figure,
    Picture,
    figure_style,
    logarithmic_ticks,
    save_figure,
)
from octarm.reports.statistics import Interval
from paper.claims import filled, percent, texts
from paper.evidence import NAMES, Cell, Evidence
from paper.runs import LONG, Series, name_of
from paper.studies import (
    ABLATIONS,
    AS_PRINTED,
    BENDS,
    BEYOND,
    CONSEQUENT,
    CONTROLLERS,
    FIXED_PREMISES,
    INTEGRAL,
    MATCHED,
    MODELS,
    MOVING,
    NOISE,
    PROPOSED,
    RATE,
    SIGN,
    SLIDES,
    SMC,
    TWISTING,
    UNGUARDED,
    WRONG,
    by_hand,
    study_of_rate,
)
from paper.tables import by_error

GREY = "#5f6b77"
HEADLINE = "paper"  # name of the README's picture

_COLORS: dict[str, str] = dict(zip(
    (PROPOSED, SMC, SIGN, INTEGRAL, TWISTING, CONSEQUENT, "fsmc", "pd", "computed-torque", "fuzzy"),
    COLORS, strict=True,
))  # fmt: skip
_ABLATIONS = {
    FIXED_PREMISES: ("#7a8f1f", "--"),
    AS_PRINTED: ("#7d6bd0", ":"),
    UNGUARDED: ("#b0413e", "-"),
    MATCHED: ("#dd9500", "--"),
}
_NAMES = {PROPOSED: "AFSMC (proposed)", SMC: "SMC, boundary layer", SIGN: "SMC, sgn"}
_UNITS = {BENDS: ("rad", "mrad"), SLIDES: ("m", "mm")}
_READINGS = {BENDS: "bends", SLIDES: "slides"}
_SHADES = {-0.3: ("o", -0.2), 0.0: ("s", 0.0), 0.3: ("^", 0.2)}  # of models: marker and place


def pictures(evidence: Evidence) -> Iterator[Picture]:
    """All figures that there are numbers for, the README's first."""
    effort = evidence.effort
    yield _drawn(HEADLINE, _headline, evidence)
    for reference in effort.references:
        joints = " and ".join(MOVING[reference])
        for name, noise in (("figure-1", 0.0), ("figure-2", NOISE)):
            draw = functools.partial(_tracking, reference=reference, noise=noise)
            words = {"joints": joints, "seeds": effort.seeds}
            yield _drawn(name, draw, evidence, f"-{_READINGS[reference]}", **words)
    yield _drawn("overshoot", _overshoot, evidence)
    yield _drawn("ranking", _ranking, evidence)
    yield _drawn("ablations", _ablations, evidence)
    if effort.noises:
        yield _drawn("degradation", _degradation, evidence)
    if effort.complete:
        yield _drawn("beyond", _beyond, evidence)
        yield _drawn("rates", _rates, evidence)
    if effort.long:
        yield _drawn("drift", _drift, evidence)


def _drawn(
    name: str,
    draw: Callable[[Evidence], Figure],
    evidence: Evidence,
    ending: str = "",
    **words: Any,
) -> Picture:
    """A figure with its caption; nothing in it differs from run to run."""
    with figure_style():
        caption = filled(texts()["figures"][name], **words)
        return save_figure(name + ending, caption, draw(evidence))


def _tracking(evidence: Evidence, reference: str, noise: float) -> Figure:
    """Figure 1, without noise, or 2 of the paper."""
    joints, (unit, small) = MOVING[reference], _UNITS[reference]
    series = {label: evidence.series[name_of(label, reference)] for label in evidence.effort.series}
    first = next(iter(series.values()))
    figure, grid = _panels(2 * len(joints), len(MODELS), 3.1, 1.45, sharex=True, sharey="row")
    for column, model in enumerate(MODELS):
        for row, joint in enumerate(joints):
            motion, error = grid[2 * row, column], grid[2 * row + 1, column]
            place = NAMES.index(joint)
            motion.plot(first.t, first.q_d[:, place], color=INK, linewidth=3.2, alpha=0.25,
                        label="desired")  # fmt: skip
            for label, arms in series.items():
                _arms(motion, label, arms.t, arms.of(model, noise)[:, :, place])
                _arms(error, label, arms.t, 1e3 * _errors(arms, model, noise, place))
            _zero_line(error)
            if column == 0:
                motion.set_ylabel(f"{joint} [{unit}]")
                error.set_ylabel(f"error [{small}]")
    for row, joint in enumerate(joints):  # the two that matter stay in view
        late = first.t > 0.5
        errors = [
            np.abs(_errors(series[label], model, noise, NAMES.index(joint))[late])
            for label in (SMC, PROPOSED)
            for model in MODELS
        ]
        largest = max(float(np.nanpercentile(values, 99.9)) for values in errors)
        grid[2 * row + 1, 0].set_ylim(-1.5e3 * largest, 1.5e3 * largest)
    _time_axes(grid, evidence.effort.short)
    _legend(figure, grid[0, 0])
    figure.align_ylabels(grid[:, 0])
    return figure


def _headline(evidence: Evidence) -> Figure:
    figure, grid = _panels(2, len(MODELS), 3.3, 1.75, sharex=True, sharey="row")
    for row, (noise, words) in enumerate(((0.0, "no noise"), (NOISE, "40 % noise"))):
        for column, model in enumerate(MODELS):
            for label in (SMC, PROPOSED):
                arms = evidence.series[name_of(label, BENDS)]
                errors = 1e3 * _errors(arms, model, noise, NAMES.index("theta1"))
                _arms(grid[row, column], label, arms.t, errors)
            _zero_line(grid[row, column])
        grid[row, 0].set_ylabel(f"error of theta1 [mrad]\n{words}")
    _time_axes(grid, evidence.effort.short)
    _legend(figure, grid[0, 0])
    return figure


def _errors(series: Series, model: float, noise: float, place: int) -> np.ndarray:
    """Errors of a coordinate of some arms, shape (T, k) [m], [rad]."""
    return series.of(model, noise)[:, :, place] - series.q_d[:, None, place]


def _overshoot(evidence: Evidence) -> Figure:
    places = [(reference, joint) for reference in MOVING for joint in MOVING[reference]]
    figure, grid = _panels(1, len(places), 2.6, 2.5)
    models = np.array(evidence.effort.mismatches)
    for ax, (reference, joint) in zip(grid[0], places, strict=True):
        for label in (SMC, by_hand(SMC), PROPOSED, by_hand(PROPOSED)):
            cells = [Cell(label, reference=reference, mismatch=m) for m in models.tolist()]
            if evidence.measured.has(*cells):
                y = [evidence.measured.median(c, f"overshoot_{joint}").value for c in cells]
                _line(ax, label, 100.0 * models, np.array(y), marker=False)
        _zero_line(ax)
        ax.axhline(3.0, color=GREY, linewidth=0.9, linestyle=":")
        ax.set_title(f"overshoot of {joint} [%]")
        ax.set_xlabel("error of the nominal model [%]")
    _legend(figure, grid[0, 0])
    return figure


def _ranking(evidence: Evidence) -> Figure:
    order = by_error(evidence)
    figure, grid = _panels(1, len(MODELS), 3.1, 0.25 * len(order) + 0.6, sharey=True, sharex=True)
    for ax, model in zip(grid[0], MODELS, strict=True):
        for place, name in enumerate(order):
            noisy, quiet = (Cell(name, mismatch=model, noise=n) for n in (NOISE, 0.0))
            _dot(ax, name, evidence.measured.percent(noisy), place)
            value = evidence.measured.percent(quiet).value
            ax.plot(value, place, "o", color=_look(name).color, fillstyle="none")
        _logarithmic(ax, "x")
        ax.set_title(f"nominal model {percent(model)}")
        ax.set_xlabel("error [% of the motion]")
        _names(ax, order)
    grid[0, 0].invert_yaxis()
    return figure


def _ablations(evidence: Evidence) -> Figure:
    measured, labels = evidence.measured, [CONSEQUENT, SMC, INTEGRAL, *ABLATIONS]
    labels = [label for label in labels if measured.has(Cell(label, noise=NOISE))]
    readings = [
        reference
        for reference in MOVING
        if any(measured.has(Cell(label, reference=reference, noise=NOISE)) for label in labels)
    ]
    figure, grid = _panels(1, len(readings), 4.6, 0.42 * len(labels) + 0.7, sharey=True)
    for ax, reference in zip(grid[0], readings, strict=True):
        for place, label in enumerate(labels):
            for model, (marker, shift) in _SHADES.items():
                cell = Cell(label, reference=reference, mismatch=model, noise=NOISE)
                if measured.has(cell):
                    _dot(ax, label, measured.over_proposed(cell), place + shift, marker)
        ax.axvline(1.0, color=GREY, linewidth=0.9, linestyle=":")
        ax.set_xscale("log")
        ax.set_title(", ".join(MOVING[reference]))
        ax.set_xlabel("error over that of afsmc")
        _names(ax, [_title(label) for label in labels])
    for model, (marker, _) in _SHADES.items():
        grid[0, 0].plot([], [], marker, color=GREY, label=f"nominal model {percent(model)}")
    grid[0, 0].invert_yaxis()
    for ax in grid[0]:  # numbers without powers
        low, high = ax.get_xlim()
        ticks = (0.2, 0.3, 0.5, 0.7, 0.8, 1, 1.2, 1.5, 2, 3, 5, 10, 20)
        _ticks(ax, [tick for tick in ticks if low <= tick <= high])
    _legend(figure, grid[0, 0])
    return figure


def _degradation(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, 2, 4.2, 2.8)
    noises = np.array([0.0, *evidence.effort.noises])
    for ax, quantity, factor, title in (
        (grid[0, 0], "error", 100.0, "error of all joints [% of the motion]"),
        (grid[0, 1], "rms_error_theta1", 1e3, "rms error of theta1 [mrad]"),
    ):
        for label in CONTROLLERS:
            cells = [Cell(label, "degradation", mismatch=WRONG, noise=n) for n in noises.tolist()]
            if evidence.measured.has(*cells):
                medians = [evidence.measured.median(cell, quantity, factor) for cell in cells]
                _band(ax, label, 100.0 * noises, medians)
        ax.axvline(100.0 * NOISE, color=GREY, linewidth=0.9, linestyle=":")
        ax.set_title(title)
        ax.set_xlabel("rms of the noise [% of the input's amplitude]")
        ax.set_ylim(0.0, None)
    _legend(figure, grid[0, 0])
    return figure


def _beyond(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, len(BEYOND), 3.3, 2.9)
    titles = {"payload": "payload", "delay": "delay", "loss": "loss of force"}
    for ax, (name, stress) in zip(grid[0], BEYOND.items(), strict=True):
        for label in CONTROLLERS:
            start = Cell(label, "beyond", mismatch=WRONG)
            cells = [start._replace(**{name: value}) for value in stress.values]
            errors = [evidence.measured.percent(cell).value for cell in cells]
            _line(ax, label, stress.factor * np.array(stress.values), np.array(errors))
        _logarithmic(ax, "y")
        ax.set_xlabel(f"{titles[name]} [{stress.unit}]")
        ax.set_title("error [% of the motion]")
    _legend(figure, grid[0, 0])
    figure.set_figheight(figure.get_figheight() + 0.3)
    return figure


def _rates(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, 3, 3.2, 2.6)
    rates = sorted({*evidence.effort.rates, RATE})
    for ax, quantity, noise, title in (
        (grid[0, 0], "error", NOISE, "error, 40 % noise [% of the motion]"),
        (grid[0, 1], "chattering", NOISE, "chattering, 40 % noise [% of weight]"),
        (grid[0, 2], "chattering", 0.0, "chattering, no noise [% of weight]"),
    ):
        for label in (PROPOSED, SMC, TWISTING, SIGN):
            cells = [Cell(label, study_of_rate(r), mismatch=WRONG, noise=noise) for r in rates]
            medians = [evidence.measured.percent(cell, quantity) for cell in cells]
            _band(ax, label, np.array(rates), medians)
        ax.set_xscale("log")
        _logarithmic(ax, "y")
        _ticks(ax, rates)
        ax.set_xlabel("control rate [Hz]")
        ax.set_title(title)
    _legend(figure, grid[0, 0])
    return figure


def _drift(evidence: Evidence) -> Figure:
    figure, grid = _panels(1, 2, 4.2, 2.6)
    gain, left = grid[0]
    for label, name in LONG.items():
        series = evidence.series[name]
        E = series.E[:, :, NAMES.index("theta1")]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of instants at which no arm is left
            low, middle, high = np.nanpercentile(
                np.where(E > 0.0, E, np.nan), [5.0, 50.0, 95.0], axis=1
            )
        color = _look(label).color
        gain.plot(series.t, middle, color=color, label=_title(label))
        gain.fill_between(series.t, low, high, color=color, alpha=0.18, linewidth=0.0)
        left.plot(series.t, 100.0 * np.mean(~np.isnan(E), axis=1), color=color)
    _logarithmic(gain, "y")
    gain.set_title("gain E of theta1 [N m]")
    left.set_title("arms within their limits [%]")
    left.set_ylim(-3.0, 103.0)
    for ax in grid[0]:
        ax.set_xlabel("time [s]")
    _legend(figure, gain)
    return figure


class Look(NamedTuple):
    """How a variant is drawn, the same in all figures."""

    color: str
    line: str
    marker: str


def _look(label: str) -> Look:
    """The look of a variant; hand-set gains have a dashed line."""
    if label in _ABLATIONS:
        return Look(*_ABLATIONS[label], "x")
    name = label.removesuffix(", hand-set")
    line = "-" if name == label else (0, (4, 1.5))
    return Look(_COLORS[name], cast(str, line), MARKERS[CONTROLLERS.index(name)])


def _title(label: str) -> str:
    """The name of a variant in a legend."""
    name, comma, rest = label.partition(", ")
    return _NAMES.get(name, name) + comma + rest


def _panels(
    rows: int, columns: int, width: float, height: float, **options: Any
) -> tuple[Figure, np.ndarray]:
    """A grid of panels of this size [inch], shape (rows, columns)."""
    figure = NewFigure(figsize=(width * columns, height * rows + 0.4), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def _legend(figure: Figure, ax: Axes) -> None:
    """One legend for all panels, above them."""
    handles, labels = ax.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        list(unique.values()), list(unique), loc="outside upper center", handlelength=2.2,
        ncols=min(len(unique), 5), columnspacing=1.8,
    )  # fmt: skip


def _time_axes(grid: np.ndarray, duration: float) -> None:
    """Axes over time below each other, a column a nominal model."""
    for column, model in enumerate(MODELS):
        grid[0, column].set_title(f"nominal model {percent(model)}")
        grid[-1, column].set_xlabel("time [s]")
        grid[-1, column].set_xlim(0.0, duration)
        grid[-1, column].set_xticks(np.arange(duration))


def _zero_line(ax: Axes) -> None:
    ax.axhline(0.0, color=INK, linewidth=0.6, zorder=1)


def _logarithmic(ax: Axes, which: str) -> None:
    """Makes an axis logarithmic, with plain numbers at its ticks."""
    getattr(ax, f"set_{which}scale")("log")
    low, high = getattr(ax, f"get_{which}lim")()
    logarithmic_ticks(getattr(ax, f"{which}axis"), low, high)


def _ticks(ax: Axes, values: Sequence[float]) -> None:
    """Plain numbers at these places of a logarithmic axis of few decades."""
    ax.set_xticks(values, [f"{value:g}" for value in values])
    ax.set_xticks([], minor=True)


def _names(ax: Axes, names: Sequence[str]) -> None:
    """Names at the rows of a panel."""
    ax.set_yticks(range(len(names)), names)
    ax.tick_params(axis="y", length=0)


def _arms(ax: Axes, label: str, t: np.ndarray, values: np.ndarray) -> None:
    """A line over time; for several arms, shape (T, k), their median and a band."""
    color = _look(label).color
    low, middle, high = np.percentile(values, [5.0, 50.0, 95.0], axis=1)
    ax.plot(t, middle, color=color, label=_title(label), linewidth=1.1)
    if values.shape[1] > 1:
        ax.fill_between(t, low, high, color=color, alpha=0.22, linewidth=0.0)


def _line(ax: Axes, label: str, x: np.ndarray, y: np.ndarray, *, marker: bool = True) -> None:
    style = _look(label)
    ax.plot(
        x, np.where(np.isfinite(y), y, np.nan), color=style.color, linestyle=style.line,
        marker=style.marker if marker else "", label=_title(label), markeredgewidth=0.0,
    )  # fmt: skip


def _band(ax: Axes, label: str, x: np.ndarray, intervals: Sequence[Interval]) -> None:
    """Medians with a band of intervals."""
    value, low, high = np.array([tuple(map(float, interval)) for interval in intervals]).T
    _line(ax, label, x, value)
    good = np.isfinite(low + high)
    ax.fill_between(
        x, np.where(good, low, np.nan), np.where(good, high, np.nan),
        color=_look(label).color, alpha=0.18, linewidth=0.0,
    )  # fmt: skip


def _dot(ax: Axes, label: str, interval: Interval, y: float, marker: str = "o") -> None:
    """A median with its interval, sideways."""
    value, low, high = (float(x) for x in interval)
    if np.isfinite(value):
        ax.plot([low, high], [y, y], color=_look(label).color, linewidth=1.2)
        ax.plot(value, y, marker, color=_look(label).color, markersize=5)
