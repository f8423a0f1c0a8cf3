"""The only simulation loop: a controller against the arm.

`simulate` serves one arm and a batch, and keeps nothing; `stream` hands on the rows of one arm
block by block, however long the run is; `rollout` returns them as a trajectory.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from dm_control.rl import control

from octarm.arm.mjcf import coordinate_names
from octarm.errors import OctarmError
from octarm.interfaces import Controller, Instant, Measurement, Reference
from octarm.interrupts import held_interrupts
from octarm.runs.archive import BLOCK, Ending
from octarm.simulation.batch import BatchPhysics
from octarm.simulation.environment import AnyPhysics, TrackingTask, whole_periods
from octarm.simulation.physics import ArmPhysics
from octarm.simulation.trajectory import Trajectory

_LARGEST_FORCE = 1e8  # [N], [N m]; MuJoCo would drop much larger ones


def simulate(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    observe: Callable[[Instant], object],
) -> str:
    """The simulation loop: one episode from the start, for one arm or a batch.

    The loop turns the controller's generalised force into the action with what it may know:
    tau = F(q measured)^-1 Q. It ends early when no arm is within its limits.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        observe: called after every control period.

    Returns:
        How a single arm diverged, as a sentence; empty when it did not. The arms of a batch are
        told apart by `BatchPhysics.intact`.

    Raises:
        ValueError: if the duration is not positive, or the controller's force has a wrong shape.
    """
    physics: AnyPhysics = environment.physics
    task: TrackingTask = environment.task
    periods = whole_periods(duration, environment.control_timestep())
    timestep = environment.reset()
    state = controller.initial_state(physics.batch_shape)
    message = ""
    for _ in range(periods):
        seen = {name: _read_only(array) for name, array in timestep.observation.items()}
        measurement = Measurement(task.time, seen["q"], seen["v"])
        reference = Reference(seen["q_d"], seen["v_d"], seen["a_d"])
        with np.errstate(all="ignore"):  # what diverges is reported, not warned of
            command, state = controller(state, measurement, reference)
            message = _refusal(physics, command.force, measurement)
            tau = physics.actuation.inputs(measurement.q, command.force)
        q, v, disturbance = physics.q(), physics.v(), np.zeros_like(measurement.q)
        if not message:
            try:
                timestep = environment.step(tau)
            except control.PhysicsError as error:
                message = physics.divergence() or _stop(physics, error)
            tau = physics.tau()  # what a wrapper made of it
            disturbance = physics.disturbance()
        observe(Instant(measurement, reference, command, q, v, tau, disturbance))
        if message or timestep.last():
            break
    return message or physics.divergence()


def rollout(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *,
    progress: Callable[[], object] | None = None,
) -> Trajectory:
    """Runs one episode of one arm from the start, and records it.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        progress: called after every control period.

    Returns:
        The trajectory; its status is `diverged` when the arm left its limits, or a force was not
        finite. Such a run ends there.

    Raises:
        ValueError: if the duration is not positive, the controller's force has a wrong shape, or
            the environment holds a batch of arms.
    """
    blocks: list[Trajectory] = []
    ending = stream(environment, controller, duration, keep=blocks.append, progress=progress)
    if ending.status == "interrupted":
        raise KeyboardInterrupt
    return joined(blocks, ending)


def stream(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *,
    keep: Callable[[Trajectory], object],
    progress: Callable[[], object] | None = None,
    block: int = BLOCK,
) -> Ending:
    """Runs one episode of one arm from the start, and hands its rows on block by block.

    An interrupt ends the run; a block of rows that is being kept is kept whole before.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        keep: called with every `block` of rows while the run goes on, and with the last ones.
        progress: called after every control period.
        block: number of rows.

    Returns:
        How it ended.

    Raises:
        ValueError: if the duration is not positive, the controller's force has a wrong shape, or
            the environment holds a batch of arms.
        KeyboardInterrupt: if interrupted before there was a row.
    """
    physics = environment.physics
    if physics.batch_shape:
        raise OctarmError(
            f"a trajectory records one arm; this environment has {physics.batch_shape[0]}"
        )
    rows = _Rows(physics, block)

    def hand_on() -> None:
        with held_interrupts():
            keep(rows.take())

    def observe(instant: Instant) -> None:
        rows.append(instant)
        if progress is not None:
            progress()
        if rows.full:
            hand_on()

    status = ""
    try:
        message = simulate(environment, controller, duration, observe)
    except KeyboardInterrupt:
        if not rows.count:
            raise
        status, message = "interrupted", f"interrupted at t = {physics.time():.6g} s"
    if not rows.empty:
        with contextlib.suppress(KeyboardInterrupt):  # the run is over, there is nothing to end
            hand_on()
    return Ending(status or ("diverged" if message else "ok"), message, rows.digest())


def joined(blocks: Sequence[Trajectory], ending: Ending) -> Trajectory:
    """Blocks of rows as one trajectory."""
    tables = [dict(rows.arrays()) for rows in blocks]
    arrays = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    return Trajectory.from_arrays(arrays, ending._asdict())


def _read_only(array: np.ndarray) -> np.ndarray:
    """A view: what is recorded is what the controller was given, not what it made of it."""
    view = array.view()
    view.setflags(write=False)
    return view


def _refusal(physics: AnyPhysics, force: np.ndarray, measurement: Measurement) -> str:
    """Freezes the arms whose force cannot be applied; why a single arm was, as a sentence."""
    if np.shape(force) != measurement.q.shape:
        raise OctarmError(
            f"the controller's force has shape {np.shape(force)}; the arm needs "
            f"{measurement.q.shape}"
        )
    usable: np.ndarray = np.abs(force) <= _LARGEST_FORCE
    if usable.all():
        return ""
    if isinstance(physics, BatchPhysics):
        physics.freeze(~np.all(usable, axis=-1))
        return ""
    j = int(np.argmin(usable))
    name = coordinate_names(len(force) // 2)[j]
    return (
        f"diverged at t = {measurement.t:.6g} s: the controller's force on {name} is {force[j]:g}"
    )


def _stop(physics: AnyPhysics, error: control.PhysicsError) -> str:
    return f"diverged at t = {physics.time():.6g} s: {physics.wildest()} most, {error}"


class _Rows:
    """A block of rows that fills up, and the digest of all states so far.

    Attributes:
        count: number of rows so far, those included that were taken.
    """

    def __init__(self, physics: ArmPhysics, size: int) -> None:
        self._physics, self._size = physics, size
        self._used = self.count = 0
        self._columns: dict[str, np.ndarray] = {}
        self._states: list[bytes] = []
        self._hash = hashlib.sha256()

    @property
    def empty(self) -> bool:
        """Whether all rows were taken."""
        return self._used == 0

    @property
    def full(self) -> bool:
        """Whether the next row would not fit."""
        return self._used == self._size

    def append(self, instant: Instant) -> None:
        """One control instant and the period after it; not at all if it is interrupted."""
        row = _row(instant, self._physics)
        if not self._columns:
            self._columns = {
                name: np.empty((self._size, *np.shape(value))) for name, value in row.items()
            }
        for name, column in self._columns.items():
            column[self._used] = row[name]
        del self._states[self._used :]
        self._states.append(self._physics.integration_state().tobytes())
        self._used, self.count = self._used + 1, self.count + 1

    def take(self) -> Trajectory:
        """The rows since the last time."""
        for state in self._states[: self._used]:
            self._hash.update(state)
        arrays = {name: column[: self._used] for name, column in self._columns.items()}
        self._states, self._used = [], 0
        return Trajectory.from_arrays(arrays, Ending("ok", "", "")._asdict())

    def digest(self) -> str:
        """Of the rows that were taken."""
        return self._hash.hexdigest()


def _row(instant: Instant, physics: ArmPhysics) -> Mapping[str, Any]:
    """The numbers of a row by name, as a trajectory has them."""
    measurement, reference = instant.measurement, instant.reference
    row: dict[str, Any] = {
        "t": measurement.t,
        "q": instant.q,
        "v": instant.v,
        "q_d": reference.q,
        "v_d": reference.v,
        "tau": instant.tau,
        "force": instant.command.force,
        "disturbance": instant.disturbance,
    }
    signals = dict(instant.command.signals)
    if physics.acting is not None and physics.acting.sensors:
        signals |= {"q_measured": measurement.q, "v_measured": measurement.v}
    taken = [name for name in signals if name in row]
    if taken:
        raise OctarmError(f"a signal cannot be called {taken[0]!r}: the trajectory has that")
    return row | signals
