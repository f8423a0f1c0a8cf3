"""The only simulation loop: a controller against the arm.

`simulate` serves one arm and a batch, and keeps nothing: what happens is handed to observers.
`ArmRecorder` is the one that records an arm; `rollout` returns such a record as a trajectory.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Callable, Generator, Sequence

import numpy as np
from dm_control.rl import control

from octarm.bars import bar as new_bar
from octarm.bars import visible
from octarm.errors import OctarmError
from octarm.interfaces import Controller, Instant, Measurement, Reference, Rows, Within
from octarm.simulation.arguments import check_simulation, commanded
from octarm.simulation.environment import whole_periods
from octarm.simulation.physics import ArmPhysics
from octarm.simulation.recorder import Recorder
from octarm.simulation.stepping import AnyPhysics
from octarm.simulation.task import TrackingTask
from octarm.simulation.trajectory import BLOCK, Ending, Trajectory, joined

_LARGEST_FORCE = 1e8  # [N], [N m]; MuJoCo would drop much larger ones
_STATE = "integration state"

Observer = Callable[[Instant], object]


def simulate(
    environment: control.Environment, controller: Controller, duration: float, *observers: Observer
) -> str:
    """The simulation loop: the environment's next episode, for one arm or a batch.

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
        OctarmError: if the duration is not positive, the controller's force has a wrong shape, or
            something else moves the arms of this environment before the episode has ended.
    """
    check_simulation(environment, controller, duration)
    periods = whole_periods(duration, environment.control_timestep())
    with environment.physics.exclusive.loop() as turn:
        return _episode(environment, turn, controller, periods, observers)


def _episode(
    environment: control.Environment,
    turn: contextlib.AbstractContextManager[None],
    controller: Controller,
    periods: int,
    observers: Sequence[Observer],
) -> str:
    """See `simulate`; the arms can be moved within `with turn:` alone."""
    physics: AnyPhysics = environment.physics
    task: TrackingTask = environment.task
    step = physics.timestep()
    steps = round(environment.control_timestep() / step)
    with turn:
        timestep = environment.reset()
        task.go_on()
    state = controller.initial_state(physics.batch_shape)
    message = ""
    for period in range(periods):
        seen = timestep.observation
        measurement = Measurement(task.time, _read_only(seen["q"]), _read_only(seen["v"]))
        q_d, v_d, a_d = seen["q_d"], seen["v_d"], seen["a_d"]
        reference = Reference(_read_only(q_d), _read_only(v_d), _read_only(a_d))
        with np.errstate(all="ignore"):  # what diverges is reported, not warned of
            answer = controller(state, measurement, reference)
            command, state = commanded(answer, measurement.q.shape, first=not period)
            message = _refusal(physics, command.force, measurement)
            tau = physics.actuation.inputs(measurement.q, command.force)
        q, v = physics.q(), physics.v()
        plant_q, plant_tip = physics.plant_place()
        q_d_steps = task.desired_steps(step, steps) if steps > 1 else q_d[None]
        if message:
            disturbance = np.zeros_like(q)
            within = _still(steps, q, q_d_steps, plant_tip)
        else:
            try:
                with turn:
                    timestep = environment.step(tau)
            except control.PhysicsError as error:
                message = physics.divergence() or f"diverged at t = {physics.time():.6g} s: {error}"
            tau = physics.tau()  # what a wrapper made of it
            disturbance = physics.disturbance()
            if steps > 1:
                q_steps, received, tip_steps = physics.within()
                within = Within(q_steps, q_d_steps, received, tip_steps)
            else:
                within = Within(q[None], q_d_steps, physics.received()[None])
        instant = Instant(
            measurement, reference, command, q, v, tau, disturbance, plant_q, plant_tip, within
        )
        for observe in observers:
            observe(instant)
        if message or timestep.last():
            break
    return message or physics.divergence()


def _still(steps: int, q: np.ndarray, q_d: np.ndarray, plant_tip: np.ndarray | None) -> Within:
    """A period whose steps are not taken, the arms being at q, shape (..., 2N) [m], [rad]."""
    tip = None if plant_tip is None else plant_tip[None].repeat(steps, 0)
    return Within(q[None].repeat(steps, 0), q_d, np.zeros((steps, *q.shape)), tip)


def rollout(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *,
    progress: Callable[[], object] | None = None,
) -> Trajectory:
    """Runs the next episode of one arm, see `simulate`, and records it.

    The progress is called after every control period; when it is None, a bar says how far the run
    is where it takes more than a second, on terminals and in notebooks.

    Returns:
        The trajectory; its status is `diverged` when the arm left its limits, or a force was not
        finite. Such a run ends there.

    Raises:
        OctarmError: as `simulate` does, or if the environment holds a batch of arms.
    """
    check_simulation(environment, controller, duration)
    blocks: list[Rows] = []
    recorder = ArmRecorder(environment, lambda rows: blocks.append(copied(rows)))
    with _observed(environment, duration, progress) as observers:
        ending = recorder.run(controller, duration, *observers)
    if ending.status == "interrupted":
        raise KeyboardInterrupt
    return dataclasses.replace(joined(blocks, ending), episode=environment.task.episode)


@contextlib.contextmanager
def _observed(
    environment: control.Environment, duration: float, progress: Callable[[], object] | None
) -> Generator[list[Observer]]:
    """The observers that call `progress`, or move a bar if it is seen."""
    if progress is not None:
        yield [lambda _: progress()]
    elif not visible():
        yield []
    else:
        periods = whole_periods(duration, environment.control_timestep())
        with new_bar(total=periods, unit=" periods", delay=1.0) as bar:
            yield [lambda _: bar.update()]


class ArmRecorder(Recorder):
    """Records one arm, however long it runs: all fields of every instant, with what was read.

    `q_measured` and `v_measured`, the readings, are there when they are not `q` and `v`.
    """

    def __init__(
        self,
        environment: control.Environment,
        hand_on: Callable[[Rows], object],
        *,
        rows: int = BLOCK,
    ) -> None:
        """A recorder of blocks of so many physics steps; OctarmError for a batch of arms."""
        self._environment = environment
        self._physics: ArmPhysics = environment.physics
        if self._physics.batch_shape:
            raise OctarmError(
                f"a trajectory records one arm; this environment has {self._physics.batch_shape[0]}"
            )
        self._digest = hashlib.sha256()

        def take_up(block: Rows) -> None:
            fields = dict(block)
            self._digest.update(fields.pop(_STATE).data)
            hand_on(fields)

        steps = round(environment.control_timestep() / self._physics.timestep())
        super().__init__(take_up, rows=max(1, rows // steps))  # all steps of a period are kept

    def row(self, instant: Instant) -> dict[str, np.ndarray]:
        """The recorded fields of one instant, and what the digest is made of."""
        row = super().row(instant)
        row[_STATE] = self._physics.integration_state()
        if not self._physics.reads_truth():
            self.add_field(row, "q_measured", instant.measurement.q)
            self.add_field(row, "v_measured", instant.measurement.v)
        return row

    def run(self, controller: Controller, duration: float, *observers: Observer) -> Ending:
        """Runs the next episode, as `rollout` does; to be called once.

        An interrupt ends the run; it is a KeyboardInterrupt where there was no row before. Further
        observers are called after every control period.
        """
        interrupted = False
        try:
            message = simulate(self._environment, controller, duration, self, *observers)
        except KeyboardInterrupt:
            if not self.count:
                raise
            interrupted = True
            message = f"interrupted at t = {self._physics.time():.6g} s"
        with contextlib.suppress(KeyboardInterrupt):  # the run is over, there is nothing to end
            self.flush()
        status = "interrupted" if interrupted else "diverged" if message else "ok"
        return Ending(self.layer, status, message, self._digest.hexdigest())


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
    usable: np.ndarray = np.abs(force) <= _LARGEST_FORCE
    if np.count_nonzero(usable) == usable.size:
        return ""
    physics.freeze(~np.all(usable, axis=-1))
    if physics.batch_shape:
        return ""
    j = int(np.argmin(usable))
    return (
        f"diverged at t = {measurement.t:.6g} s: the controller's force on "
        f"{physics.coordinates.names[j]} is {force[j]:g}"
    )
