"""The only simulation loop: a controller against the arm, as a trajectory."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from dm_control.rl import control

from octarm.batch import BatchPhysics
from octarm.environment import AnyPhysics, TrackingTask, whole_periods
from octarm.interfaces import Command, Controller, Measurement, Reference
from octarm.model import coordinate_names
from octarm.plant import ArmPhysics
from octarm.trajectory import Trajectory

_LARGEST_FORCE = 1e8  # [N], [N m]; MuJoCo would drop much larger ones


class Instant(NamedTuple):
    """One control instant: what was there, what was asked, and what acted until the next one.

    Attributes:
        measurement: what the controller was told.
        reference: what was wanted.
        command: what the controller answered.
        q: true coordinates, shape (..., 2N) [m], [rad].
        v: true velocities, shape (..., 2N) [m/s], [rad/s].
        tau: input forces that were asked for, shape (..., 2N) [N].
        disturbance: generalised force that was added, mean over the period, shape (..., 2N).
    """

    measurement: Measurement
    reference: Reference
    command: Command
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    disturbance: np.ndarray


def drive(
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
    keep: Callable[[Trajectory], object] | None = None,
    block: int = 5000,
) -> Trajectory:
    """Runs one episode of one arm from the start, and records it.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        progress: called after every control period.
        keep: called with every `block` of rows while the run goes on, and with the last ones. An
            interrupt then ends the run: what there is is returned, with the status `interrupted`.
        block: number of rows.

    Returns:
        The trajectory; its status is `diverged` when the arm left its limits, or a force was not
        finite. Such a run ends there.

    Raises:
        ValueError: if the duration is not positive, the controller's force has a wrong shape, or
            the environment holds a batch of arms.
    """
    physics = environment.physics
    if physics.batch_shape:
        raise ValueError(
            f"a trajectory records one arm; this environment has {physics.batch_shape[0]}"
        )
    log = _Log(whole_periods(duration, environment.control_timestep()), environment)

    def observe(instant: Instant) -> None:
        log.append(instant)
        if progress is not None:
            progress()
        if keep is not None and len(log) - kept[-1] == block:
            keep(log.rows(kept[-1]))
            kept.append(len(log))

    kept, status, message = [0], "", ""
    try:
        message = drive(environment, controller, duration, observe)
    except KeyboardInterrupt:
        if keep is None or not len(log):
            raise
        status, message = "interrupted", f"interrupted at t = {physics.time():.6g} s"
    if keep is not None and len(log) > kept[-1]:
        keep(log.rows(kept[-1]))
    return log.trajectory(message, status)


def _read_only(array: np.ndarray) -> np.ndarray:
    """A view: what is recorded is what the controller was given, not what it made of it."""
    view = array.view()
    view.setflags(write=False)
    return view


def _refusal(physics: AnyPhysics, force: np.ndarray, measurement: Measurement) -> str:
    """Freezes the arms whose force cannot be applied; why a single arm was, as a sentence."""
    if np.shape(force) != measurement.q.shape:
        raise ValueError(
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


class _Log:
    """Arrays that fill up row by row."""

    def __init__(self, rows: int, environment: control.Environment) -> None:
        self._rows = rows
        self._physics: ArmPhysics = environment.physics
        self._used = 0
        self._columns: dict[str, np.ndarray] = {}
        self._signals: dict[str, np.ndarray] = {}
        self._hash = hashlib.sha256()

    def append(self, instant: Instant) -> None:
        """One control instant and the period after it."""
        measurement, reference, command = instant.measurement, instant.reference, instant.command
        row = {
            "t": measurement.t,
            "q": instant.q,
            "v": instant.v,
            "q_d": reference.q,
            "v_d": reference.v,
            "tau": instant.tau,
            "force": command.force,
            "disturbance": instant.disturbance,
        }
        signals = dict(command.signals)
        if self._physics.acting is not None and self._physics.acting.sensors:
            signals |= {"q_measured": measurement.q, "v_measured": measurement.v}
        if not self._columns:
            self._columns = {name: self._column(value) for name, value in row.items()}
            self._signals = {name: self._column(value) for name, value in signals.items()}
        for name, value in row.items():
            self._columns[name][self._used] = value
        for name, column in self._signals.items():
            column[self._used] = signals[name]
        self._hash.update(self._physics.integration_state().tobytes())
        self._used += 1

    def __len__(self) -> int:
        return self._used

    def rows(self, start: int) -> Trajectory:
        """The latest rows."""
        return self.trajectory("", start=start)

    def trajectory(self, message: str, status: str = "", start: int = 0) -> Trajectory:
        """What was recorded; `message` says how a run ended before its time."""
        rows = slice(start, self._used)
        return Trajectory(
            **{name: column[rows] for name, column in self._columns.items()},
            signals={name: column[rows] for name, column in self._signals.items()},
            status=status or ("diverged" if message else "ok"),  # pyright: ignore
            message=message,
            digest=self._hash.hexdigest(),
        )

    def _column(self, value: np.ndarray | float) -> np.ndarray:
        """Rows of the shape of this value, NaN until they are written."""
        return np.full((self._rows, *np.shape(value)), np.nan)
