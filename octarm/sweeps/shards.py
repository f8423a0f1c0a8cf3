"""Running the arms of a shard side by side, down to one row of a table an episode."""

from __future__ import annotations

import dataclasses
import json
import time
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from dm_control.rl import control

from octarm.arm.nominal import LagrangeModel
from octarm.interfaces import Controller, ControllerFactory, Instant
from octarm.metrics.metric import SETTLED_AFTER
from octarm.metrics.table import METRICS, Catalogue, Metrics, columns
from octarm.references import recorded_word
from octarm.runs.digest import CHECKPOINTS, StateDigest
from octarm.runs.experiment import metrics_of
from octarm.runs.versions import host, versions
from octarm.simulation import rollout
from octarm.simulation.engines import LAGRANGE, MUJOCO
from octarm.simulation.environment import AnyPhysics, whole_periods
from octarm.simulation.physics import BatchPhysics
from octarm.simulation.recorder import Recorder
from octarm.simulation.rollout import simulate
from octarm.sweeps.engine_check import COLUMN, TipPaths, checked_episodes
from octarm.sweeps.plan import EpisodeArms, Plan
from octarm.sweeps.spec import ARM, LAYOUT, PLANT_MODULES, SENSING, SweepSpec


def run_shard(
    spec: SweepSpec, shard: int, factory: ControllerFactory, *observers: rollout.Observer
) -> pa.Table:
    """The rows of a shard; they depend on nothing else.

    Some episodes of the analytic arm are run again on MuJoCo, see `octarm.sweeps.engine_check`. The
    schema's metadata say where the rows were made, `host` and `versions`, and the `gains` for the
    first arm.
    """
    plan = Plan(spec)
    arms = plan.arms(plan.shard(shard))
    again = np.intersect1d(arms.episodes, checked_episodes(plan))
    if again.size:
        table = _checked_rows(plan, arms, again, factory, *observers)
    else:
        table = run_arms(plan, arms, factory, *observers)
    origin = {
        "host": host(),
        "versions": versions(spec.engine, spec.code),
        "gains": spec.stated_gains(arms.controller, factory),
    }
    return table.replace_schema_metadata({k: json.dumps(v) for k, v in origin.items()})


def _checked_rows(
    plan: Plan,
    arms: EpisodeArms,
    again: np.ndarray,
    factory: ControllerFactory,
    *observers: rollout.Observer,
) -> pa.Table:
    """The rows of arms, some of which, shape (k,), are run on MuJoCo as well.

    These are k further arms of the same batch: for one by one batches of them, most of the time
    would go to what a call of a controller takes, however few the arms are.
    """
    count, twins = len(arms.episodes), np.arange(len(again)) + len(arms.episodes)
    mujoco = dataclasses.replace(plan.arms(again), engine=MUJOCO)
    environment, _ = begin(plan.spec, mujoco, factory)
    places = np.searchsorted(arms.episodes, again)
    periods = whole_periods(plan.spec.duration, environment.control_timestep())
    paths, others = TipPaths(places, periods), TipPaths(twins, periods)
    both = plan.arms(np.concatenate([arms.episodes, again]))
    table = run_arms(plan, both, factory, *observers, paths, others, twins=environment.physics)
    lost = table["diverged_at"].to_numpy()
    table = table.slice(0, count)
    column = np.full(len(table), np.nan)
    column[places] = paths.difference(others, lost[places], lost[twins])
    at = table.schema.get_field_index(COLUMN)
    field = table.schema.field(at)
    return table.set_column(at, field, _column(column, field.type, len(table)))


def run_arms(
    plan: Plan,
    arms: EpisodeArms,
    factory: ControllerFactory,
    *observers: rollout.Observer,
    duration: float | None = None,
    twins: BatchPhysics | None = None,
) -> pa.Table:
    """The rows of arms that share a batch, or of one arm alone.

    The observers are called at every control instant; a duration [s] takes the place of the
    sweep's. The last arms of a batch are stepped by the physics `twins`, if it is given.
    """
    started = time.perf_counter()
    spec, n = plan.spec, len(arms.episodes)
    environment, controller = begin(spec, arms, factory)
    if twins is not None:
        environment.physics.hand_over(twins)
    length = spec.duration if duration is None else duration
    outcome = measure(
        environment, controller, length, *observers, catalogue=spec.catalogue(), settle=spec.settle
    )
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
    form = schema(spec)
    return pa.table([_column(held.get(field.name), field.type, n) for field in form], form)


