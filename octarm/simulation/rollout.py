"""The only simulation loop: a controller against the arm.

`simulate` serves one arm and a batch, and keeps nothing: what happens is handed to observers.
`stream` is the loop with a record of one arm, block by block, however long the run is; `rollout`
returns that record as a trajectory.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable

import numpy as np
from dm_control.rl import control

from octarm.errors import OctarmError
from octarm.interfaces import Controller, Instant, Measurement, Reference, Rows
from octarm.simulation.environment import TrackingTask, whole_periods
from octarm.simulation.physics import ArmPhysics
from octarm.simulation.recorder import Recorder
from octarm.simulation.stepping import AnyPhysics
from octarm.simulation.trajectory import BLOCK, Ending, Trajectory, joined

_LARGEST_FORCE = 1e8  # [N], [N m]; MuJoCo would drop much larger ones
_STATE = "integration state"

Observer = Callable[[Instant], object]


def simulate(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *observers: Observer,
) -> str:
    """The simulation loop: one episode from the start, for one arm or a batch.

    The loop turns the controller's generalised force into the action with what it may know:
    tau = F(q measured)^-1 Q. It ends early when no arm is within its limits.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        *observers: called in this order after every control period.

    Returns:
        How a single arm diverged, as a sentence; empty when it did not. For the arms of a batch see
        `AnyPhysics.intact` and `AnyPhysics.diverged_at`.

    Raises:
        OctarmError: if the duration is not positive, or the controller's force has a wrong shape.
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
        q, v = physics.q(), physics.v()
        if message:
            disturbance = np.zeros_like(q)
        else:
            try:
                timestep = environment.step(tau)
            except control.PhysicsError as error:
                message = physics.divergence() or f"diverged at t = {physics.time():.6g} s: {error}"
            tau = physics.tau()  # what a wrapper made of it
            disturbance = physics.disturbance()
        instant = Instant(measurement, reference, command, q, v, tau, disturbance)
        for observe in observers:
            observe(instant)
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
        OctarmError: if the duration is not positive, the controller's force has a wrong shape, or
            the environment holds a batch of arms.
    """
    blocks: list[Rows] = []
    recorder = ArmRecorder(environment, lambda rows: blocks.append(copied(rows)))
    ending = stream(environment, controller, duration, recorder, progress=progress)
    if ending.status == "interrupted":
        raise KeyboardInterrupt
    return joined(blocks, ending)


class ArmRecorder(Recorder):
    """The record of one arm: all fields at every instant, the readings if sensors act, the states.

    Attributes:
        digest: SHA-256 over MuJoCo's integration states of the rows that were handed on.
    """

    def __init__(
        self,
        environment: control.Environment,
        hand_on: Callable[[Rows], object],
        *,
        rows: int = BLOCK,
    ) -> None:
        """A recorder of blocks of so many rows, empty.

        Raises:
            OctarmError: if the environment holds a batch of arms.
        """
        physics = environment.physics
        if physics.batch_shape:
            raise OctarmError(
                f"a trajectory records one arm; this environment has {physics.batch_shape[0]}"
            )
        self._physics: ArmPhysics = physics
        self.digest = hashlib.sha256()

        def take_up(block: Rows) -> None:
            fields = dict(block)
            self.digest.update(fields.pop(_STATE))
            hand_on(fields)

        super().__init__(take_up, rows=rows)

    def row(self, instant: Instant) -> dict[str, np.ndarray]:
        """The recorded fields of one instant; see `Recorder.row`."""
        row = super().row(instant)
        row[_STATE] = self._physics.integration_state()
        acting = self._physics.acting
        if acting is not None and acting.sensors:
            for name, reading in zip(("q_measured", "v_measured"), instant.measurement[1:]):
                self.add_field(row, name, reading)
        return row


def stream(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    recorder: ArmRecorder,
    *,
    progress: Callable[[], object] | None = None,
) -> Ending:
    """Runs one episode of one arm from the start into a recorder, however long it is.

    An interrupt ends the run; a block of rows that is being handed on is handed on whole before.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        recorder: made for this environment.
        progress: called after every control period.

    Returns:
        How it ended.

    Raises:
        OctarmError: if the duration is not positive, or the controller's force has a wrong shape.
        KeyboardInterrupt: if interrupted before there was a row.
    """
    more = [] if progress is None else [lambda instant: progress()]
    interrupted = False
    try:
        message = simulate(environment, controller, duration, recorder, *more)
    except KeyboardInterrupt:
        if not recorder.count:
            raise
        interrupted = True
        message = f"interrupted at t = {environment.physics.time():.6g} s"
    with contextlib.suppress(KeyboardInterrupt):  # the run is over, there is nothing to end
        recorder.flush()
    status = "interrupted" if interrupted else "diverged" if message else "ok"
    return Ending(status, message, recorder.digest.hexdigest(), recorder.layer)


def copied(rows: Rows) -> Rows:
    """Rows whose memory is not used again."""
    return {name: np.array(array, order="C") for name, array in rows.items()}


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
    physics.freeze(~np.all(usable, axis=-1))
    if physics.batch_shape:
        return ""
    j = int(np.argmin(usable))
    return (
        f"diverged at t = {measurement.t:.6g} s: the controller's force on "
        f"{physics.coordinates.names[j]} is {force[j]:g}"
    )
