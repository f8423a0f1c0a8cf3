"""The arm under forces: the orders at which MuJoCo's integrators and the loop's physics converge.

The inputs are constant, or sines that are sampled and held. The analytic reference has the same
held inputs, so that what is seen is the integration and not the hold. Under the paper's F_coeff,
the generalised force of held inputs still changes with q, at every stage of a step.

Disturbances act through the physics of the loop. A payload is a part of the model. A disturbing
force is held over a physics step: at the q which the velocities predict for its middle, so that it
is of second order where it depends on q, and with the value at the start if it is a sine, so that
it is of first order.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from octarm.arm import lagrange
from octarm.arm.actuation import GroundedActuation, InternalActuation
from octarm.arm.kinematics import tip_force
from octarm.arm.parameters import ArmParameters
from octarm.checks.free_motion import (
    FreeMotion,
    fastest_rate,
    observed_order,
    reference_motion,
)
from octarm.checks.mechanics import levers
from octarm.disturbances.forces import PulseForce, SineForce, StepForce
from octarm.disturbances.plant import Payload
from octarm.simulation.environment import load

DURATION = 0.5  # of a forced motion [s]
SAMPLES = 20  # instants at which motions are compared; inputs are held from one to the next

_KINDS = (GroundedActuation, InternalActuation)
DRIVEN = [f"{what} {kind.name}" for kind in _KINDS for what in ("constant", "sinusoidal")]
DISTURBED = ["payload", "step on the tip", "pulse on the tip", "sine on the tip"]

_SIZES = (12 / 144, -4 / 144, 14 / 120, 2 / 120, 10 / 96, -3 / 96)  # of stiffness * rest length
_FREQUENCY = 2.0 / DURATION  # of the sines [Hz]
_PULSE = range(SAMPLES // 5, 3 * SAMPLES // 5)  # samples


def inputs(p: ArmParameters) -> np.ndarray:
    """Input forces by sample for each of DRIVEN, shape (SAMPLES, 4, 2N) [N].

    On the nominal arm the constant ones are (12, -4, 14, 2, 10, -3) N.
    """
    size = np.resize(_SIZES, p.coordinates) * (p.stiffness * p.rest_length).T.ravel()
    time = DURATION / SAMPLES * np.arange(SAMPLES)[:, None]
    sines = np.sin(2.0 * np.pi * _FREQUENCY * time + np.arange(p.coordinates))
    return size * np.stack([np.ones_like(sines), sines] * len(_KINDS), axis=1)


def references(p: ArmParameters) -> np.ndarray:
    """How the arms of DRIVEN and DISTURBED move from rest, shape (SAMPLES + 1, 8, 2N) [m], [rad].

    Those of DISTURBED have the first ones' inputs besides. Solved in one, which is faster.
    """
    tau = inputs(p)
    tau = np.concatenate([tau, np.repeat(tau[:, :1], len(DISTURBED), axis=1)], axis=1)
    grounded, neighbours = GroundedActuation(p.widths), [2, 3]
    between = InternalActuation(p.widths).force(tau[:, neighbours], tau[:, neighbours])
    push, on = _push(p)
    sizes, along = push * np.eye(len(DISTURBED)), float(on == "tip-x")

    def force(sample: int, t: float, q: np.ndarray) -> np.ndarray:
        out = grounded.force(q, tau[sample])
        out[neighbours] = between[sample]
        sine = np.sin(2.0 * np.pi * _FREQUENCY * t)
        on_tip = sizes @ [0.0, 1.0, float(sample in _PULSE), sine]
        out[len(DRIVEN) :] += tip_force(
            q[len(DRIVEN) :], along * on_tip, (1.0 - along) * on_tip, p.entries.tip_length
        )
        return out

    mass = np.tile(p.mass, (tau.shape[1], 1))
    mass[len(DRIVEN), -1] *= 2.0  # the payload
    start = np.tile(lagrange.equilibrium(p), (tau.shape[1], 1))
    times = np.linspace(0.0, DURATION, SAMPLES + 1)
    arms = dataclasses.replace(p, mass=mass)
    return reference_motion(arms, start, np.zeros_like(start), force, times)


def driven(model: mujoco.MjModel, p: ArmParameters, reference: np.ndarray) -> dict[str, FreeMotion]:
    """The motions of DRIVEN, with the references of `references`, shape (SAMPLES + 1, 8, 2N)."""
    tau, still = inputs(p), np.zeros(p.coordinates)
    out: dict[str, FreeMotion] = {}
    for i, name in enumerate(DRIVEN):
        ctrl = _KINDS[i // 2](p.widths).ctrl(tau[:, i])
        out[name] = FreeMotion(model, p, still, reference[:, i], DURATION, ctrl)
    return out


def disturbed_orders(p: ArmParameters, reference: np.ndarray) -> dict[str, float]:
    """Order of convergence [1] of the loop's physics with RK4, for each of DISTURBED.

    By `observed_order`, from 0.2 of the arm's shortest time constant on, with the references of
    `references`, shape (SAMPLES + 1, 8, 2N).
    """
    hold, (push, on), only = DURATION / SAMPLES, _push(p), np.eye(len(DISTURBED))
    disturbances = [
        Payload(mass=only[0] * p.mass[-1]),
        StepForce(amplitude=only[1] * push, on=on),
        PulseForce(amplitude=only[2] * push, at=_PULSE[0] * hold, length=len(_PULSE) * hold, on=on),
        SineForce(amplitude=only[3] * push, frequency=_FREQUENCY, on=on),
    ]
    tau = np.tile(inputs(p)[0, 0], (len(DISTURBED), 1))
    p = dataclasses.replace(p, input_range=(-np.inf, np.inf))  # as in the references

    def errors(count: int) -> np.ndarray:
        """The largest of each arm with so many steps a sample, shape (4,) [m]."""
        environment = load(
            parameters=p,
            disturbances=disturbances,
            batch=len(DISTURBED),
            timestep=hold / count,
            control_period=hold,
        )
        environment.reset()
        worst = np.zeros(len(DISTURBED))
        for right in reference[1:, len(DRIVEN) :]:
            environment.step(tau)
            off = np.abs(environment.physics.q() - right) * levers(p)
            worst = np.maximum(worst, np.max(off, axis=-1))
        return worst

    orders = observed_order(errors, 8 * int(np.ceil(hold * fastest_rate(p) / 1.6)))
    return dict(zip(DISTURBED, orders.tolist(), strict=True))


def _push(p: ArmParameters) -> tuple[float, str]:
    """The force on the tip [N], and its direction; one module does not move sideways.

    It is no more than what bends an arm a little that is soft in bending alone.
    """
    bending = np.diagonal(lagrange.stiffness_matrix(p))[p.modules :]
    size = 0.04 * float(np.mean(p.stiffness * p.rest_length))
    length = float(np.sum(p.rest_length) + p.tip_length)
    size = min(size, 0.3 * float(np.mean(bending)) / length)
    return size, "tip-y" if p.modules > 1 else "tip-x"
