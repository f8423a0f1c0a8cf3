"""What a step of an arm costs in a sweep, against the bare physics and against one arm at a time.

Two processes of one thread each run a shard of a sweep, all that it measures included. Every few
control periods they stop and let the rival do as much, so that both meet the same machine. A
figure is the median of the ratios of such turns: of wall time, and of the time that the processor
computed, which other programs disturb less.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from typing import NamedTuple

import mujoco.batch
import numpy as np
from dm_control.rl import control

import octarm
from benchmarks.figures import Row, Settings, clocks
from controllers import make_controller
from octarm.interfaces import Instant, Measurement, Reference
from octarm.metrics.table import SETTLED_AFTER, Metrics
from octarm.simulation.rollout import simulate
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import Observer, begin, run_arms
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.workers import WorkerProcesses

TARGETS = {"afsmc": 0.78, "smc-boundary": 0.85}  # share of the open loop's throughput
FASTER = 30.0  # than one arm at a time
PROCESSES = 2
DURATION = 10.0  # of the episodes [s]
TURN = 16  # control periods
FEWEST = 3  # turns
_SECONDS = 15.0  # a measurement, by that many of the settings' seconds


class Turns(NamedTuple):
    """Times by `clocks` of a step of an arm, shape (turns, 2) [s].

    Attributes:
        sweep: in the sweep, with its share of what a shard needs once.
        rival: of the rival.
    """

    sweep: np.ndarray
    rival: np.ndarray

    def ratios(self) -> tuple[float, float]:
        """Median throughput of the sweep over that of the rival, by both clocks [1]."""
        wall, computed = np.median(self.rival / self.sweep, axis=0)
        return float(wall), float(computed)

    def costs(self) -> tuple[float, float]:
        """Median time of a step in the sweep and of the rival, by the processor's clock [s]."""
        return float(np.median(self.sweep[:, 1])), float(np.median(self.rival[:, 1]))


Rival = Callable[[str, control.Environment], Callable[[], int]]


def closed_loop(settings: Settings) -> list[Row]:
    """A sweep against the open loop of the physics, whose model has nothing to draw or to read.

    The whole model of `octarm.build_model`, with geoms, sites and sensors, is a slower rival.
    """
    rows: list[Row] = []
    with WorkerProcesses(PROCESSES) as pool:
        for name, least in TARGETS.items():
            turns = compare(pool, name, settings, open_loop)
            wall, computed = turns.ratios()
            sweep, bare = turns.costs()
            whole = compare(pool, name, settings, whole_loop)
            rows += [
                Row(f"{name}, throughput over open loop", wall, "1", at_least=least),
                Row(f"{name}, by processor time", computed, "1", at_least=least),
                Row(f"{name}, a step of an arm", 1e6 * sweep, "us"),
                Row(f"{name}, a step of the open loop", 1e6 * bare, "us"),
                Row(f"{name}, throughput over the whole model", whole.ratios()[0], "1"),
                Row(f"{name}, a step of the whole model", 1e6 * whole.costs()[1], "us"),
                Row(f"{name}, arms in real time, two cores", PROCESSES * _step() / sweep, "1"),
            ]
    return rows


def one_by_one(settings: Settings) -> list[Row]:
    """A sweep against a plain loop over one arm's environment, in as many processes."""
    rows: list[Row] = []
    rivals: dict[str, tuple[Rival, float | None]] = {
        "a plain loop": (plain_loop, None),
        "one that measures": (measured_loop, FASTER),
    }
    with WorkerProcesses(PROCESSES) as pool:
        for name, (title, (rival, least)) in itertools.product(TARGETS, rivals.items()):
            turns = compare(pool, name, settings, rival)
            wall, computed = turns.ratios()
            rows += [
                Row(f"{name}, throughput over {title}", wall, "1", at_least=least),
                Row(f"{name}, by processor time", computed, "1", at_least=least),
                Row(f"{name}, a step of {title}", 1e6 * turns.costs()[1], "us"),
            ]
    return rows


