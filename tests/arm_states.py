"""Random instants, nominal models and closed loops, for the tests of the controllers."""

import dataclasses
import functools

import numpy as np

from controllers import make_controller
from octarm.arm.lagrange import equilibrium, forward_dynamics, mass_matrix
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Controller, Measurement, Motion, Reference

P = nominal_parameters()
# Random instants ask for more force than the arm has, where laws that integrate stop doing so.
UNLIMITED = dataclasses.replace(P, input_range=(-np.inf, np.inf))
REST = equilibrium(P)
UNCERTAIN = ("mass", "inertia", "stiffness", "damping")
U = 0.3  # uncertainty of the nominal models

# Controllers by name, for what is shown for these gains alone, or was measured with them.
hand_set = functools.partial(make_controller, gain_set="recommended")


def random_instant(n: int, p: ArmParameters = P, seed: int = 0) -> tuple[Measurement, Reference]:
    draw = np.random.default_rng(seed)
    scale = np.repeat([0.05, 0.5], p.modules)
    q, q_d = (equilibrium(p) + scale * draw.normal(size=(n, len(scale))) for _ in range(2))
    v, v_d, a_d = (k * scale * draw.normal(size=(n, len(scale))) for k in (10.0, 10.0, 100.0))
    return Measurement(0.3, q, v), Reference(q_d, v_d, a_d)


def energy_rate(
    arm: ArmParameters, measurement: Measurement, s: np.ndarray, a_r: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """d/dt 1/2 s^T D s of the true arm under a force, by the chain rule; D' by a complex step."""
    _, q, v = measurement
    s_dot = forward_dynamics(arm, q, v, force) - a_r
    D_dot = np.imag(mass_matrix(arm, q + 1e-30j * v)) / 1e-30
    return quadratic(s, mass_matrix(arm, q), s_dot) + 0.5 * quadratic(s, D_dot, s)


def quadratic(x: np.ndarray, matrix: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...ij,...j->...", x, matrix, y)


def random_box(p: ArmParameters, draw: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Factors of nominal models within the uncertainty U, as often at its limits as between."""
    return {
        name: 1.0
        + (0.5 if name == "stiffness" else 1.0)
        * U
        * np.clip(draw.uniform(-2.0, 2.0, (n, *getattr(p, name).shape)), -1.0, 1.0)
        for name in UNCERTAIN
    }


def simulated(
    controller: Controller,
    motion: Motion,
    duration: float,
    *,
    arm: ArmParameters = P,
    start: np.ndarray = REST,
    load: np.ndarray | float = 0.0,
    until: float = np.inf,
    limit: np.ndarray | float = np.inf,
    dt: float = 1e-3,
) -> tuple[np.ndarray, np.ndarray, list]:
    """Time, error and signals of the analytic arm, stepped by RK4.

    Args:
        controller: acts every dt.
        motion: what is wanted.
        duration: length of the run.
        arm: the true one.
        start: coordinates at first, at rest.
        load: constant generalised force beside the controller's.
        until: when the load goes.
        limit: largest force of the controller that arrives.
        dt: step.
    """
    q, v, state = start, np.zeros_like(start), controller.initial_state()
    times, errors, signals = [], [], []
    for t in dt * np.arange(round(duration / dt)):
        wanted = motion(t)
        command, state = controller(state, Measurement(t, q, v), wanted)
        times.append(t)
        errors.append(q - wanted.q)
        signals.append(command.signals)
        force, h = np.clip(command.force, -limit, limit) + (load if t < until else 0.0), 0.5 * dt
        a1 = forward_dynamics(arm, q, v, force)
        a2 = forward_dynamics(arm, q + h * v, v + h * a1, force)
        a3 = forward_dynamics(arm, q + h * v + h * h * a1, v + h * a2, force)
        a4 = forward_dynamics(arm, q + dt * v + h * dt * a2, v + dt * a3, force)
        q = q + dt * v + dt * dt / 6.0 * (a1 + a2 + a3)
        v = v + dt / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return np.array(times), np.array(errors), signals
