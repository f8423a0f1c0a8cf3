"""The analytic arm, compiled, against MuJoCo, and both against the operations that they count.

Closed loops of both engines run in turns with the same open loop of MuJoCo, see
`benchmarks.closed_loop`, and are compared by it, so that other programs disturb the ratio least.
The hundredth of a sweep's episodes that runs on MuJoCo as well is not in these figures.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

import octarm
from benchmarks.closed_loop import PROCESSES, TARGETS, compare, open_loop
from benchmarks.controller_step import moved, physics_step
from benchmarks.figures import (
    C_LOOP,
    C_PLANT,
    LAW_OPERATIONS,
    PLANT_OPERATIONS,
    LeftOut,
    Row,
    Settings,
    duration_of,
    fastest,
    ratios,
)  # fmt: skip
from controllers import make_controller
from octarm.arm.mjcf import build_slim_model
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.simulation.engines import ENGINES, LAGRANGE, usual_engine
from octarm.sweeps.tune import Budget, Space
from octarm.sweeps.tune_cost import Examination, Rig, costs
from octarm.sweeps.workers import WorkerProcesses, cores

MODULES = {3: None, 10: None, 15: 10.0, 30: None}  # and how much faster the engine shall be
STEP = 5e-5  # physics step of all these plants [s]; that of 30 modules may be 88 us
TUNED = "afsmc"
_TIMES = 2  # that a generation is run


def check_installed() -> None:
    """Raises LeftOut without the compiler."""
    if usual_engine() != LAGRANGE:
        raise LeftOut("fast", "the engine lagrange")


def engines(settings: Settings) -> list[Row]:
    """Sweeps with all that they measure, on both engines."""
    check_installed()
    rows: list[Row] = []
    with WorkerProcesses(PROCESSES) as pool:
        for law in TARGETS:
            measured = [compare(pool, law, settings, open_loop, engine) for engine in ENGINES]
            mujoco, lagrange = (np.array(turns.ratios()) for turns in measured)
            times = (lagrange / mujoco).tolist()
            rows += ratios(law, "lagrange over mujoco (stretch: 20)", times, 6.0)
            for engine, turns in zip(ENGINES, measured, strict=True):
                cost = turns.costs()[0]
                rows.append(Row(f"{law}, {engine}, a step of an arm", 1e6 * cost, "us"))
                if law == "afsmc":
                    rows += against_operations(
                        f"{law}, {engine}", cost, PLANT_OPERATIONS + LAW_OPERATIONS, C_LOOP
                    )
    return rows


def plants(settings: Settings) -> list[Row]:
    """A step of plants of several sizes, made of the default rod, on one thread each."""
    check_installed()
    rows: list[Row] = []
    for modules, least in MODULES.items():
        arm = arm_from_rod(Rod(), modules)
        mujoco = physics_step(build_slim_model(arm, STEP), settings.arms)
        calls = (mujoco, analytic_step(arm, settings.arms))
        taken = [x / settings.arms for x in fastest(calls, settings.seconds)]
        rows.append(Row(f"N = {modules}, lagrange over mujoco", taken[0] / taken[1], "1",
                        at_least=least))  # fmt: skip
        for engine, cost in zip(ENGINES, taken, strict=True):
            rows.append(Row(f"N = {modules}, {engine}, a step of an arm", 1e6 * cost, "us"))
            if modules == 3:
                rows += against_operations(f"N = 3, {engine}", cost, PLANT_OPERATIONS, C_PLANT)
    return rows


def analytic_step(arm: ArmParameters, arms: int) -> Callable[[], None]:
    """One step of the analytic arm for a batch in motion, compiled already."""
    environment = octarm.load(parameters=arm, batch=arms, timestep=STEP, engine=LAGRANGE)
    environment.reset()
    physics, draw = environment.physics, np.random.default_rng(0)
    physics.set_motion(physics.hanging() + moved(draw, arms, arm.modules), physics.v())
    physics.set_control(draw.normal(size=(arms, 2 * arm.modules)))
    physics.step()
    return physics.step


def against_operations(name: str, cost: float, operations: int, c_program: float) -> list[Row]:
    """The rate at which a path gets through its operations, and its time over that of C [s]."""
    return [
        Row(f"{name}, counted operations", 1e-9 * operations / cost, "G/s"),
        Row(f"{name}, time over that of plain C", cost / c_program, "1"),
    ]


def tuning(settings: Settings) -> list[Row]:
    """A generation of `octarm tune`, of which its budget is made, by one process and by all."""
    check_installed()
    factory = functools.partial(make_controller, TUNED, gain_set="recommended")
    budget, nominal = Budget(generations=1), octarm.nominal_parameters()
    space = Space(factory(nominal, {}), nominal.modules)
    candidates = space.turned(np.zeros((budget.population, len(space.unknowns))))
    whole = min(1.0, settings.seconds)
    examination = Examination(begin=whole, duration=3.0 * whole)

    def evaluation(engine: str, workers: WorkerProcesses | None = None) -> Callable[[], object]:
        return lambda: costs(examination, factory, candidates, rig=Rig(engine), workers=workers)

    compiling = Examination(begin=1e-3, duration=2e-3)
    costs(compiling, factory, candidates, rig=Rig(LAGRANGE))
    with WorkerProcesses(cores()) as workers:
        costs(compiling, factory, candidates, rig=Rig(LAGRANGE), workers=workers)
        ways = [*map(evaluation, ENGINES), evaluation(LAGRANGE, workers)]
        times = [[duration_of(way) for way in ways] for _ in range(_TIMES)]
    (*wall, by_all), computed = np.min(times, axis=0).T
    return [
        Row(f"{TUNED}, a generation, lagrange by a process a core over mujoco by one",
            wall[0] / by_all, "1", at_least=5.0),
        Row(f"{TUNED}, lagrange over mujoco, each by one process", wall[0] / wall[1], "1"),
        Row(f"{TUNED}, likewise by processor time", computed[0] / computed[1], "1"),
        *(Row(f"{TUNED}, {engine}, a generation of {examination.duration:g} s", x, "s")
          for engine, x in zip(ENGINES, wall, strict=True)),
    ]  # fmt: skip
