"""A sweep as arrays: what differs between its episodes, and the values of selected metrics."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from octarm.arm.lagrange import equilibrium
from octarm.arrays import coordinate_names
from octarm.declared import Code
from octarm.errors import OctarmError, closest, printable, quoted
from octarm.metrics.metric import Metric, unsettled
from octarm.metrics.table import declared_metrics
from octarm.references import is_built_in, named_reference
from octarm.reports.factors import LONGEST, Factor, factors_of, places
from octarm.sweeps import engine_check
from octarm.sweeps.spec import ARM, SweepSpec
from octarm.sweeps.store import metadata_of, open_sweep, read_schema, read_sweep

DEFAULT = ("rms_error", "tip_rms_error", "chattering", "effort", "overshoot")

_STILL = 1e-9  # rms of a coordinate that a reference lets rest [m], [rad]
_POOR = 0.1  # share of the error of an arm that hangs still, beyond which nothing is tracked
_TOGETHER = {"rms": ", over all inputs", "max": ", of any input", "mean": ", mean of the inputs"}


class Measure(NamedTuple):
    """A number of each episode: a column of a metric, or the inputs' columns brought together.

    Its name is that of its column, or of the metric if there are several. It is of a coordinate or
    an input; of nothing for the arm and for all inputs.
    """

    name: str
    metric: str
    of: str
    columns: tuple[str, ...]
    unit: str
    declared: Metric

    @property
    def awaited(self) -> list[str]:
        """Names of the columns that have a value whenever the measure was to be expected."""
        awaited = self.declared.waits_for
        return [column.replace(self.metric, awaited, 1) for column in self.columns if awaited]

    @property
    def text(self) -> str:
        """Its meaning, in one line."""
        several = len(self.columns) > 1
        return self.declared.text + (_TOGETHER[self.declared.together] if several else "")


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Episodes:
    """The finished episodes of a sweep.

    The value of an episode that diverged is infinite, on the side of what is worse, and so is a
    time that never came: dropping them would favour the controller that loses the hard episodes.

    Attributes:
        factors: those that take more than one value.
        measures: those that were asked for and have a value.
        absent: names of those that were asked for and have none.
        controller: number of the controller of each episode, shape (n,).
        seed: shape (n,).
        diverged: shape (n,).
        digest: of the states, shape (n,).
        values: of the measures, shape (n, M); NaN where there is none.
        lost: whether it did not diverge, but a coordinate that moves follows its reference no
            better than an arm that hangs still, shape (n,).
        poor: whether it diverged, or a coordinate that moves has more than a tenth of the error of
            an arm that hangs still, shape (n,).
        exact: whether an error is zero to the last digit, shape (n,).
        engine_difference: how far the tip was from where MuJoCo has it, of episodes of the analytic
            arm that were run again, shape (k,) [m].
    """

    spec: SweepSpec
    manifest: Mapping[str, Any]
    controllers: tuple[str, ...]
    factors: tuple[Factor, ...]
    measures: tuple[Measure, ...]
    absent: tuple[str, ...]
    controller: np.ndarray
    seed: np.ndarray
    diverged: np.ndarray
    digest: np.ndarray
    values: np.ndarray
    lost: np.ndarray
    poor: np.ndarray
    exact: np.ndarray
    engine_difference: np.ndarray

    @property
    def planned(self) -> int:
        """Number of episodes, with those that are not finished."""
        return self.manifest["episodes"]

    @property
    def with_values(self) -> str:
        """In words, an episode that may have values: finished, and not diverged."""
        finished = "" if len(self.seed) == self.planned else "finished "
        return f"{finished}episode{' that did not diverge' if self.diverged.any() else ''}"

    def cell(self, but: Factor | None = None) -> np.ndarray:
        """A number for each place of the grid, whatever the level of `but`, shape (n,).

        What was drawn goes with the seed.
        """
        number = np.zeros_like(self.seed)
        for factor in self.factors:
            if not factor.drawn and factor is not but:
                number = number * len(factor.labels) + factor.code
        return number

    def of_controller(self, name: str) -> np.ndarray:
        """The rows of a controller, shape (k,)."""
        return np.flatnonzero(self.controller == self.controllers.index(name))


def read_episodes(folder: Path, metrics: Sequence[str] = ()) -> Episodes:
    """Reads a sweep, and no more columns than are needed.

    Metrics or columns are given by name; they are `DEFAULT` when none are given. Of a metric of
    coordinates those that move are taken, one of inputs is brought together. Raises OctarmError if
    it is no sweep, has no finished episode, or a metric is unknown or has no value in any episode.
    """
    plan, manifest = open_sweep(folder)
    spec, code = plan.spec, plan.spec.code
    axes = [axis for axis in (*spec.axes, *spec.random) if axis.name != "controller"]
    schema = read_schema(folder)
    known = declared_metrics(code)
    columns = [column for field in schema if (column := _column(field, known)) is not None]
    words = [name for word in metrics or DEFAULT for name in _metrics_of(word, code)]
    wanted = {name: _measures(name, columns, spec, known) for name in words}
    asked = [measure for measures in wanted.values() for measure in measures]
    errors = [column for column in columns if column.metric == "rms_error"]
    needed = ["controller", "seed", "status", "digest", *(x.name for x in (*axes, *errors))]
    needed += [name for measure in asked for name in measure.columns]
    optional = [engine_check.COLUMN, *(name for measure in asked for name in measure.awaited)]
    needed += [name for name in optional if name in schema.names]
    table = read_sweep(folder, [*dict.fromkeys(needed)])
    held = {name: table[name].to_numpy() for name in table.column_names}
    controller = places(held["controller"], spec.controllers)
    diverged = held["status"] == "diverged"
    absent = [name for name, measures in wanted.items() if not measures]
    values: dict[Measure, np.ndarray] = {}
    for measure in asked:
        column = _values(held, measure, controller, diverged)
        if np.any(np.isfinite(column)):
            values[measure] = column
        else:
            absent.append(measure.name)
    if not values and diverged.all():
        raise OctarmError(
            f"all finished episodes of {folder} diverged; there is nothing to report of them"
        )
    if not values:
        why = "its controllers do not have it, or all episodes diverged of those that have it"
        why = unsettled(spec.duration, spec.settle, "settle =") or why
        lacks = f"has no value of {', '.join(absent)} in any finished episode"
        raise OctarmError(f"{folder} {lacks}; {why}")
    lost, poor, exact = _suspects(held, errors, spec)
    apart = held.get(engine_check.COLUMN, np.empty(0))
    return Episodes(
        spec=spec,
        manifest=manifest,
        controllers=tuple(printable(name, LONGEST) for name in spec.controllers),
        factors=tuple(factors_of(held, spec, axes)),
        measures=tuple(values),
        absent=tuple(absent),
        controller=controller,
        seed=held["seed"],
        diverged=diverged,
        digest=held["digest"],
        values=np.stack([*values.values()], axis=1),
        lost=lost,
        poor=poor | diverged,
        exact=exact,
        engine_difference=apart[~np.isnan(apart)],
    )


def _metrics_of(word: str, code: Mapping[str, Code]) -> list[str]:
    """The metrics of a word: those of a file of the sweep's, `FILE.py:NAME`, or the word itself."""
    for name, each in code.items():
        if each.kind == "metric" and word in (name, each.path):
            return [*each.declares]
    return [word]


