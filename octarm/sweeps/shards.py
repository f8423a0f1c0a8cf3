"""Running the arms of a shard side by side, down to one row of a table an episode."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from dm_control.rl import control

from octarm.arm.mjcf import nominal_parameters
from octarm.arrays import coordinate_names, coordinate_units
from octarm.interfaces import Controller, ControllerFactory, Instant
from octarm.metrics.table import METRICS, Column, Metrics, columns
from octarm.runs.digest import CHECKPOINTS, StateDigest
from octarm.runs.versions import host, versions
from octarm.simulation.environment import AnyPhysics, load, whole_periods
from octarm.simulation.recorder import Recorder
from octarm.simulation.rollout import simulate
from octarm.sweeps.plan import Arms, Plan
from octarm.sweeps.spec import SweepSpec

Observe = Callable[[Instant], object]

_MARKS = pa.list_(pa.uint64(), CHECKPOINTS)


def run_shard(
    spec: SweepSpec, shard: int, factory: ControllerFactory, *observers: Observe
) -> pa.Table:
    """The rows of a shard; they depend on nothing else.

    The metadata of the table's schema say where they were made: `host` and `versions`.

    Raises:
        OctarmError: if an arm, a disturbance or a controller cannot be made.
    """
    plan = Plan(spec)
    table = run_arms(plan, plan.arms(plan.shards[shard]), factory, *observers)
    origin = {"host": host(), "versions": versions()}
    return table.replace_schema_metadata({k: json.dumps(v) for k, v in origin.items()})


def run_arms(
    plan: Plan,
    arms: Arms,
    factory: ControllerFactory,
    *observers: Observe,
    duration: float | None = None,
) -> pa.Table:
    """The rows of arms that share a batch, or of one arm alone.

    Args:
        plan: of the sweep.
        arms: some of its episodes.
        factory: that makes the controller.
        observers: called at every control instant.
        duration: instead of that of the sweep [s].

    Raises:
        OctarmError: if an arm, a disturbance or a controller cannot be made.
    """
    started = time.perf_counter()
    environment, controller = begin(plan.spec, arms, factory)
    length = plan.spec.duration if duration is None else duration
    outcome = measure(environment, controller, length, *observers)
    n = len(arms.episodes)
    values = plan.values(arms.episodes)
    held: dict[str, Any] = {
        "episode": arms.episodes,
        "controller": values.pop("controller"),
        "seed": plan.seeds(arms.episodes),
        "status": np.where(outcome.diverged, "diverged", "ok"),
        "diverged_at": outcome.diverged_at,
        **values,
        **outcome.metrics,
        "wall_time": np.full(n, (time.perf_counter() - started) / n),
        "digest": outcome.digest,
        "checkpoints": pa.FixedSizeListArray.from_arrays(outcome.checkpoints.ravel(), CHECKPOINTS),
    }
    form = schema(plan.spec)
    return pa.table([_column(held.get(field.name), field.type, n) for field in form], form)


def begin(
    spec: SweepSpec, arms: Arms, factory: ControllerFactory
) -> tuple[control.Environment, Controller]:
    """The environment and the controller of arms that share a batch, or of one arm alone.

    Raises:
        OctarmError: if an arm, a disturbance or a controller cannot be made.
    """
    environment = load(
        arms.reference,
        disturbances=arms.disturbances,
        batch=arms.batch,
        seed=arms.seeds[0] if arms.batch is None else arms.seeds,
        timestep=spec.timestep,
        control_period=spec.control_period,
        actuation=spec.actuation,
    )
    nominal = nominal_parameters().mismatched(arms.mismatch)
    return environment, spec.controller(arms.controller, nominal, factory)


class Outcome(NamedTuple):
    """What came of n arms; nothing else is kept of their run.

    Attributes:
        diverged_at: when they diverged, shape (n,) [s]; NaN for those that did not.
        metrics: by column, each of shape (n,); NaN where there is no number.
        digest: of their motion, shape (n,), see `octarm.runs.digest.StateDigest`.
        checkpoints: likewise, shape (n, CHECKPOINTS).
    """

    diverged_at: np.ndarray
    metrics: dict[str, np.ndarray]
    digest: np.ndarray
    checkpoints: np.ndarray

    @property
    def diverged(self) -> np.ndarray:
        """Which arms diverged, shape (n,) of bool."""
        return ~np.isnan(self.diverged_at)


class Observer:
    """Measures a run while it goes on, and keeps nothing of it but a few instants."""

    def __init__(self, environment: control.Environment, duration: float) -> None:
        """An observer of a run of so many seconds, for `simulate`."""
        self._physics: AnyPhysics = environment.physics
        self._period = environment.control_timestep()
        periods = whole_periods(duration, self._period)
        self._digest = StateDigest(periods, self._physics.intact)
        self._measured: tuple[Metrics, Recorder] | None = None

    def __call__(self, instant: Instant) -> None:
        """Takes a control instant."""
        if self._measured is None:
            self._measured = self._begin(instant)
        self._digest(instant)
        self._measured[1](instant)

    def outcome(self, message: str) -> Outcome:
        """What came of the arms, given what `simulate` returned."""
        assert self._measured is not None  # a run has one instant at least
        metrics, recorder = self._measured
        recorder.flush()
        diverged_at = _diverged_at(self._physics, message)
        diverged = ~np.isnan(diverged_at)
        batch, n = self._physics.batch_shape, len(diverged)
        results = metrics.result(diverged=diverged if batch else diverged[0])
        values = {
            column.name: results[column.metric].reshape(n, -1)[:, column.place]
            for column in _metric_columns()
            if column.metric in results
        }
        return Outcome(diverged_at, values, *self._digest.result())

    def _begin(self, instant: Instant) -> tuple[Metrics, Recorder]:
        """Metrics for such arms, and what hands them their rows."""
        limit, layer = self._physics.input_limit(), instant.command.layer
        metrics = Metrics(control_period=self._period, input_limit=limit, layer=layer)
        # Without a cycle of references, so that the arms' memory is free when the run is over.
        return metrics, Recorder(metrics.update, fields=METRICS.fields)


def measure(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *observers: Observe,
) -> Outcome:
    """Runs a controller against a batch or one arm, and measures while it runs.

    Args:
        environment: from `octarm.load`.
        controller: see `octarm.interfaces`.
        duration: of the run [s].
        observers: called at every control instant.

    Raises:
        OctarmError: if the duration is not positive, or the controller's force has a wrong shape.
    """
    observer = Observer(environment, duration)

    def observe(instant: Instant) -> None:
        for each in (observer, *observers):
            each(instant)

    return observer.outcome(simulate(environment, controller, duration, observe))


def schema(spec: SweepSpec) -> pa.Schema:
    """The columns of a sweep's table; those of metrics say their unit."""
    known = {
        "episode": pa.int64(),
        "controller": pa.string(),
        "seed": pa.int64(),
        "status": pa.string(),
        "diverged_at": pa.float64(),
    }
    fields = [pa.field(name, kind) for name, kind in known.items()]
    for axis in (*spec.axes, *spec.random):
        if axis.name != "controller":
            fields.append(pa.field(axis.name, pa.string() if axis.words else pa.float64()))
    for column in _metric_columns():
        fields.append(pa.field(column.name, pa.float64(), metadata=column.metadata))
    fields += [
        pa.field("wall_time", pa.float64(), metadata={"unit": "s"}),
        pa.field("digest", pa.uint64()),
        pa.field("checkpoints", _MARKS),
    ]
    return pa.schema(fields)


def _metric_columns() -> list[Column]:
    """The columns of all metrics."""
    modules = nominal_parameters().modules
    return columns(coordinate_names(modules), coordinate_units(modules))


def _diverged_at(physics: AnyPhysics, message: str) -> np.ndarray:
    """When arms diverged, shape (n,) [s]; NaN for those that have not."""
    if physics.batch_shape:
        return physics.diverged_at()  # pyright: ignore[reportAttributeAccessIssue]
    return np.array([physics.steps() * physics.timestep() if message else np.nan])


def _column(values: Any, kind: pa.DataType, count: int) -> pa.Array:
    """A column of the table; NaN and what there is not are null."""
    if values is None:
        return pa.nulls(count, kind)
    if isinstance(values, pa.Array):
        return values
    missing = np.isnan(values) if pa.types.is_floating(kind) else None
    return pa.array(values, kind, mask=missing)