def begin(
    spec: SweepSpec, arms: EpisodeArms, factory: ControllerFactory
) -> tuple[control.Environment, Controller]:
    """The environment and the controller of arms that share a batch, or of one arm alone.

    Raises OctarmError if an arm, a disturbance or a controller cannot be made.
    """
    model, reference = spec.believed(arms.arm), recorded_word(arms.reference, spec.code)
    environment = arms.load(model, reference=reference, batch=arms.batch, seed=arms.seeds)
    nominal = model.mismatched(arms.mismatch)
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

    def __init__(
        self,
        environment: control.Environment,
        duration: float,
        catalogue: Catalogue = METRICS,
        settle: float = SETTLED_AFTER,
    ) -> None:
        """An observer of a run of so many seconds, for `simulate`; see `measure`."""
        self._catalogue, self._settle = catalogue, settle
        self._environment = environment
        self._physics: AnyPhysics = environment.physics
        periods = whole_periods(duration, environment.control_timestep())
        self._digest = StateDigest(periods, self._physics.intact)
        self._measured: tuple[Metrics, Recorder] | None = None

    def __call__(self, instant: Instant) -> None:
        """Takes a control instant."""
        if self._measured is None:
            layer = instant.command.layer
            metrics = metrics_of(self._environment, layer, self._settle, self._catalogue)
            # Without a cycle of references, so that the arms' memory is free when the run is over.
            self._measured = metrics, Recorder(metrics.update, fields=self._catalogue.fields)
        self._digest(instant)
        self._measured[1](instant)

    def outcome(self, message: str) -> Outcome:
        """What came of the arms, given what `simulate` returned."""
        assert self._measured is not None  # a run has one instant at least
        metrics, recorder = self._measured
        recorder.flush()
        physics, batch = self._physics, self._physics.batch_shape
        if batch:
            diverged_at = physics.diverged_at()
        else:
            end = physics.steps() * physics.timestep()
            diverged_at = np.array([end if message else np.nan])
        diverged = ~np.isnan(diverged_at)
        n = len(diverged)
        results = metrics.result(diverged=diverged if batch else diverged[0])
        names, units, *_ = physics.coordinates
        values = {
            column.name: results[column.metric].reshape(n, -1)[:, column.place]
            for column in columns(names, units, self._catalogue)
            if column.metric in results
        }
        return Outcome(diverged_at, values, *self._digest.result())


def measure(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *observers: rollout.Observer,
    catalogue: Catalogue = METRICS,
    settle: float = SETTLED_AFTER,
) -> Outcome:
    """Runs a controller against a batch or one arm for a duration [s], and measures while it runs.

    The observers are called at every control instant; the steady regime begins at `settle` [s].
    """
    observer = Observer(environment, duration, catalogue, settle)
    return observer.outcome(simulate(environment, controller, duration, observer, *observers))


# What columns mean that hold no metric, and their units.
_TEXTS = {
    "episode": ("its number", ""),
    "controller": ("the control law", ""),
    "seed": ("which of the seeds 0, 1, .. of the sweep it had", ""),
    "status": ("ok, or diverged", ""),
    "diverged_at": ("when the arm left its limits; null if it did not", "s"),
    "reference": ("the desired motion", ""),
    ARM: ("the true arm", ""),
    LAYOUT: ("layout of the plant", ""),
    SENSING: ("what is read of the plant", ""),
    PLANT_MODULES: ("modules of the plant", "1"),
    "mismatch": ("error of the controller's model", "1"),
    COLUMN: ("how far the tip was from where MuJoCo has it; null if not run again", "m"),
    "wall_time": ("computing time", "s"),
    "digest": ("a number that stands for the motion, bit by bit", ""),
    "checkpoints": (f"the digest after each of {CHECKPOINTS} equal parts of the episode", ""),
}


def schema(spec: SweepSpec) -> pa.Schema:
    """The columns of a sweep's table, whose metadata say what they mean.

    These are the `text`, the `unit` where there is one, and of a metric which values are `better`.
    """
    number, word = pa.float64(), pa.string()

    def field(name: str, kind: pa.DataType, disturbance: str = "", unit: str = "") -> pa.Field:
        text, unit = _TEXTS.get(name, (f"a value of the disturbance {disturbance}", unit))
        said = {"text": text, "unit": unit} if unit else {"text": text}
        return pa.field(name, kind, metadata=said)

    fields = [
        field("episode", pa.int64()),
        field("controller", word),
        field("seed", pa.int64()),
        field("status", word),
        field("diverged_at", number),
    ]
    for axis in (*spec.axes, *spec.random):
        if axis.name != "controller":
            numbers, kind = axis.range(spec.code), word if axis.words else number
            fields.append(field(axis.name, kind, axis.disturbance, numbers.unit if numbers else ""))
    arm = LagrangeModel(max(spec.all_believed(), key=lambda arm: arm.modules))
    for column in columns(arm.names, arm.units, spec.metrics()):
        fields.append(pa.field(column.name, number, metadata=column.description))
    if spec.engine == LAGRANGE:
        fields.append(field(COLUMN, number))
    fields += [
        field("wall_time", number),
        field("digest", pa.uint64()),
        field("checkpoints", pa.list_(pa.uint64(), CHECKPOINTS)),
    ]
    return pa.schema(fields)


def _column(values: Any, kind: pa.DataType, count: int) -> pa.Array:
    if values is None:
        return pa.nulls(count, kind)
    if isinstance(values, pa.Array):
        return values
    missing = np.isnan(values) if pa.types.is_floating(kind) else None
    return pa.array(values, kind, mask=missing)
