"""The numbers of an episode that a report is asked for."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from octarm.errors import OctarmError, closest
from octarm.metrics.table import METRICS, SETTLED_AFTER
from octarm.references import REFERENCES, named_reference
from octarm.sweeps.store import metadata_of, read_schema, read_sweep

DEFAULT = ("rms_error", "tip_rms_error", "chattering", "effort", "overshoot")

_LESS_IS_WORSE = {"layer_share", "settled"}
_BY_SIZE = {"overshoot", "undershoot", "step_overshoot", "steady_error"}  # zero is best
_NEITHER = {"work", "control_rate", "reaching_bound"}
# What never came although the other measure shows that it was waited for.
_AWAITED = {"settling_time": "settled", "reaching_time": "sliding_violations"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Measure:
    """A number of each episode.

    Attributes:
        name: its column, or that of a metric that is brought together from several columns.
        metric: the one of `METRICS`.
        columns: what it is made of.
        unit: of its values.
        sign: 1 when less is better, -1 when more is, 0 when neither.
        by_size: whether its size is what is compared, as zero is best.
    """

    name: str
    metric: str
    columns: tuple[str, ...]
    unit: str

    @property
    def sign(self) -> int:  # noqa: D102
        if self.metric in _NEITHER:
            return 0
        return -1 if self.metric in _LESS_IS_WORSE else 1

    @property
    def by_size(self) -> bool:  # noqa: D102
        return self.metric in _BY_SIZE

    @property
    def text(self) -> str:
        """What it is, in one line."""
        together = {"effort": ", over all inputs", "peak_input": ", of any input"}
        mean = ", mean of the inputs"
        more = together.get(self.metric, mean) if len(self.columns) > 1 else ""
        return METRICS[self.metric].text + more


def measures_of(name: str, units: Mapping[str, str], spec: Mapping[str, Any]) -> list[Measure]:
    """The measures that a name stands for; none if the sweep does not have its columns.

    Args:
        name: of a metric or of a column.
        units: of the columns of metrics that there are, by name.
        spec: of the sweep, as its manifest has it.

    Raises:
        ValueError: for an unknown name.
    """
    own = {column: metric for column in units if (metric := _metric(column))}
    if name in own and own[name] != name:
        return [Measure(name=name, metric=own[name], columns=(name,), unit=units[name])]
    columns = [column for column, metric in own.items() if metric == name]
    if name not in METRICS:
        raise OctarmError(f"unknown metric {name!r}{closest(name, METRICS)}")
    if not columns:  # the sweep is older than the metric
        return []
    if METRICS[name].of == "input":
        return [Measure(name=name, metric=name, columns=tuple(columns), unit=units[columns[0]])]
    if METRICS[name].of == "coordinate":
        moving = moved(spec.get("grid.reference", ()), len(columns))
        columns = [column for column, moves in zip(columns, moving, strict=True) if moves]
    return [Measure(name=c, metric=name, columns=(c,), unit=units[c]) for c in columns]


def moved(references: Sequence[str], coordinates: int) -> np.ndarray:
    """Which coordinates a reference moves away from rest, shape (2N,); all if none is known."""
    rest, moving = np.zeros(coordinates), np.zeros(coordinates, dtype=bool)
    for name in references:
        if name in REFERENCES:
            moving |= offset(name, rest, 10.0) > 0.0
    return moving if moving.any() else ~moving


def offset(reference: str, rest: np.ndarray, duration: float, begin: float = 0.0) -> np.ndarray:
    """How far a reference is from rest: the rms error of an arm that just hangs, shape (2N,)."""
    motion = named_reference(reference, rest)
    squares = [np.square(motion(t).q - rest) for t in np.linspace(begin, duration, 1000)]
    return np.sqrt(np.mean(np.broadcast_to(squares, (1000, *rest.shape)), axis=0))


def metric_units(folder: Path) -> dict[str, str]:
    """The columns of metrics in the table, with their units."""
    return {
        field.name: metadata_of(field).get(b"unit", b"").decode()
        for field in read_schema(folder)
        if _metric(field.name)
    }


def read_values(
    folder: Path, measure: Measure, controller: np.ndarray, diverged: np.ndarray
) -> np.ndarray:
    """A measure of each episode, shape (n,)."""
    awaited = [
        column.replace(measure.metric, _AWAITED[measure.metric], 1)
        for column in measure.columns
        if measure.metric in _AWAITED
    ]
    table = read_sweep(folder, [*measure.columns, *awaited])
    columns = np.stack([as_array(table[name]) for name in measure.columns])
    together = {"effort": _rms, "peak_input": np.max}.get(measure.metric, np.mean)
    values = columns[0] if len(columns) == 1 else together(columns, axis=0)
    if not measure.sign:
        return values
    for name in set(awaited) & set(table.column_names):
        waited = ~np.isnan(as_array(table[name]))
        values = np.where(waited & np.isnan(values), math.inf, values)
    for i in range(controller.max() + 1):  # what a controller does not have cannot be lost
        own = controller == i
        if np.all(diverged[own]) or not np.all(np.isnan(values[own])):
            values = np.where(own & diverged, measure.sign * math.inf, values)
    return values


def read_suspects(
    folder: Path, reference: np.ndarray, units: Mapping[str, str], spec: Mapping[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Which episodes cannot be what they seem, two arrays of shape (n,).

    Those in which a coordinate that moves follows its reference no better than an arm that hangs
    still, and those in which an error is zero to the last digit.
    """
    columns = [column for column in units if _metric(column) == "rms_error"]
    lost = np.zeros(len(reference), dtype=bool)
    exact = np.zeros_like(lost)
    for name in np.unique(reference).tolist():
        if name not in REFERENCES or spec["duration"] <= SETTLED_AFTER:
            continue
        hanging = offset(name, np.zeros(len(columns)), spec["duration"], SETTLED_AFTER)
        here = reference == name
        for column, limit in zip(columns, hanging, strict=True):
            if limit > 0.0:
                error = as_array(read_sweep(folder, [column])[column])
                lost |= here & (error >= limit)
                exact |= here & (error == 0.0)
    return lost, exact


def as_array(column: pa.ChunkedArray) -> np.ndarray:
    """A column as an array of shape (rows,); words as strings, what there is not as NaN."""
    if pa.types.is_string(column.type):
        return np.asarray(column.to_pylist(), dtype=np.str_)
    return column.to_numpy()


def _metric(column: str) -> str:
    """The metric that a column belongs to; empty if to none."""
    for metric, meaning in METRICS.items():
        rest = column.removeprefix(metric)
        if rest != column and (not rest if meaning.of == "arm" else _is_suffix(rest)):
            return metric
    return ""


def _is_suffix(text: str) -> bool:
    word = text.removeprefix("_").rstrip("0123456789")
    return text.startswith("_") and word in ("s", "theta", "tau") and text[-1].isdigit()


def _rms(columns: np.ndarray, axis: int) -> np.ndarray:
    return np.sqrt(np.mean(np.square(columns), axis=axis))
