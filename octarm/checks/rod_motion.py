"""Chains and rods that are let go: straight, at rest and undamped, under their weight across.

An undamped rod forgets nothing, so that every difference between two models of it adds up.

PyElastica's Cosserat rod differs from the rod of the chains in three ways, each of which is met:

- It shears. Its shear stiffness is made a hundred times as large, which leaves .03 % of L.
- Its section shrinks where the rod is stretched, which softens it. The rod is made slim (16 times
  the axial stiffness), so that it hardly stretches.
- Its clamp fixes the direction of the whole first element. So n elements have hinges at h, 2h, ..
  and a last mass of half an element: the chain in the paper's layout, with the last mass halved, is
  the same discretisation. Both are of first order; in 1/n, PyElastica is extrapolated.
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import math
from typing import Any

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.disturbances.plant import GravityTilt
from octarm.simulation.engines import usual_engine
from octarm.simulation.environment import load

DURATION, SAMPLES = 1.0, 200
FIRST = 60  # samples of the first .3 s
_STEP = 1e-4  # [s]; the motion of 100 modules differs by 1e-7 of its length from that of half of it
_MOST = 100  # modules of the chain from which the converged motion is extrapolated

ELEMENTS = (10, 20, 40)
MISSING = (
    "PyElastica is not installed, so that nothing is compared with it: pip install 'octarm[peers]'"
)
_SHEAR = 100.0  # times the stiffness of the section
_PEER_STEP = 5e-4  # of one element [s]; that of n is an n-th of it


def released(p: ArmParameters) -> np.ndarray:
    """The tip of an undamped chain let go, x and y in the base frame, shape (SAMPLES + 1, 2) [m].

    By RK4, on the engine `lagrange` where it is installed.
    """
    arm = dataclasses.replace(p, damping=np.zeros_like(p.damping))
    across = GravityTilt(angle=0.5 * math.pi)
    environment = load(parameters=arm, disturbances=[across], timestep=_STEP, engine=usual_engine())
    environment.reset()
    physics = environment.physics
    bends = np.zeros(p.modules)
    physics.set_motion(np.concatenate([p.rest_length, bends]), np.zeros(p.coordinates))
    tips = np.empty((SAMPLES + 1, 2))
    tips[0] = np.sum(p.rest_length) + p.tip_length, 0.0
    for tip in tips[1:]:
        physics.step(round(DURATION / SAMPLES / _STEP))
        y, _, z = physics.tip_position()
        tip[:] = -z, y
    return tips


def converged(rod: Rod) -> np.ndarray:
    """The tip of the undamped rod let go, shape (SAMPLES + 1, 2) [m].

    From centred chains, whose errors quarter with twice the modules (Richardson's extrapolation).
    """
    half, whole = (released(arm_from_rod(rod, n, "centred")) for n in (_MOST // 2, _MOST))
    return (4.0 * whole - half) / 3.0


def distance(rod: Rod, one: np.ndarray, other: np.ndarray) -> float:
    """The largest distance of two tips, shapes (T, 2) [m], as a share of the rod's length [1]."""
    return float(np.max(np.linalg.norm(one - other, axis=-1))) / rod.length


def installed() -> bool:
    """Whether PyElastica is installed."""
    return importlib.util.find_spec("elastica") is not None


def slim_rod() -> Rod:
    """The default rod with a sixteenth of its section and the same bending stiffness.

    Its rho I is that of a round section, rho A EI / EA.
    """
    rod = Rod(EA=3840.0)
    density, stretch, bend = _at_base(rod)
    return dataclasses.replace(rod, rotary_inertia=density * (bend / stretch))


def like(rod: Rod, elements: int) -> ArmParameters:
    """The chain of the same discretisation as PyElastica's rod of so many elements."""
    p = arm_from_rod(rod, elements)
    mass = p.mass.copy()
    mass[-1] *= 0.5
    return dataclasses.replace(p, mass=mass)


def peer_released(rod: Rod, elements: int) -> np.ndarray:
    """The tip of PyElastica's rod let go, x and y in the base frame, shape (SAMPLES + 1, 2) [m]."""
    ea = importlib.import_module("elastica")

    class Simulation(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
        """A rod with its clamp and its weight."""

    body, simulation = cosserat_rod(rod, elements, _SHEAR), Simulation()
    simulation.append(body)
    simulation.constrain(body).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    weight = np.array([0.0, rod.gravity, 0.0])
    simulation.add_forcing_to(body).using(ea.GravityForces, acc_gravity=weight)
    simulation.finalize()
    stepper, t, step = ea.PositionVerlet(), 0.0, _PEER_STEP / elements
    tips = np.empty((SAMPLES + 1, 2))
    tips[0] = body.position_collection[:2, -1]
    for tip in tips[1:]:
        for _ in range(round(DURATION / SAMPLES / step)):
            t = stepper.step(simulation, t, step)
        tip[:] = body.position_collection[:2, -1]
    return tips


def cosserat_rod(rod: Rod, elements: int, shear: float = 1.0) -> Any:
    """PyElastica's rod along x, with a multiple of the shear stiffness.

    Its section is round, of a radius r with EI = EA r^2 / 4; rho I follows as rho A r^2 / 4, which
    is that of the default rod. Properties at the base hold all along.
    """
    density, stretch, bend = _at_base(rod)
    radius = 2.0 * math.sqrt(bend / stretch)
    section = math.pi * radius**2
    x, _, z = np.eye(3)
    body = importlib.import_module("elastica").CosseratRod.straight_rod(
        elements, 0.0 * x, x, z, rod.length, radius, density / section,
        youngs_modulus=stretch / section,
    )  # fmt: skip
    body.shear_matrix[:2] *= shear
    return body


def _at_base(rod: Rod) -> list[float]:
    """Density, EA and EI at the base [kg/m], [N], [N m^2]."""
    return [float(rod.at(profile)(0.0)) for profile in (rod.density, rod.EA, rod.EI)]
