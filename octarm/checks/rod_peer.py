"""PyElastica's Cosserat rod beside chains of modules, in the same undamped release.

It differs from the rod of the chains in three ways, each of which is met here:

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
from octarm.checks.rod_motion import DURATION, SAMPLES

ELEMENTS = (10, 20, 40)
MISSING = (
    "PyElastica is not installed, so that nothing is compared with it: pip install 'octarm[peers]'"
)
_SHEAR = 100.0  # times the stiffness of the section
_STEP = 5e-4  # of one element [s]; that of n is an n-th of it


def installed() -> bool:
    """Whether PyElastica is installed."""
    return importlib.util.find_spec("elastica") is not None


def slim_rod() -> Rod:
    """The default rod with a sixteenth of its section and the same bending stiffness.

    Its rho I is that of a round section, rho A EI / EA.
    """
    rod = Rod(EA=3840.0)
    return dataclasses.replace(rod, rotary_inertia=_first(rod.density) * _square(rod))


def like(rod: Rod, elements: int) -> ArmParameters:
    """The chain of the same discretisation as PyElastica's rod of so many elements."""
    p = arm_from_rod(rod, elements)
    mass = p.mass.copy()
    mass[-1] *= 0.5
    return dataclasses.replace(p, mass=mass)


def released(rod: Rod, elements: int) -> np.ndarray:
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
    stepper, t, step = ea.PositionVerlet(), 0.0, _STEP / elements
    tips = np.empty((SAMPLES + 1, 2))
    tips[0] = body.position_collection[:2, -1]
    for tip in tips[1:]:
        for _ in range(round(DURATION / SAMPLES / step)):
            t = stepper.step(simulation, t, step)
        tip[:] = body.position_collection[:2, -1]
    return tips


def extrapolated(coarse: np.ndarray, middle: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """The tip of endlessly many elements, from n, 2n and 4n, each of shape (T, 2) [m].

    It leaves out their errors of the orders 1/n and 1/n^2.
    """
    return (coarse - 6.0 * middle + 8.0 * fine) / 3.0


def cosserat_rod(rod: Rod, elements: int, shear: float = 1.0) -> Any:
    """PyElastica's rod along x, with a multiple of the shear stiffness.

    Its section is round, of a radius r with EI = EA r^2 / 4; rho I follows as rho A r^2 / 4, which
    is that of the default rod. Properties at the base hold all along.
    """
    radius = 2.0 * math.sqrt(_square(rod))
    section = math.pi * radius**2
    x, _, z = np.eye(3)
    body = importlib.import_module("elastica").CosseratRod.straight_rod(
        elements, 0.0 * x, x, z, rod.length, radius, _first(rod.density) / section,
        youngs_modulus=_first(rod.EA) / section,
    )  # fmt: skip
    body.shear_matrix[:2] *= shear
    return body


def _square(rod: Rod) -> float:
    """EI / EA, the square of the radius of gyration of the section [m^2]."""
    return _first(rod.EI) / _first(rod.EA)


def _first(profile: float | tuple[float, float]) -> float:
    return float(np.ravel(profile)[0])
