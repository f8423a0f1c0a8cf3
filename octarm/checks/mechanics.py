"""What MuJoCo and the analytic model say about the arm at given states, in one form for both.

`mujoco_mechanics` reads MuJoCo, state by state; `lagrange_mechanics` computes the same quantities
from eqs (1)-(5), all states at once. Neither borrows a number from the other, the map from tau to
tendon forces excepted, which belongs to the plant.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from octarm.arm import lagrange
from octarm.arm.actuation import GroundedActuation, InternalActuation
from octarm.arm.mjcf import paper_order, world_position
from octarm.arm.parameters import ArmParameters


class States(NamedTuple):
    """States at which the two models are compared.

    Attributes:
        q: generalised coordinates, shape (n, 2N) [m], [rad].
        v: generalised velocities, shape (n, 2N) [m/s], [rad/s].
        a: accelerations for the inverse dynamics, shape (n, 2N) [m/s^2], [rad/s^2].
        tau: input forces for the forward dynamics, shape (n, 2N) [N].
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray


class Mechanics(NamedTuple):
    """One model's answers at n states, in the paper's order of the coordinates.

    Attributes:
        positions: ends of the modules in the world frame, shape (n, N, 3) [m].
        inertia: D(q), shape (n, 2N, 2N) [kg], [kg m], [kg m^2].
        tendon_moments: T, generalised force per column force, shape (n, 2N, 2N) [1], [m].
        coefficients: F_coeff(q), generalised force per input, shape (n, 2N, 2N) [1], [m].
        bias: Coriolis force less gravity, shape (n, 2N) [N], [N m].
        springs: force of the springs on the arm, shape (n, 2N) [N], [N m].
        dampers: force of the dampers on the arm, shape (n, 2N) [N], [N m].
        potential_force: G(q), shape (n, 2N) [N], [N m].
        actuation: generalised force of tau, shape (n, 2N) [N], [N m].
        inverse_dynamics: force D a + C v + B v + G, shape (n, 2N) [N], [N m].
        acceleration: under tau, shape (n, 2N) [m/s^2], [rad/s^2].
        kinetic: energy, shape (n, 1) [J].
        potential: energy, shape (n, 1) [J].
    """

    positions: np.ndarray
    inertia: np.ndarray
    tendon_moments: np.ndarray
    coefficients: np.ndarray
    bias: np.ndarray
    springs: np.ndarray
    dampers: np.ndarray
    potential_force: np.ndarray
    actuation: np.ndarray
    inverse_dynamics: np.ndarray
    acceleration: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray


def random_states(p: ArmParameters, count: int, rng: np.random.Generator) -> States:
    """Uniform states far beyond what the arm does under control.

    Modules are 0.4 to 2 times their rest length and bent by up to 1.5 rad.
    """
    n = p.modules

    def within(slide: float, hinge: float) -> np.ndarray:
        return rng.uniform(-1.0, 1.0, (count, 2 * n)) * np.repeat([slide, hinge], n)

    q = within(0.0, 1.5)
    q[:, :n] = p.rest_length * rng.uniform(0.4, 2.0, (count, n))
    return States(q=q, v=within(1.0, 6.0), a=within(50.0, 500.0), tau=within(20.0, 20.0))


def levers(p: ArmParameters) -> np.ndarray:
    """Travel of a column's end per unit of each coordinate, shape (2N,): 1, and l/2 [m].

    Angles times their lever compare with lengths, moments divided by it with forces.
    """
    return np.repeat([1.0, 0.5 * float(p.width)], p.modules)


def mujoco_mechanics(model: mujoco.MjModel, p: ArmParameters, states: States) -> Mechanics:
    """What MuJoCo says. `p` gives the input forces their meaning; MuJoCo has its own numbers."""
    model = copy.copy(model)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    tendon_forces = GroundedActuation(p.width).tendon_forces(states.q, states.tau)
    half = 0.5 * float(p.width)
    rows = [
        _mujoco_at_state(model, data, half, q, v, a, f)
        for q, v, a, f in zip(states.q, states.v, states.a, tendon_forces, strict=True)
    ]
    return Mechanics(*(np.stack(field) for field in zip(*rows, strict=True)))


