"""Others' programs on the same arm: PyElastica's Cosserat rod beside chains of as many modules.

Every program takes the longest step at which it is stable on the default rod, so that the time that
it simulates in a second compares them. PyElastica's rod moves in space and shears; with a hundred
times the shear stiffness it is the rod of octarm's chains, which do not shear. Its damping is
uniform and sets the step no limit; the dampers along the springs of the chains are what limits the
step of the finer ones. PyElastica steps one rod; octarm steps one arm alone, or an arm of a batch,
on one core.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable

import numpy as np

from benchmarks.controller_step import physics_step
from benchmarks.engines import analytic_step
from benchmarks.figures import LeftOut, Row, Settings, fastest
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import build_slim_model
from octarm.arm.modes import longest_step
from octarm.arm.rod import Rod, arm_from_rod
from octarm.checks.rod_motion import cosserat_rod, installed
from octarm.simulation.engines import LAGRANGE, usual_engine

ELEMENTS = (10, 20)
SHEAR = {"": 1.0, " without shear": 100.0}  # times the stiffness of the section
_LONGEST = 4e-3  # step of PyElastica that is tried first [s]
_SHORTER = 0.8  # each step over the one before
_SWING = 1.0  # of a rod that is let go across gravity, which a stable step survives [s]
_STEPS = 50  # that are timed together


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
    while not _survives(*_simulation(rod, elements, shear, step), step, rod.length):
        step *= _SHORTER
    advance, _ = _simulation(rod, elements, shear, step)

    def turn() -> None:
        for _ in range(_STEPS):
            advance()

    return turn, step


def _survives(
    advance: Callable[[], object], tip: Callable[[], np.ndarray], step: float, length: float
) -> bool:
    with np.errstate(all="ignore"):
        for _ in range(math.ceil(_SWING / step)):
            advance()
            if not np.linalg.norm(tip()) < 2.0 * length:
                return False
    return True


def _simulation(
    rod: Rod, elements: int, shear: float, step: float
) -> tuple[Callable[[], object], Callable[[], np.ndarray]]:
    """A step of PyElastica's rod, clamped, let go across gravity; and where its tip is [m]."""
    ea = importlib.import_module("elastica")

    class Simulation(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
        """A rod with its clamp, its weight and its damping."""

    body, simulation = cosserat_rod(rod, elements, shear), Simulation()
    simulation.append(body)
    simulation.constrain(body).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    weight = np.array([0.0, -rod.gravity, 0.0])
    simulation.add_forcing_to(body).using(ea.GravityForces, acc_gravity=weight)
    simulation.dampen(body).using(
        ea.AnalyticalLinearDamper, uniform_damping_constant=1.0, time_step=step
    )
    simulation.finalize()
    stepper, t = ea.PositionVerlet(), 0.0

    def advance() -> None:
        nonlocal t
        t = stepper.step(simulation, t, step)

    return advance, lambda: body.position_collection[:, -1]
