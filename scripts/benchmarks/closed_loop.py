"""What a step of an arm costs in a sweep, against the bare physics and against one arm at a time.

Two processes of one thread each run a shard of a sweep, all that it measures included. Every few
control periods they stop and let the rival do as much, so that both meet the same machine. A
figure is the median of the ratios of such turns: of wall time, and of the time that the processor
computed, which other programs disturb less.

One arm alone has turns with the physics as well, of which the shortest counts: other programs
lengthen both.
"""

import functools
import itertools
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import mujoco.batch
import numpy as np
from dm_control.rl import control

import octarm
from benchmarks.figures import Row, Settings, duration_of, ratios, turns
from controllers import make_controller
from octarm.arm.mjcf import build_slim_model
from octarm.interfaces import Instant, Measurement, Reference
from octarm.metrics.table import SETTLED_AFTER, Metrics
from octarm.simulation import rollout
from octarm.simulation.engines import MUJOCO
from octarm.simulation.rollout import ArmRecorder
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import Observer, begin, run_arms
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.workers import WorkerProcesses

TARGETS = {"afsmc": 0.78, "smc-boundary": 0.85}  # share of the open loop's throughput
FASTER = 30.0  # than one arm at a time
PROCESSES = 2
DURATION = 10.0  # of the episodes [s]
TURN = 16  # control periods
TURN_OF_ONE = 25  # control periods of one arm, and physics steps
_SECONDS = 15.0  # a measurement, by that many of the settings' seconds
_SECONDS_OF_ONE = 5.0  # likewise of one arm


class Turns(NamedTuple):
    """Times of a step of an arm by `clocks`, shape (turns, 2) [s]."""

    sweep: np.ndarray  # with its share of what a shard needs once
    rival: np.ndarray

    def ratios(self) -> Sequence[float]:
        """Median throughput of the sweep over that of the rival, by both clocks [1]."""
        return np.median(self.rival / self.sweep, axis=0).tolist()

    def costs(self) -> Sequence[float]:
        """Median time of a step in the sweep and of the rival, by the processor's clock [s]."""
        return [float(np.median(times[:, 1])) for times in self]


# A call for a law and an environment, and how many steps of an arm it takes.
Rival = Callable[[str, control.Environment], tuple[Callable[[], object], int]]


def closed_loop(settings: Settings) -> list[Row]:
    """A sweep against the open loop of the physics, whose model has nothing to draw or to read."""
    rows: list[Row] = []
    with WorkerProcesses(PROCESSES) as pool:
        for name, least in TARGETS.items():
            measured = compare(pool, name, settings, open_loop)
            sweep, bare = measured.costs()
            rows += [
                *ratios(name, "throughput over open loop", measured.ratios(), least),
                Row(f"{name}, a step of an arm", 1e6 * sweep, "us"),
                Row(f"{name}, a step of the open loop", 1e6 * bare, "us"),
                Row(f"{name}, arms in real time, two cores", PROCESSES * _step() / sweep, "1"),
            ]
    return rows


def one_by_one(settings: Settings) -> list[Row]:
    """A sweep against a plain loop over one arm's environment, in as many processes."""
    rows: list[Row] = []
    rivals = (("a plain loop", plain_loop, None), ("one that measures", measured_loop, FASTER))
    with WorkerProcesses(PROCESSES) as pool:
        for name, (title, rival, least) in itertools.product(TARGETS, rivals):
            measured = compare(pool, name, settings, rival)
            rows += [
                *ratios(name, f"throughput over {title}", measured.ratios(), least),
                Row(f"{name}, a step of {title}", 1e6 * measured.costs()[1], "us"),
            ]
    return rows


