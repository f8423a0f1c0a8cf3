"""Statics, modes and motions of chains of modules, which are compared with the rod they stand for.

`halves_tip` is the statics of a third layout, which no arm has, with a hinge in the middle of each
module. Module i leads from there half along each plate, so that one coordinate drives two slides:

    p_i = p_(i-1) + (s_i / 2) (u(phi_(i-1)) + u(phi_i))

It is the trapezoidal rule on the rod's p' = (1 + eps) u(phi), and stretches up to the tip. So it is
of second order under every static load, and exact for weight along the rod.

Motions are those of chains and rods that are let go: straight, at rest and undamped, under their
weight across. An undamped rod forgets nothing, so that every difference between two models of it
adds up.

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
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import eigh

from octarm.arm import lagrange
from octarm.arm.kinematics import jacobian, last_axis, positions, tip_force
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.disturbances.plant import GravityTilt
from octarm.errors import OctarmError
from octarm.simulation.engines import usual_engine
from octarm.simulation.environment import load

_STAGES = 10  # in which a load is put on
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


def static_tip(p: ArmParameters, end_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Tip of a chain under dead loads: x, y and the angle there, shape (3,) [m], [m], [rad].

    Loads are a force on the tip, shape (2,) [N], and an acceleration of the masses, shape (2,)
    [m/s^2]; the chain's own gravity does not count. See `lagrange.newton` for errors.
    """
    n, springs, b = p.modules, lagrange.stiffness_matrix(p), p.entries.tip_length
    rest = np.concatenate([p.rest_length, np.zeros(n)])
    fx, fy = map(float, end_force)

    def balance(q: np.ndarray, share: float) -> np.ndarray:
        weight = np.einsum("b,...bxi,x->...i", p.mass, jacobian(q), gravity)
        return (q - rest) @ springs - share * (weight + tip_force(q, fx, fy, b))

    q = _loaded(balance, rest)
    end = positions(q)[-1] + p.tip_length * np.array(last_axis(q))
    return np.append(end, np.sum(q[n:]))


def _loaded(balance: Callable[[np.ndarray, float], np.ndarray], rest: np.ndarray) -> np.ndarray:
    """Where the springs less a share of the loads balance, for the share 1, from rest.

    By Newton's method; slopes are imaginary parts at complex steps, exact to rounding.
    """
    q, steps = rest, 1e-30j * np.eye(len(rest))
    for share in np.arange(1, _STAGES + 1) / _STAGES:
        q = lagrange.newton(
            lambda q, f=share: (balance(q, f), np.imag(balance(q + steps, f)).T / 1e-30), q, 1e-13
        )
    return q


def frequencies(p: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Bending and axial frequencies of the straight chain without weight, of shape (N,) each [Hz].

    Raises OctarmError if the columns of a module differ, so that bending and stretching couple.
    """
    n = p.modules
    if not np.array_equal(p.stiffness[0], p.stiffness[1]):
        raise OctarmError("the modes of a rod need modules whose two columns have one stiffness")
    q = np.concatenate([p.rest_length, np.zeros(n)])
    inertia, stiffness = lagrange.mass_matrix(p, q), lagrange.stiffness_matrix(p)
    kinds = (slice(n, None), slice(n))
    squares = [eigh(stiffness[k, k], inertia[k, k], eigvals_only=True) for k in kinds]
    bending, axial = (np.sqrt(square) / (2.0 * np.pi) for square in squares)
    return bending, axial


def tip_compliance(p: ArmParameters) -> float:
    """Deflection of the tip of the straight chain by a small force across it [m/N].

    By the slope of the springs' forces: y = J^T K^-1 J for the generalised force J of 1 N.
    """
    q = np.concatenate([p.rest_length, np.zeros(p.modules)])
    force = tip_force(q, 0.0, 1.0, p.entries.tip_length)
    return float(force @ np.linalg.solve(lagrange.stiffness_matrix(p), force))


def halves_tip(rod: Rod, modules: int, end_force: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """`static_tip` of a rod cut into N modules with a hinge in the middle of each, shape (3,).

    Each end of a module has half the mass of the modules beside it.
    """
    p, h = arm_from_rod(rod, modules), rod.length / modules
    axial, bending = np.split(np.diag(lagrange.stiffness_matrix(p)), 2)
    loads = 0.5 * (p.mass + np.append(p.mass[1:], 0.0))[:, None] * gravity
    loads[-1] += end_force
    carried = np.cumsum(loads[::-1], axis=0)[::-1]

    def balance(x: np.ndarray, share: float) -> np.ndarray:
        """Springs less loads by x = [s_1 .. s_N, phi_1 .. phi_N]."""
        s, phi = x[..., :modules], np.insert(x[..., modules:], 0, 0.0, axis=-1)
        cos, sin = np.cos(phi), np.sin(phi)
        fx, fy = 0.5 * share * carried.T
        along = fx * (cos[..., :-1] + cos[..., 1:]) + fy * (sin[..., :-1] + sin[..., 1:])
        across = fy * cos[..., 1:] - fx * sin[..., 1:]  # along the plate that ends the module
        before = fy * cos[..., :-1] - fx * sin[..., :-1]
        turn = np.diff(phi) * bending
        couples = turn - across * s
        couples[..., :-1] -= turn[..., 1:] + (before * s)[..., 1:]
        return np.concatenate([axial * (s - h) - along, couples], axis=-1)

    x = _loaded(balance, np.concatenate([np.full(modules, h), np.zeros(modules)]))
    phi = np.append(0.0, x[modules:])
    steps = [0.5 * x[:modules] * (f(phi[1:]) + f(phi[:-1])) for f in (np.cos, np.sin)]
    return np.array([np.sum(steps[0]), np.sum(steps[1]), phi[-1]])


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
    step = _PEER_STEP / elements
    tip, advance = peer(rod, elements, step, shear=_SHEAR)
    tips = np.empty((SAMPLES + 1, 2))
    tips[0] = tip()[:2]
    for row in tips[1:]:
        for _ in range(round(DURATION / SAMPLES / step)):
            advance()
        row[:] = tip()[:2]
    return tips


def peer(
    rod: Rod, elements: int, step: float, *, shear: float, damping: float | None = None
) -> tuple[Callable[[], np.ndarray], Callable[[], None]]:
    """PyElastica's rod, clamped, let go across gravity: where its tip is, and a step of it [s].

    The tip has shape (3,) [m]. The shear stiffness is a multiple of that of `cosserat_rod`; there
    may be a uniform damping [1/s].
    """
    ea = importlib.import_module("elastica")

    class Simulation(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
        """A rod with its clamp, its weight and its damping."""

    body, simulation = cosserat_rod(rod, elements, shear), Simulation()
    simulation.append(body)
    simulation.constrain(body).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    weight = np.array([0.0, rod.gravity, 0.0])
    simulation.add_forcing_to(body).using(ea.GravityForces, acc_gravity=weight)
    if damping is not None:
        simulation.dampen(body).using(
            ea.AnalyticalLinearDamper, uniform_damping_constant=damping, time_step=step
        )
    simulation.finalize()
    stepper, t = ea.PositionVerlet(), 0.0

    def advance() -> None:
        nonlocal t
        t = stepper.step(simulation, t, step)

    return lambda: body.position_collection[:, -1], advance


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
