"""What MuJoCo and the analytic model say about the arm at given states, in one form for both.

`mujoco_mechanics` reads MuJoCo, state by state; `lagrange_mechanics` computes the same quantities
from eqs (1)-(5), all states at once. Neither borrows a number from the other.

At n states, in the paper's order of the coordinates, a model answers with these arrays:

- `positions`: ends of the modules in the world frame, shape (n, N, 3) [m];
- `inertia`: D(q), shape (n, 2N, 2N) [kg], [kg m], [kg m^2];
- `tendon_moments`: T, generalised force per column force, shape (n, 2N, 2N) [1], [m];
- `coefficients`: F_coeff(q), generalised force per input, shape (n, 2N, 2N) [1], [m];
- `bias`: Coriolis force less gravity; `springs` and `dampers`: their forces on the arm;
  `potential_force`: G(q); `actuation`: generalised force of tau; `inverse_dynamics`: force
  D a + C v + B v + G, each of shape (n, 2N) [N], [N m];
- `acceleration`: under tau, shape (n, 2N) [m/s^2], [rad/s^2];
- `kinetic` and `potential`: energies, shape (n, 1) [J].
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
    return np.concatenate([np.ones(p.modules), 0.5 * p.widths])


def relative_error(measured: np.ndarray, expected: np.ndarray) -> float:
    """Largest error relative to the largest entry at the same state [1].

    Both arrays have shape (n, ...): the states first, then axes of entries of one unit.
    """
    axes = tuple(range(1, measured.ndim))
    error = np.max(np.abs(measured - expected), axis=axes)
    size = np.maximum(np.max(np.abs(measured), axis=axes), np.max(np.abs(expected), axis=axes))
    return float(np.max(error / np.where(size > 0.0, size, 1.0)))


def lagrange_mechanics(p: ArmParameters, states: States) -> dict[str, np.ndarray]:
    """What the analytic model says; the module's docstring has the shapes (n, ...)."""
    q, v, a, tau = states
    coefficients = lagrange.force_coefficients(p, q)
    force = np.einsum("nij,nj->ni", coefficients, tau)
    rest = np.concatenate([p.rest_length, p.rest_angle])
    springs = -(q - rest) @ lagrange.stiffness_matrix(p)
    potential_force = lagrange.potential_force(p, q)
    moments = InternalActuation(p.widths).force(q[0], np.eye(p.coordinates)).T
    coriolis = np.einsum("nij,nj->ni", lagrange.coriolis_matrix(p, q, v), v)
    kinetic, potential = lagrange.energy(p, q, v)
    return {
        "positions": world_position(lagrange.positions(q)),
        "inertia": lagrange.mass_matrix(p, q),
        "tendon_moments": np.broadcast_to(moments, coefficients.shape),
        "coefficients": coefficients,
        "bias": coriolis + (potential_force + springs),
        "springs": springs,
        "dampers": -v @ lagrange.damping_matrix(p),
        "potential_force": potential_force,
        "actuation": force,
        "inverse_dynamics": lagrange.inverse_dynamics(p, q, v, a),
        "acceleration": lagrange.forward_dynamics(p, q, v, force),
        "kinetic": kinetic[:, None],
        "potential": potential[:, None],
    }


def mujoco_mechanics(
    model: mujoco.MjModel, p: ArmParameters, states: States
) -> dict[str, np.ndarray]:
    """What MuJoCo says; the module's docstring has the shapes (n, ...).

    Of `p` the width alone is used, for the levers of F_coeff; MuJoCo has its own numbers.
    """
    model = copy.copy(model)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    states = states._replace(tau=GroundedActuation(p.widths).ctrl(states.tau))
    half_width = 0.5 * p.widths
    rows = [_at_state(model, data, half_width, *state) for state in zip(*states, strict=True)]
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def _at_state(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    half_width: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    ctrl: np.ndarray,
) -> dict[str, np.ndarray]:
    qpos, dof = paper_order(model)
    bodies = [model.body(f"module_{i}").id for i in range(1, model.nq // 2 + 1)]
    data.qpos[qpos], data.qvel[:] = q, 0.0
    mujoco.mj_forward(model, data)
    at_rest = data.qfrc_bias - data.qfrc_spring

    data.qvel[dof], data.ctrl[:] = v, ctrl
    mujoco.mj_forward(model, data)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    moments = np.empty((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    acceleration = data.qacc[dof]
    data.qacc[dof] = a
    mujoco.mj_inverse(model, data)
    return {
        "positions": data.xpos[bodies],
        "inertia": inertia[np.ix_(dof, dof)],
        "tendon_moments": moments[: model.nq, dof].T,
        "coefficients": _wrenches(model, data, bodies, half_width)[:, dof].T,
        "bias": data.qfrc_bias[dof],
        "springs": data.qfrc_spring[dof],
        "dampers": data.qfrc_damper[dof],
        "potential_force": at_rest[dof],
        "actuation": data.qfrc_actuator[dof],
        "inverse_dynamics": data.qfrc_inverse[dof],
        "acceleration": acceleration,
        "kinetic": data.energy[1:].copy(),
        "potential": data.energy[:1].copy(),
    }


def _wrenches(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], half_width: np.ndarray
) -> np.ndarray:
    """Generalised forces of the paper's inputs, shape (2N, nv), one input a row.

    A unit force on the end of a module along the axis of the plate it stands on, and a couple of
    +-l/2 about the hinge; the world takes the reaction of both.
    """
    rows = np.zeros((model.nq, model.nv))
    for i, body in enumerate(bodies):
        axis = data.xmat[model.body_parentid[body]].reshape(3, 3)[:, 0]
        hinge = data.xaxis[model.joint(f"theta_{i + 1}").id]
        for row, side in ((rows[2 * i], 1.0), (rows[2 * i + 1], -1.0)):
            couple = side * half_width[i] * hinge
            mujoco.mj_applyFT(model, data, axis, couple, data.xpos[body], body, row)
    return rows