def _column(field: pa.Field, known: Mapping[str, Metric]) -> Measure | None:
    """A column of a metric, as the schema describes it; None for another column."""
    words = metadata_of(field).items()
    said = {key.decode(): printable(text.decode(), LONGEST) for key, text in words}
    metric = said.get("metric", "")
    if metric not in known:
        return None
    return Measure(field.name, metric, said["of"], (field.name,), said["unit"], known[metric])


def _measures(
    name: str, columns: Sequence[Measure], spec: SweepSpec, known: Mapping[str, Metric]
) -> list[Measure]:
    """The measures that the name of a metric or column stands for; none if it has no column."""
    of_metric = [column for column in columns if column.metric == name]
    single = [column for column in columns if column.name == name]
    if name not in known and not single:
        raise OctarmError(f"unknown metric {quoted(name)}{closest(name, known)}")
    if not of_metric:  # a column, or a metric that is younger than the sweep
        return single
    if known[name].of == "input":
        names = tuple(column.name for column in of_metric)
        return [Measure(name, name, "", names, of_metric[0].unit, known[name])]
    if known[name].of == "coordinate" and all(map(is_built_in, spec.references)):
        errors = _hanging_errors(spec, [column.of for column in of_metric], 0.0, 10.0)
        moving = np.any([error > _STILL for error in errors.values()], axis=0)
        if np.any(moving):  # else all of them rest
            return [column for column, moves in zip(of_metric, moving, strict=True) if moves]
    return of_metric