def lagrange_mechanics(p: ArmParameters, states: States) -> Mechanics:
    """What the analytic model says."""
    q, v, a, tau = states
    coefficients = lagrange.force_coefficients(p, q)
    force = np.einsum("nij,nj->ni", coefficients, tau)
    rest = np.concatenate([p.rest_length, np.zeros(p.modules)])
    springs = -(q - rest) @ lagrange.stiffness_matrix(p)
    potential_force = lagrange.potential_force(p, q)
    moments = InternalActuation(p.width).force(q[0], np.eye(p.coordinates)).T
    kinetic, potential = lagrange.energy(p, q, v)
    return Mechanics(
        positions=world_position(lagrange.positions(q)),
        inertia=lagrange.mass_matrix(p, q),
        tendon_moments=np.broadcast_to(moments, coefficients.shape),
        coefficients=coefficients,
        bias=np.einsum("nij,nj->ni", lagrange.coriolis_matrix(p, q, v), v)
        + (potential_force + springs),
        springs=springs,
        dampers=-v @ lagrange.damping_matrix(p),
        potential_force=potential_force,
        actuation=force,
        inverse_dynamics=lagrange.inverse_dynamics(p, q, v, a),
        acceleration=lagrange.forward_dynamics(p, q, v, force),
        kinetic=kinetic[:, None],
        potential=potential[:, None],
    )


def relative_error(measured: np.ndarray, expected: np.ndarray) -> float:
    """Largest error relative to the largest entry at the same state [1].

    Both arrays have shape (n, ...): the states first, then axes of entries of one unit.
    """
    axes = tuple(range(1, measured.ndim))
    error = np.max(np.abs(measured - expected), axis=axes)
    size = np.maximum(np.max(np.abs(measured), axis=axes), np.max(np.abs(expected), axis=axes))
    return float(np.max(error / np.where(size > 0.0, size, 1.0)))


def _mujoco_at_state(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    half: float,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    tendon_forces: np.ndarray,
) -> Mechanics:
    qpos, dof = paper_order(model)
    data.qpos[qpos], data.qvel[:] = q, 0.0
    mujoco.mj_forward(model, data)
    at_rest = data.qfrc_bias - data.qfrc_spring

    data.qvel[dof], data.ctrl[:] = v, tendon_forces
    mujoco.mj_forward(model, data)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    acceleration = data.qacc[dof]
    data.qacc[dof] = a
    mujoco.mj_inverse(model, data)
    return Mechanics(
        positions=data.xpos[_module_bodies(model)],
        inertia=inertia[np.ix_(dof, dof)],
        tendon_moments=_actuator_moments(model, data)[:, dof].T,
        coefficients=_wrenches(model, data, half)[:, dof].T,
        bias=data.qfrc_bias[dof],
        springs=data.qfrc_spring[dof],
        dampers=data.qfrc_damper[dof],
        potential_force=at_rest[dof],
        actuation=data.qfrc_actuator[dof],
        inverse_dynamics=data.qfrc_inverse[dof],
        acceleration=acceleration,
        kinetic=data.energy[1:].copy(),
        potential=data.energy[:1].copy(),
    )


def _module_bodies(model: mujoco.MjModel) -> list[int]:
    return [model.body(f"module_{i}").id for i in range(1, model.nu // 2 + 1)]


def _actuator_moments(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Moments of the actuators, shape (nu, nv), from MuJoCo's sparse rows."""
    dense = np.empty((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return dense


def _wrenches(model: mujoco.MjModel, data: mujoco.MjData, half: float) -> np.ndarray:
    """Generalised forces of the paper's inputs, shape (nu, nv), one input a row.

    A unit force on the end of a module along the axis of the plate it stands on, and a couple of
    +-l/2 about the hinge; the world takes the reaction of both.
    """
    rows = np.zeros((model.nu, model.nv))
    for i, body in enumerate(_module_bodies(model)):
        axis = data.xmat[model.body_parentid[body]].reshape(3, 3)[:, 0]
        hinge = data.xaxis[model.joint(f"theta_{i + 1}").id]
        for row, side in ((rows[2 * i], 1.0), (rows[2 * i + 1], -1.0)):
            couple = side * half * hinge
            mujoco.mj_applyFT(model, data, axis, couple, data.xpos[body], body, row)
    return rows
