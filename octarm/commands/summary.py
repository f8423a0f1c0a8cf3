"""What a run came to, in a few lines for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from octarm.arm.groups import SUMS
from octarm.declared import BUILT_IN, Code
from octarm.disturbances.ledger import in_words
from octarm.metrics.declared import declared_metrics
from octarm.metrics.metric import SETTLED_AFTER, unsettled
from octarm.metrics.table import METRICS

_HEADINGS = ("rms", "peak", "rms/amplitude", "overshoot", "chattering", "reached s=0")


def summary(
    rows: int,
    amplitude: np.ndarray,
    description: Mapping[str, Any],
    elapsed: float,
    code: Mapping[str, Code] = BUILT_IN,
) -> str:
    """What was run, what the disturbances delivered, and a table with a row a coordinate.

    Of so many control periods, a desired motion with amplitudes of shape (2N,) [m], [rad], what
    run.json says, and how long it took [s].
    """
    rate = 1.0 / description["control_period"]
    simulated = rows * description["control_period"]
    plant = description.get("plant")
    on = ""
    if plant:
        read = "" if plant["sensing"] == SUMS else f", read by {plant['sensing']}"
        on = f", a plant of {plant['modules']} modules ({plant['layout']}{read})"
    lines = [
        f"{description['controller']['name']} on {description['reference']['name']}{on}: "
        f"{simulated:g} s at {rate:g} Hz, done in {elapsed:.1f} s"
    ]
    if description["disturbances"]:
        lines += ["disturbances, as delivered", *in_words(description["disturbances"], code)]
    metrics = description["metrics"]
    settle = description.get("settle", SETTLED_AFTER)
    if None not in metrics["rms_error"]:
        lines += _table(amplitude, description["coordinates"], metrics, settle)
    elif early := unsettled(description["duration"], settle):
        lines += [f"note: {early}"]
    return "\n".join([*lines, *_others(code, metrics)])


def _table(
    amplitude: np.ndarray,
    coordinates: Sequence[Mapping[str, str]],
    metrics: Mapping[str, Any],
    settle: float,
) -> list[str]:
    width = [10, 11, 15, 11, 14, 13]
    head = "".join(f"{h:>{w}}" for h, w in zip(_HEADINGS, width, strict=True))
    lines = [f"after {settle:g} s".ljust(14) + head.rstrip()]
    for j, coordinate in enumerate(coordinates):
        name, unit = coordinate["name"], coordinate["unit"]
        force = METRICS["chattering"].unit_for(unit)
        rms = metrics["rms_error"][j]
        share = 100.0 * rms / amplitude[j] if amplitude[j] > 0.0 else None
        reached = metrics.get("reaching_time")
        cells = (
            f"{1e3 * rms:.3g}",
            f"{1e3 * metrics['peak_error'][j]:.3g}",
            _cell(share, ".3f", " %"),
            _cell(metrics["overshoot"][j], "+.2f", " %"),
            _cell(metrics["chattering"][j], ".3g", f" m{force}", 1e3),
            _cell(reached[j] if reached else None, ".4g", " s"),
        )
        row = "".join(f"{cell:>{w}}" for cell, w in zip(cells, width, strict=True))
        lines.append(f"{name:>7} [m{unit}]".ljust(14) + row.rstrip())
    tip = f"tip: {1e3 * metrics['tip_rms_error']:.3g} mm rms"
    bound = metrics.get("reaching_bound")
    if bound is not None:
        tip += f"; s = 0 is reached within {bound:.3g} s by (14)-(15)"
    return [*lines, tip]


def _others(code: Mapping[str, Code], metrics: Mapping[str, Any]) -> list[str]:
    """The metrics that are not built in, a line each."""
    lines: list[str] = []
    for name, metric in declared_metrics(code).items():
        if name not in METRICS and name in metrics:
            numbers = np.atleast_1d(np.array(metrics[name], dtype=float))
            values = ", ".join("none" if np.isnan(x) else f"{x:.3g}" for x in numbers.tolist())
            lines.append(f"{name} [{', '.join(metric.units)}]: {values}")
    return lines


def _cell(value: float | None, form: str, unit: str, factor: float = 1.0) -> str:
    return "" if value is None else f"{factor * value:{form}}{unit}"
