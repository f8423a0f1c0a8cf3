"""Chains and rods that are let go: straight, at rest and undamped, under their weight across.

An undamped rod forgets nothing, so that every difference between two models of it adds up.
"""

from __future__ import annotations

import dataclasses
import math

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
