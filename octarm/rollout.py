"""The only simulation loop: a controller against the arm, as a trajectory."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
from dm_control.rl import control

from octarm.environment import TrackingTask, whole_periods
from octarm.interfaces import Command, Controller, Measurement, Reference
from octarm.model import coordinate_names
from octarm.plant import ArmPhysics
from octarm.trajectory import Trajectory

_LARGEST_FORCE = 1e8  # [N], [N m]; MuJoCo would drop much larger ones


def rollout(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *,
    progress: Callable[[], object] | None = None,
) -> Trajectory:
    """Runs one episode from the start.

    The loop turns the controller's generalised force into the action with what it may know:
    tau = F(q measured)^-1 Q.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        progress: called after every control period.

    Returns:
        The trajectory; its status is `diverged` when the arm left its limits, or a force was not
        finite. Such a run ends there.

    Raises:
        ValueError: if the duration is not positive, or the controller's force has a wrong shape.
    """
    physics: ArmPhysics = environment.physics
    task: TrackingTask = environment.task
    periods = whole_periods(duration, environment.control_timestep())
    log = _Log(periods)
    timestep = environment.reset()
    state = controller.initial_state(())
    message = ""
    for _ in range(periods):
        seen = timestep.observation
        measurement = Measurement(task.time, seen["q"], seen["v"])
        reference = Reference(seen["q_d"], seen["v_d"], seen["a_d"])
        command, state = controller(state, measurement, reference)
        log.append(physics, measurement.t, reference, command)
        message = _force_problem(command.force, measurement)
        if message:
            break
        try:
            timestep = environment.step(physics.actuation.inputs(measurement.q, command.force))
        except control.PhysicsError as error:
            stopped = f"diverged at t = {physics.time():.6g} s: {physics.wildest()} most, {error}"
            message = physics.divergence() or stopped
        log.acted(physics)
        if progress is not None:
            progress()
        if timestep.last():
            message = physics.divergence()
        if message or timestep.last():
            break
    return log.trajectory(message)


def _force_problem(force: np.ndarray, measurement: Measurement) -> str:
    """Why a controller's force cannot be applied, as a sentence; empty when it can."""
    if np.shape(force) != measurement.q.shape:
        raise ValueError(
            f"the controller's force has shape {np.shape(force)}; the arm needs "
            f"{measurement.q.shape}"
        )
    usable = np.abs(force) <= _LARGEST_FORCE
    if np.all(usable):
        return ""
    j = int(np.argmin(usable))
    name = coordinate_names(len(force) // 2)[j]
    return (
        f"diverged at t = {measurement.t:.6g} s: the controller's force on {name} is {force[j]:g}"
    )


class _Log:
    """Arrays that fill up row by row."""

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._used = 0
        self._columns: dict[str, np.ndarray] = {}
        self._signals: dict[str, np.ndarray] = {}
        self._hash = hashlib.sha256()

    def append(self, physics: ArmPhysics, t: float, reference: Reference, command: Command) -> None:
        """One control instant, before its action acts."""
        row = {
            "t": t,
            "q": physics.q(),
            "v": physics.v(),
            "q_d": reference.q,
            "v_d": reference.v,
            "force": command.force,
        }
        if not self._columns:
            self._columns = {name: self._column(value) for name, value in row.items()}
            self._columns["tau"] = self._column(command.force)
            self._columns["disturbance"] = np.zeros_like(self._columns["tau"])
            self._signals = {name: self._column(value) for name, value in command.signals.items()}
        for name, value in row.items():
            self._columns[name][self._used] = value
        for name, column in self._signals.items():
            column[self._used] = command.signals[name]
        self._hash.update(physics.integration_state().tobytes())
        self._used += 1

    def acted(self, physics: ArmPhysics) -> None:
        """The inputs that the arm received in the period of the last instant."""
        self._columns["tau"][self._used - 1] = physics.tau()

    def trajectory(self, message: str) -> Trajectory:
        """What was recorded; `message` says how a diverged run ended."""
        return Trajectory(
            **{name: column[: self._used] for name, column in self._columns.items()},
            signals={name: column[: self._used] for name, column in self._signals.items()},
            status="diverged" if message else "ok",
            message=message,
            digest=self._hash.hexdigest(),
        )

    def _column(self, value: np.ndarray | float) -> np.ndarray:
        """Rows of the shape of this value, NaN until they are written."""
        return np.full((self._rows, *np.shape(value)), np.nan)