def compare(pool: WorkerProcesses, name: str, settings: Settings, rival: Rival) -> Turns:
    """The turns of all processes."""
    seconds = _SECONDS * settings.seconds
    calls = [pool.submit(take_turns, name, settings.arms, seconds, rival) for _ in range(PROCESSES)]
    found = [call.result() for call in calls]
    return Turns(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def take_turns(name: str, arms: int, seconds: float, rival: Rival) -> Turns:
    """A shard of this controller and a rival in turns, for so long [s]."""
    text = f'controller = "{name}"\nepisodes = {arms}\nbatch = {arms}\nduration = {DURATION}'
    plan = Plan(parse_spec(text))
    shard = plan.arms(plan.shards[0])
    started = clocks()
    run_arms(plan, shard, make_controller, duration=_step())
    once = (clocks() - started) * _step() / (DURATION * arms)
    environment, controller = begin(plan.spec, shard, make_controller)
    observer = Observer(environment, DURATION)
    other = rival(name, environment)
    sweep: list[np.ndarray] = []
    others: list[np.ndarray] = []
    periods, end, begun = 0, time.perf_counter() + seconds, clocks()

    def observe(instant: Instant) -> None:
        nonlocal periods, begun
        # Past the transient, where more is measured.
        measurement = instant.measurement._replace(t=instant.measurement.t + SETTLED_AFTER)
        observer(instant._replace(measurement=measurement))
        periods += 1
        if periods % TURN:
            return
        there = clocks()
        steps = other()
        sweep.append((there - begun) / (TURN * arms) + once)
        others.append((clocks() - there) / steps)
        if len(sweep) > FEWEST and time.perf_counter() > end:
            raise _TimeIsUp
        begun = clocks()

    try:
        simulate(environment, controller, DURATION, observe)
    except _TimeIsUp:
        pass
    return Turns(np.array(sweep[1:]), np.array(others[1:]))  # the first ones warm up


class _TimeIsUp(Exception):
    """Ends a measurement."""


def open_loop(name: str, environment: control.Environment) -> Callable[[], int]:
    """Steps of the same slim model, as many arms, under inputs that do not change."""
    del name
    batch = environment.physics.batch
    return _stepping(batch.get_model(0), batch.nsim)


def whole_loop(name: str, environment: control.Environment) -> Callable[[], int]:
    """The same with the model that runs of one arm have, which can be drawn."""
    del name
    return _stepping(octarm.build_model(), environment.physics.batch.nsim)


def _stepping(model: mujoco.MjModel, arms: int) -> Callable[[], int]:
    batch = mujoco.batch.Batch(model, arms, 1)
    batch.bind("qpos")[:] = model.key("hanging").qpos
    batch.bind("ctrl")[:] = np.random.default_rng(0).normal(size=(arms, model.nu))

    def turn() -> int:
        for _ in range(TURN):
            batch.step()
        return TURN * arms

    return turn


def plain_loop(name: str, environment: control.Environment) -> Callable[[], int]:
    """The obvious alternative: dm_control's loop over one arm, with the same controller."""
    del environment
    return _alone(name, lambda instant: None)


def measured_loop(name: str, environment: control.Environment) -> Callable[[], int]:
    """The same, and what a sweep measures is taken up at every instant."""
    low, high = environment.physics.input_range()
    metrics = Metrics(control_period=_step(), input_range=(low[0], high[0]))

    def observe(instant: Instant) -> None:
        command = instant.command
        metrics.update(
            {
                "t": np.array([instant.measurement.t + SETTLED_AFTER]),
                "q": instant.q[None],
                "q_d": instant.reference.q[None],
                "tau": instant.tau[None],
                "force": command.force[None],
                **{name: signal[None] for name, signal in command.signals.items()},
            }
        )

    return _alone(name, observe)


def _alone(name: str, observe: Callable[[Instant], None]) -> Callable[[], int]:
    """Steps of one arm's environment, episode after episode."""
    environment = octarm.load()
    controller = make_controller(name, octarm.nominal_parameters())
    actuation, disturbance = environment.physics.actuation, np.zeros(0)
    count = 200
    periods = itertools.cycle(range(math.ceil(DURATION / _step())))
    timestep = state = None

    def turn() -> int:
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
        return count

    return turn


def _step() -> float:
    """Physics step and control period [s]."""
    return float(octarm.build_model().opt.timestep)
