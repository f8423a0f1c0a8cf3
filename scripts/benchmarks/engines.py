"""The analytic arm, compiled, against MuJoCo, and both against the operations that they count.

Closed loops of both engines run in turns with the same open loop of MuJoCo, see
`benchmarks.closed_loop`, and are compared by it, so that other programs disturb the ratio least.
The hundredth of a sweep's episodes that runs on MuJoCo as well is not in these figures.

Beside chains of as many modules stands PyElastica's Cosserat rod. Every program takes the longest
step at which it is stable on the default rod, so that the time that it simulates in a second
compares them. PyElastica's rod moves in space and shears; with a hundred times the shear stiffness
it is the rod of octarm's chains, which do not shear. Its damping is uniform and sets the step no
limit; the dampers along the springs of the chains are what limits the step of the finer ones.
PyElastica steps one rod; octarm steps one arm alone, or an arm of a batch, on one core.
"""

import functools
import math
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
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import build_slim_model
from octarm.arm.modes import longest_step
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.checks.rod_study import installed, peer
from octarm.simulation.engines import ENGINES, LAGRANGE, usual_engine
from octarm.sweeps.scenarios import Examination
from octarm.sweeps.tune import Budget, Space
from octarm.sweeps.tune_cost import Rig, costs
from octarm.sweeps.workers import WorkerProcesses, cores

MODULES = {3: None, 10: None, 15: 10.0, 30: None}  # and how much faster the engine shall be
STEP = 5e-5  # physics step of all these plants [s]; that of 30 modules may be 88 us
TUNED = "afsmc"
_TIMES = 2  # that a generation is run

ELEMENTS = (10, 20)
SHEAR = {"": 1.0, " without shear": 100.0}  # times the stiffness of the section
_LONGEST = 4e-3  # step of PyElastica that is tried first [s]
_SHORTER = 0.8  # each step over the one before
_SWING = 1.0  # of a rod that is let go across gravity, which a stable step survives [s]
_DAMPING = 1.0  # of PyElastica, uniform [1/s]
_STEPS = 50  # that are timed together


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
    factory = functools.partial(make_controller, TUNED)
    budget, nominal = Budget(generations=1), octarm.nominal_parameters()
    space = Space(factory(nominal, {}), nominal.modules)
    candidates = space.turned(np.zeros((budget.population, len(space.unknowns))))
    whole = min(1.0, settings.seconds)
    examination = Examination(begin=whole, duration=3.0 * whole)

    def evaluation(engine: str, workers: WorkerProcesses | None = None) -> Callable[[], object]:
        return lambda: costs([examination], factory, candidates, rig=Rig(engine), workers=workers)

    compiling = Examination(begin=1e-3, duration=2e-3)
    costs([compiling], factory, candidates, rig=Rig(LAGRANGE))
    with WorkerProcesses(cores()) as workers:
        costs([compiling], factory, candidates, rig=Rig(LAGRANGE), workers=workers)
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


def peers(settings: Settings) -> list[Row]:
    """A step of a rod, and the time that a second of computation simulates."""
    if not installed():
        raise LeftOut("peers", "PyElastica")
    rod, rows = Rod(), list[Row]()
    for n in ELEMENTS:
        arm = arm_from_rod(rod, n)
        own = float(longest_step(arm, equilibrium(arm)))
        model = build_slim_model(arm)
        paths: list[tuple[str, Callable[[], object], float, int]] = [
            (f"PyElastica{word}, N = {n}", *stepping(rod, n, shear), _STEPS)
            for word, shear in SHEAR.items()
        ]
        paths += [
            (f"mujoco, N = {n}, alone", physics_step(model, 1), own, 1),
            (f"mujoco, N = {n}, batch", physics_step(model, settings.arms), own, settings.arms),
        ]
        if usual_engine() == LAGRANGE:
            many = analytic_step(arm, settings.arms)
            paths.append((f"lagrange, N = {n}, batch", many, own, settings.arms))
        best = fastest([call for _, call, _, _ in paths], settings.seconds)
        for (name, _, step, count), taken in zip(paths, best, strict=True):
            cost = taken / count
            rows += [
                Row(f"{name}, step of {1e6 * step:.0f} us", 1e6 * cost, "us"),
                Row(f"{name}, arm-seconds/s", step / cost, "1"),
            ]
    return rows


def stepping(rod: Rod, elements: int, shear: float) -> tuple[Callable[[], object], float]:
    """Some steps of PyElastica's rod, and the longest that it survives of those tried [s]."""
    step = _LONGEST
    while not _survives(rod, elements, shear, step):
        step *= _SHORTER
    _, advance = peer(rod, elements, step, shear=shear, damping=_DAMPING)

    def turn() -> None:
        for _ in range(_STEPS):
            advance()

    return turn, step


def _survives(rod: Rod, elements: int, shear: float, step: float) -> bool:
    tip, advance = peer(rod, elements, step, shear=shear, damping=_DAMPING)
    with np.errstate(all="ignore"):
        for _ in range(math.ceil(_SWING / step)):
            advance()
            if not np.linalg.norm(tip()) < 2.0 * rod.length:
                return False
    return True