def _hanging_errors(
    spec: SweepSpec, names: Sequence[str], begin: float, end: float
) -> dict[tuple[str, str], np.ndarray]:
    """The rms errors, shape (k,), of arms that hang still between two instants, of coordinates.

    They are by the names of each built-in reference and arm; 0 for a coordinate the arm lacks.
    """
    errors: dict[tuple[str, str], np.ndarray] = {}
    for reference, arm in itertools.product(spec.references, spec.arms or [""]):
        if is_built_in(reference):
            groups = spec.groups(arm, None)
            parameters = spec.arm(arm) if groups is None else groups.arm
            rest = equilibrium(parameters)
            motion = named_reference(reference, rest, parameters)
            ways = [motion(t).q - rest for t in np.linspace(begin, end, 1000)]
            rms = np.sqrt(np.mean(np.square(ways), axis=0)).tolist()
            of = dict(zip(coordinate_names(parameters.modules), rms, strict=True))
            errors[reference, arm] = np.array([of.get(name, 0.0) for name in names])
    return errors


def _values(
    held: Mapping[str, np.ndarray], measure: Measure, controller: np.ndarray, diverged: np.ndarray
) -> np.ndarray:
    """A measure of each episode, shape (n,)."""
    columns = np.stack([held[name] for name in measure.columns])
    together = measure.declared.together
    if len(columns) == 1:
        values = columns[0]
    elif together == "rms":
        values = np.sqrt(np.mean(np.square(columns), axis=0))
    else:
        values = (np.max if together == "max" else np.mean)(columns, axis=0)
    if not measure.declared.sign:
        return values
    for name in measure.awaited:
        if name in held:
            values = np.where(~np.isnan(held[name]) & np.isnan(values), math.inf, values)
    for i in range(controller.max() + 1):  # what a controller does not have cannot be lost
        mine = controller == i
        if np.all(diverged[mine]) or not np.all(np.isnan(values[mine])):
            values = np.where(mine & diverged, measure.declared.sign * math.inf, values)
    return values


def _suspects(
    held: Mapping[str, np.ndarray], errors: Sequence[Measure], spec: SweepSpec
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`Episodes.lost`, `poor` and `exact`, given the columns of `rms_error`."""
    lost, poor, exact = np.zeros((3, len(held["reference"])), dtype=bool)
    if not spec.duration > spec.settle:
        return lost, poor, exact
    names = [column.of for column in errors]
    known = _hanging_errors(spec, names, spec.settle, spec.duration)
    for (reference, arm), hanging in known.items():
        here = held["reference"] == reference
        if arm:
            here &= held[ARM] == arm
        for column, limit in zip(errors, hanging, strict=True):
            if limit > _STILL:
                lost |= here & (held[column.name] >= limit)
                poor |= here & (held[column.name] > _POOR * limit)
                exact |= here & (held[column.name] == 0.0)
    return lost, poor, exact
