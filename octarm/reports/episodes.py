"""What a report needs of a sweep: its axes, the measures asked for, and their values."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from octarm.disturbances.fields import field_kinds
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError
from octarm.metrics.table import SETTLED_AFTER
from octarm.reports.measures import (
    DEFAULT,
    Measure,
    as_array,
    measures_of,
    metric_units,
    read_suspects,
    read_values,
)
from octarm.sweeps.folder import read_manifest, read_sweep
from octarm.sweeps.spec import which

_FEWEST, _MOST_RANGES = 4, 6  # values in a range of a drawn axis, and ranges


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Axis:
    """What differs between episodes, apart from the controller and the seed.

    Attributes:
        name: of its column.
        unit: of its values; empty for ratios and words.
        labels: its values in words; ranges when they were drawn.
        places: where its values stand, shape (k,); their order when they are words or infinite.
        scaled: whether the places are numbers.
        drawn: whether it was drawn for each seed.
        code: which of its values each episode has, shape (n,).
    """

    name: str
    unit: str
    labels: tuple[str, ...]
    places: np.ndarray
    scaled: bool
    drawn: bool
    code: np.ndarray


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Episodes:
    """The finished episodes of a sweep.

    A measure of an episode that diverged is infinite, on the side of what is worse, and so is a
    time that never came: dropping them would favour whoever loses the hard episodes.

    Attributes:
        manifest: of the sweep.
        controllers: in the order of the spec.
        axes: those that take more than one value.
        measures: that were asked for and have a value.
        absent: names of those that were asked for and have none.
        controller: which one each episode has, shape (n,).
        seed: shape (n,).
        diverged: shape (n,).
        digest: of the states, shape (n,).
        values: of the measures, shape (n, M); NaN where there is none.
        lost: whether it did not diverge, but a coordinate that moves follows its reference no
            better than an arm that hangs still, shape (n,).
        exact: whether an error is zero to the last digit, shape (n,).
    """

    manifest: Mapping[str, Any]
    controllers: tuple[str, ...]
    axes: tuple[Axis, ...]
    measures: tuple[Measure, ...]
    absent: tuple[str, ...]
    controller: np.ndarray
    seed: np.ndarray
    diverged: np.ndarray
    digest: np.ndarray
    values: np.ndarray
    lost: np.ndarray
    exact: np.ndarray

    @property
    def planned(self) -> int:
        """Number of episodes, with those that are not finished."""
        return sum(shard["episodes"] for shard in self.manifest["shards"])

    def cell(self) -> np.ndarray:
        """A number for each place of the grid, shape (n,); what was drawn goes with the seed."""
        number = np.zeros_like(self.seed)
        for axis in self.axes:
            if axis.drawn:
                continue
            number = number * len(axis.labels) + axis.code
        return number


def read_episodes(folder: Path, metrics: Sequence[str] = ()) -> Episodes:
    """Reads a sweep, and no more columns than are needed.

    Args:
        folder: of the sweep.
        metrics: names of metrics, or of columns; `DEFAULT` when not given. Of a metric of
            coordinates those that move are taken, one of inputs is brought together.

    Raises:
        ValueError: if it is no sweep, has no finished episode, or a metric is unknown or has no
            value in any episode.
    """
    manifest = read_manifest(folder)
    spec = manifest["spec"]
    controllers = tuple(spec["grid.controller"])
    names = [key.partition(".")[2] for key in spec if key.startswith(("grid.", "random."))]
    names.remove("controller")
    base = read_sweep(folder, ["controller", "seed", "status", "digest", *names])
    units = metric_units(folder)
    controller = _codes(as_array(base["controller"]), controllers)
    diverged = as_array(base["status"]) == "diverged"
    measures: list[Measure] = []
    columns: list[np.ndarray] = []
    absent: list[str] = []
    for name in dict.fromkeys(metrics or DEFAULT):
        found = measures_of(name, units, spec)
        absent += [] if found else [name]
        for measure in found:
            column = read_values(folder, measure, controller, diverged)
            if not np.any(np.isfinite(column)):
                absent.append(measure.name)
            elif measure not in measures:
                measures.append(measure)
                columns.append(column)
    if not measures:
        raise OctarmError(_nothing(folder, spec, absent, bool(diverged.all())))
    reference = as_array(base["reference"])
    lost, exact = read_suspects(folder, reference, units, spec)
    return Episodes(
        manifest=manifest,
        controllers=controllers,
        axes=tuple(_axes(base, spec, names)),
        measures=tuple(measures),
        absent=tuple(absent),
        controller=controller,
        seed=as_array(base["seed"]),
        diverged=diverged,
        digest=as_array(base["digest"]),
        values=np.stack(columns, axis=1),
        lost=lost,
        exact=exact,
    )


def _axes(table: pa.Table, spec: Mapping[str, Any], names: Sequence[str]) -> list[Axis]:
    """The axes that take more than one value."""
    found: list[Axis] = []
    for name in names:
        column, unit = as_array(table[name]), _unit(name)
        if f"random.{name}" in spec:
            found += _drawn(name, unit, column)
        elif len(spec[f"grid.{name}"]) > 1:
            words = column.dtype.kind != "f"
            values = np.array([v if words else float(v) for v in spec[f"grid.{name}"]])
            if not words:
                values = np.sort(values)
            scaled = not words and bool(np.isfinite(values).all())
            found.append(
                Axis(
                    name=name,
                    unit=unit,
                    labels=tuple(str(v) if words else f"{v:g}" for v in values),
                    places=values if scaled else np.arange(len(values)),
                    scaled=scaled,
                    drawn=False,
                    code=_codes(column, values.tolist()),
                )
            )
    return found


def _drawn(name: str, unit: str, column: np.ndarray) -> list[Axis]:
    """A drawn axis, cut into ranges with as many values each; none if there are too few."""
    different = np.unique(column)
    bins = min(len(different) // _FEWEST, _MOST_RANGES)
    if bins < 2:
        return []
    edges = np.quantile(different, np.linspace(0.0, 1.0, bins + 1))
    code = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, bins - 1)
    labels = tuple(f"{a:.3g} .. {b:.3g}" for a, b in itertools.pairwise(edges))
    places = np.array([np.median(column[code == i]) for i in range(bins)])
    return [
        Axis(name=name, unit=unit, labels=labels, places=places, scaled=True, drawn=True, code=code)
    ]


def _unit(axis: str) -> str:
    """The unit of a disturbance's field; empty for ratios and words."""
    name, _, key = axis.removeprefix("disturbance.").partition(".")
    kind = which(name).kind
    if axis == "mismatch" or kind not in DISTURBANCES:
        return ""
    kinds = field_kinds(DISTURBANCES[kind])
    spoken = {kind.key or field: kind for field, kind in kinds.items()}
    unit = spoken[key or next(iter(spoken))].unit if not key or key in spoken else ""
    return "" if unit == "1" else unit


def _codes(column: np.ndarray, values: Sequence[Any]) -> np.ndarray:
    """The places of a column's entries in a list, shape (n,)."""
    place = {value: i for i, value in enumerate(values)}
    different, inverse = np.unique(column, return_inverse=True)
    return np.array([place[value] for value in different.tolist()], dtype=np.int64)[inverse]


def _nothing(
    folder: Path, spec: Mapping[str, Any], absent: Sequence[str], all_diverged: bool
) -> str:
    """Why no measure has a value."""
    if all_diverged:
        return f"all finished episodes of {folder} diverged; there is nothing to report of them"
    return (
        f"{folder} has no value of {', '.join(absent)} in any episode; they last "
        f"{spec['duration']:g} s, and most metrics count from {SETTLED_AFTER:g} s on"
    )