def compare(
    pool: WorkerProcesses, name: str, settings: Settings, rival: Rival, engine: str = MUJOCO
) -> Turns:
    """The turns of all processes."""
    arguments = (name, settings.arms, _SECONDS * settings.seconds, rival, engine)
    calls = [pool.submit(take_turns, *arguments) for _ in range(PROCESSES)]
    found = [call.result() for call in calls]
    return Turns(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def take_turns(name: str, arms: int, seconds: float, rival: Rival, engine: str) -> Turns:
    """A shard of this controller on this engine and a rival in turns, for so long [s]."""
    text = f'controller = "{name}"\nepisodes = {arms}\nbatch = {arms}\nduration = {DURATION}\n'
    plan = Plan(parse_spec(f'{text}engine = "{engine}"\n'))
    shard = plan.arms(plan.shard(0))

    def begun_and_ended() -> None:
        run_arms(plan, shard, make_controller, duration=_step())

    begun_and_ended()  # an engine may have to be compiled
    once = duration_of(begun_and_ended) * _step() / (DURATION * arms)
    environment, controller = begin(plan.spec, shard, make_controller)
    observer = Observer(environment, DURATION)

    def observe(instant: Instant) -> None:
        """Past the transient, where more is measured."""
        measurement = instant.measurement._replace(t=instant.measurement.t + SETTLED_AFTER)
        observer(instant._replace(measurement=measurement))

    other, steps = rival(name, environment)
    times = turns(environment, controller, DURATION, observe, other, TURN, seconds)
    return Turns(times[:, 0] / (TURN * arms) + once, times[:, 1] / steps)


def open_loop(name: str, environment: control.Environment) -> tuple[Callable[[], object], int]:
    """Steps of the slim model, as many arms, under inputs that do not change."""
    del name
    (arms,), model = environment.physics.batch_shape, build_slim_model()
    batch = mujoco.batch.Batch(model, arms, 1)
    batch.bind("qpos")[:] = model.key("hanging").qpos
    batch.bind("ctrl")[:] = np.random.default_rng(0).normal(size=(arms, model.nu))

    def turn() -> None:
        for _ in range(TURN):
            batch.step()

    return turn, TURN * arms


def plain_loop(name: str, environment: control.Environment) -> tuple[Callable[[], object], int]:
    """The obvious alternative: dm_control's loop over one arm, with the same controller."""
    del environment
    return _alone(name, lambda instant: None)


def measured_loop(name: str, environment: control.Environment) -> tuple[Callable[[], object], int]:
    """The same, and what a sweep measures is taken up at every instant."""
    low, high = environment.physics.input_range()
    metrics = Metrics(control_period=_step(), input_range=(low[0], high[0]))

    def observe(instant: Instant) -> None:
        row = {
            "t": instant.measurement.t + SETTLED_AFTER, "q": instant.q, "q_d": instant.reference.q,
            "tau": instant.tau, "force": instant.command.force, **instant.command.signals,
        }  # fmt: skip
        metrics.update({name: np.asarray(value)[None] for name, value in row.items()})

    return _alone(name, observe)


def _alone(name: str, observe: rollout.Observer) -> tuple[Callable[[], object], int]:
    """Steps of one arm's environment, episode after episode."""
    environment = octarm.load()
    controller = make_controller(name, octarm.nominal_parameters())
    actuation, disturbance = environment.physics.actuation, np.zeros(0)
    count = 200
    periods = itertools.cycle(range(math.ceil(DURATION / _step())))
    timestep = state = None

    def turn() -> None:
        nonlocal timestep, state
        for period in itertools.islice(periods, count):
            if timestep is None or period == 0:
                timestep, state = environment.reset(), controller.initial_state()
            seen = timestep.observation
            measurement = Measurement(environment.task.time, seen["q"], seen["v"])
            reference = Reference(seen["q_d"], seen["v_d"], seen["a_d"])
            command, state = controller(state, measurement, reference)
            tau = actuation.inputs(measurement.q, command.force)
            q, v = measurement.q, measurement.v
            timestep = environment.step(tau)
            observe(Instant(measurement, reference, command, q, v, tau, disturbance))

    return turn, count


def _step() -> float:
    """Physics step and control period [s]."""
    return float(octarm.build_model().opt.timestep)


def one_arm(settings: Settings) -> list[Row]:
    """One arm alone: the shortest turns of its loop and of the physics, and a whole run."""
    rows: list[Row] = []
    for law in TARGETS:
        period, step = _alternating(law, _SECONDS_OF_ONE * settings.seconds)
        rows += [
            Row(f"{law}, a control period in RK4 steps", period / step, "1", at_most=10.0),
            Row(f"{law}, a control period", 1e6 * period, "us"),
            Row(f"{law}, an RK4 step of the slim model", 1e6 * step, "us"),
        ]
        duration = 10.0 * min(1.0, settings.seconds)
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "octarm", "run", "--controller", law,
                       "--duration", str(duration), "--out", f"{folder}/run"]  # fmt: skip
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            taken = duration_of(functools.partial(subprocess.run, command, check=True, **quiet))[0]
        rows.append(Row(f"{law}, octarm run, times real time", duration / taken, "1", at_least=3.0))
    return rows


def _alternating(law: str, seconds: float) -> np.ndarray:
    """A control period, and a physics step of the slim model, whose arm hangs [s]."""
    arm = octarm.nominal_parameters()
    environment, controller = octarm.load(), make_controller(law, arm.mismatched(-0.3))
    model = build_slim_model(arm)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)

    def step() -> None:
        for _ in range(TURN_OF_ONE):
            mujoco.mj_step(model, data)

    recorder = ArmRecorder(environment, lambda rows: None)
    times = turns(environment, controller, 1e4, recorder, step, TURN_OF_ONE, seconds)
    return np.min(times[:, :, 0], axis=0) / TURN_OF_ONE
