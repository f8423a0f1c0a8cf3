"""Running the arms of a shard side by side, down to one row of a table an episode."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from dm_control.rl import control

from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.arrays import coordinate_names, coordinate_units
from octarm.interfaces import Controller, Instant, Rows
from octarm.metrics.table import METRICS, Column, Metrics, columns
from octarm.runs.digest import CHECKPOINTS, StateDigest
from octarm.runs.versions import host, versions
from octarm.simulation.environment import AnyPhysics, load, whole_periods
from octarm.simulation.rollout import simulate
from octarm.sweeps.plan import Arms, Plan
from octarm.sweeps.spec import Axis, SweepSpec

# Name, nominal model and gains to controller; `controllers.make_controller` is one.
Factory = Callable[[str, ArmParameters, Mapping[str, Any]], Controller]

# Of a coordinate array. A few instants at a time are faster than one by one: the physics between
# two of them leaves the processor's caches cold.
_NUMBERS_A_BLOCK = 50_000
_FINGERPRINT = pa.list_(pa.uint64(), CHECKPOINTS)


def run_shard(spec: SweepSpec, shard: int, factory: Factory) -> pa.Table:
    """The rows of a shard; they depend on nothing else.

    The metadata of the table's schema say where they were made: `host` and `versions`.

    Raises:
        ValueError: if an arm, a disturbance or a controller cannot be made.
    """
    plan = Plan(spec)
    table = run_arms(plan, plan.arms(plan.shards[shard]), factory)
    facts = {"host": host(), "versions": versions()}
    return table.replace_schema_metadata({k: json.dumps(v) for k, v in facts.items()})


def run_arms(plan: Plan, arms: Arms, factory: Factory, duration: float | None = None) -> pa.Table:
    """The rows of arms that share a batch, or of one arm alone.

    Args:
        plan: of the sweep.
        arms: some of its episodes.
        factory: that makes the controller.
        duration: instead of that of the sweep [s].

    Raises:
        ValueError: if an arm, a disturbance or a controller cannot be made.
    """
    started = time.perf_counter()
    environment, controller = begin(plan.spec, arms, factory)
    length = plan.spec.duration if duration is None else duration
    observer = Observer(environment, controller, length)
    message = simulate(environment, controller, length, observer)
    diverged_at = _diverged_at(environment.physics, message)
    measured = observer.metrics(diverged=~np.isnan(diverged_at))
    digest, checkpoints = observer.digest.result()
    n = len(arms.episodes)
    values = plan.values(arms.episodes)
    columns: dict[str, Any] = {
        "episode": arms.episodes,
        "controller": values.pop("controller"),
        "seed": plan.seeds(arms.episodes),
        "status": np.where(np.isnan(diverged_at), "ok", "diverged"),
        "diverged_at": diverged_at,
        **values,
        **measured,
        "wall_time": np.full(n, (time.perf_counter() - started) / n),
        "digest": digest,
        "checkpoints": pa.FixedSizeListArray.from_arrays(checkpoints.ravel(), CHECKPOINTS),
    }
    form = schema(plan.spec)
    return pa.table([_column(columns.get(field.name), field.type, n) for field in form], form)


def begin(spec: SweepSpec, arms: Arms, factory: Factory) -> tuple[control.Environment, Controller]:
    """The environment and the controller of arms that share a batch, or of one arm alone.

    Raises:
        ValueError: if an arm, a disturbance or a controller cannot be made.
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
    gains = spec.gains.get(arms.controller, {})
    return environment, factory(arms.controller, nominal, gains)


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
            words = isinstance(axis, Axis) and axis.words
            fields.append(pa.field(axis.name, pa.string() if words else pa.float64()))
    for column in metric_columns():
        fields.append(pa.field(column.name, pa.float64(), metadata=column.metadata))
    fields += [
        pa.field("wall_time", pa.float64(), metadata={"unit": "s"}),
        pa.field("digest", pa.uint64()),
        pa.field("checkpoints", _FINGERPRINT),
    ]
    return pa.schema(fields)


class Observer:
    """Measures a run while it goes on, and keeps nothing of it but a few instants.

    Attributes:
        digest: of the states.
    """

    def __init__(
        self, environment: control.Environment, controller: Controller, duration: float
    ) -> None:
        """An observer of a run of so many seconds, for `simulate`."""
        self._physics: AnyPhysics = environment.physics
        period = environment.control_timestep()
        self.digest = StateDigest(whole_periods(duration, period))
        self._metrics = Metrics(
            control_period=period,
            input_limit=self._physics.input_limit(),
            layer=getattr(controller, "phi", None),
        )
        self._alive: np.ndarray | None = None
        self._rows: _Rows | None = None

    def __call__(self, instant: Instant) -> None:
        """Takes up a control instant."""
        self.digest.update(instant.q, instant.v, self._alive)
        alive = np.atleast_1d(self._physics.intact())
        self._alive = None if alive.all() else alive
        signals = instant.command.signals
        row = {
            "t": np.asarray(instant.measurement.t),
            "q": instant.q,
            "q_d": np.atleast_2d(instant.reference.q)
            if instant.q.ndim > 1
            else instant.reference.q,
            "tau": instant.tau,
            "force": instant.command.force,
            **{name: signals[name] for name in METRICS.fields if name in signals},
        }
        if self._rows is None:
            self._rows = _Rows(row, max(1, _NUMBERS_A_BLOCK // instant.q.size))
        if self._rows.append(row):
            self._metrics.update(self._rows.take())

    def metrics(self, diverged: np.ndarray) -> dict[str, np.ndarray]:
        """The measures by column, each of shape (n,).

        Args:
            diverged: which arms did, shape (n,) of bool.
        """
        if self._rows is not None:
            self._metrics.update(self._rows.take())
        single = not self._physics.batch_shape
        results = self._metrics.result(diverged=diverged[0] if single else diverged)
        n = len(diverged)
        return {
            column.name: results[column.metric].reshape(n, -1)[:, column.place]
            for column in metric_columns()
            if column.metric in results
        }


class _Rows:
    """A few instants, copied side by side: what the loop hands over does not last."""

    def __init__(self, like: Mapping[str, np.ndarray], count: int) -> None:
        self._columns = {name: _stacked(row, count) for name, row in like.items()}
        self._count, self._used = count, 0

    def append(self, row: Mapping[str, np.ndarray]) -> bool:
        """Takes up a row; whether it was the last one there is place for."""
        for name, column in self._columns.items():
            column[self._used] = row[name]
        self._used += 1
        return self._used == self._count

    def take(self) -> Rows:
        """The rows, whose memory will be used again."""
        rows = {name: column[: self._used] for name, column in self._columns.items()}
        self._used = 0
        return rows


def _stacked(row: np.ndarray, count: int) -> np.ndarray:
    """Rows like this one, each contiguous along the arms, shape (count, ...)."""
    backwards = np.empty((count, *row.shape[::-1]), dtype=row.dtype)
    return backwards.transpose(0, *range(row.ndim, 0, -1))


def metric_columns() -> list[Column]:
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
