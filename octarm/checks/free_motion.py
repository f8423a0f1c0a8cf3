"""The arm let go: MuJoCo's integrators against an accurate solution of the analytic equations.

Also what follows from motion alone: the energy balance, and the frequencies of small oscillations.
Time is a count of steps, so that every run ends at the same instant whatever its timestep.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.integrate import simpson, solve_ivp
from scipy.linalg import eigh

from octarm.arm import lagrange
from octarm.arm.actuation import InternalActuation
from octarm.arm.mjcf import paper_order
from octarm.arm.modes import state_matrix
from octarm.arm.parameters import ArmParameters
from octarm.checks.mechanics import levers

DURATION = 2.0  # of a free motion [s]
SAMPLES = 50  # instants at which motions are compared


def initial_motion(p: ArmParameters, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A lively start near the equilibrium, q and v of shape (2N,) [m], [rad], [m/s], [rad/s]."""
    n = p.modules
    q, v = lagrange.equilibrium(p), np.repeat([0.3, 3.0], n) * rng.uniform(-1.0, 1.0, 2 * n)
    q[:n] += p.rest_length * rng.uniform(-0.2, 0.2, n)
    q[n:] += rng.uniform(-0.6, 0.6, n)
    return q, v


def simulate(
    model: mujoco.MjModel,
    q: np.ndarray,
    v: np.ndarray,
    samples: int,
    stride: int = 1,
    ctrl: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """q and v at the start and after every `stride` steps of MuJoCo, shapes (samples + 1, 2N).

    It starts at q, v, shape (2N,); `ctrl` is that of the model, constant or held from one sample to
    the next, shape (4N - 2,) or (samples, 4N - 2) [N].
    """
    qpos, dof = paper_order(model)
    data = mujoco.MjData(model)
    data.qpos[qpos], data.qvel[dof] = q, v
    held = np.broadcast_to(ctrl, (samples, model.nu))
    motion = np.empty((2, samples + 1, q.size))
    motion[:, 0] = q, v
    for k in range(1, samples + 1):
        data.ctrl[:] = held[k - 1]
        mujoco.mj_step(model, data, stride)
        motion[:, k] = data.qpos[qpos], data.qvel[dof]
    return motion[0], motion[1]


# The generalised force, shape (..., 2N) [N], [N m], of the number of the sample before, of the time
# [s] and of q, shape (..., 2N) [m], [rad].
ForceOf = Callable[[int, float, np.ndarray], np.ndarray]


def reference_motion(
    p: ArmParameters,
    q: np.ndarray,
    v: np.ndarray,
    force: ForceOf = lambda sample, t, q: np.zeros_like(q),
    times: np.ndarray | None = None,
) -> np.ndarray:
    """Coordinates of analytic arms from q, v on, shape (samples + 1, ..., 2N) [m], [rad].

    DOP853 at a relative tolerance of 1e-12, restarted at every sample: its interpolant is of lower
    order than its steps, and forces may jump there. Samples after a divergence are NaN. The arms
    start at q, v of shape (..., 2N); the times of the samples, shape (samples + 1,) [s], are
    SAMPLES of DURATION when not given.
    """
    times = np.linspace(0.0, DURATION, SAMPLES + 1) if times is None else times
    out = np.full((times.size, 2, *q.shape), np.nan)
    out[0] = q, v

    def slope(t: float, y: np.ndarray, sample: int) -> np.ndarray:
        if not np.max(np.abs(y)) < 1e3:  # a trial step too long, which is taken back, or divergence
            return np.full_like(y, np.nan)
        q_t, v_t = y.reshape(2, *q.shape)
        acceleration = lagrange.forward_dynamics(p, q_t, v_t, force(sample, t, q_t))
        return np.concatenate([v_t, acceleration], axis=None)

    for k, span in enumerate(itertools.pairwise(times)):
        solution = solve_ivp(
            slope, span, out[k].ravel(), method="DOP853", args=(k,), rtol=1e-12, atol=1e-13
        )
        if not solution.success:
            break
        out[k + 1] = solution.y[:, -1].reshape(2, *q.shape)
    return out[:, 0]


class Motion(NamedTuple):
    """An arm in motion, and how it moves by the analytic equations.

    Attributes:
        model: the arm in MuJoCo.
        parameters: its parameters.
        v: initial velocities, shape (2N,) [m/s], [rad/s].
        reference: the motion, from the initial coordinates on, shape (samples + 1, 2N).
        duration: of the motion [s].
        ctrl: of the model, constant or held between samples, shape () or (samples, 4N - 2) [N].
    """

    model: mujoco.MjModel
    parameters: ArmParameters
    v: np.ndarray
    reference: np.ndarray
    duration: float
    ctrl: np.ndarray | float = 0.0

    def error(self, integrator: mujoco.mjtIntegrator, steps: int) -> float:
        """Largest error of one of MuJoCo's integrators, angles at the lever l/2 [m].

        `steps` is the number of steps of the whole motion, a multiple of that of the samples.
        """
        samples = len(self.reference) - 1
        model = copy.copy(self.model)
        model.opt.integrator = int(integrator)
        model.opt.timestep = self.duration / steps
        q, _ = simulate(model, self.reference[0], self.v, samples, steps // samples, self.ctrl)
        return float(np.max(np.abs(q - self.reference) * levers(self.parameters)))

    def observed_order(self, integrator: mujoco.mjtIntegrator) -> float:
        """Order of convergence of an integrator [1].

        By the errors at two timesteps, one half the other. The longer one is a tenth of the arm's
        shortest time constant, which lets the leading term dominate; it is longer where that is so
        short, by much damping, that the motion which matters is followed to rounding.
        """
        fastest, whole = fastest_rate(self.parameters), 8 * (len(self.reference) - 1)
        steps = whole * int(np.ceil(self.duration * fastest / 0.1 / whole))
        error = self.error(integrator, steps)
        for _ in range(3):
            if not error < 1e-9:
                break
            steps //= 2
            error = self.error(integrator, steps)
        return float(np.log2(error / self.error(integrator, 2 * steps)))


def fastest_rate(p: ArmParameters) -> float:
    """The largest absolute eigenvalue of the arm's motion about its equilibrium [1/s]."""
    return float(np.max(np.abs(np.linalg.eigvals(analytic_linearisation(p)))))


def analytic_linearisation(p: ArmParameters) -> np.ndarray:
    """d(v, v')/d(q, v) at the equilibrium by D, B and the Hessian of V, shape (4N, 4N)."""
    return state_matrix(p, lagrange.equilibrium(p))


def mujoco_linearisation(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """d(v, v')/d(q, v) of MuJoCo at rest at q, shape (4N, 4N), by differences of its accelerations.

    Not by mjd_transitionFD, whose answer is that of one integrator at one timestep.
    """
    qpos, dof = paper_order(model)
    data = mujoco.MjData(model)

    def acceleration(state: np.ndarray) -> np.ndarray:
        data.qpos[qpos], data.qvel[dof] = np.split(state, 2)
        mujoco.mj_forward(model, data)
        return data.qacc[dof]

    def slopes(h: float) -> np.ndarray:
        steps = h * np.eye(2 * q.size)
        rest = np.concatenate([q, np.zeros_like(q)])
        differences = [acceleration(rest + d) - acceleration(rest - d) for d in steps]
        return np.stack(differences, axis=1) / (2.0 * h)

    richardson = (4.0 * slopes(1e-4) - slopes(2e-4)) / 3.0  # of fourth order
    return np.vstack([np.eye(*richardson.shape, k=q.size), richardson])


def undamped_modes(p: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies about the equilibrium, ascending, and modes as columns, orthonormal by D.

    They have shapes (2N,) [rad/s], NaN for an unstable mode, and (2N, 2N).
    """
    q = lagrange.equilibrium(p)
    squares, modes = eigh(lagrange.potential_hessian(p, q), lagrange.mass_matrix(p, q))
    return np.sqrt(np.where(squares > 0.0, squares, np.nan)), modes


def measured_frequencies(model: mujoco.MjModel, p: ArmParameters) -> np.ndarray:
    """Frequencies at which MuJoCo's arm oscillates in `undamped_modes(p)`, shape (2N,) [rad/s].

    Each mode is let go 1 um from the equilibrium and followed for ten periods of 200 steps or more,
    of which RK4 misjudges the length by 8e-9. The steps are also short enough for the fastest mode
    of the arm, or rounding would grow in it while a slow one is followed. A sampled sine has
    x[k+1] + x[k-1] = 2 cos(w h) x[k], so that w is measured without being presupposed.
    """
    model = undamped(model)
    still = lagrange.equilibrium(p)
    frequencies, modes = undamped_modes(p)
    weights = lagrange.mass_matrix(p, still) @ modes
    measured, fastest = np.full_like(frequencies, np.nan), np.nanmax(frequencies)
    for k in np.flatnonzero(np.isfinite(frequencies)):
        period = 2.0 * np.pi / frequencies[k]
        steps = max(200, int(np.ceil(0.5 * period * fastest)))  # RK4 bears 2.83 a step
        model.opt.timestep = period / steps
        start = 1e-6 * modes[:, k] / np.max(np.abs(modes[:, k]) * levers(p))
        q, _ = simulate(model, still + start, np.zeros_like(still), 10 * steps)
        x = (q - still) @ weights[:, k]
        cosine = np.sum(x[1:-1] * (x[2:] + x[:-2])) / (2.0 * np.sum(x[1:-1] ** 2))
        measured[k] = np.arccos(cosine) / model.opt.timestep
    return measured


def undamped(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy without dampers."""
    model = copy.copy(model)
    model.tendon_damping[:] = model.dof_damping[:] = 0.0
    return model


def energy_drift(model: mujoco.MjModel, p: ArmParameters, q: np.ndarray, v: np.ndarray) -> float:
    """Largest change of T + V without damping, relative to the largest T, over DURATION [1].

    From q, v, shape (2N,), with the model's integrator and timestep.
    """
    steps = round(DURATION / model.opt.timestep)
    kinetic, potential = lagrange.energy(p, *simulate(undamped(model), q, v, steps))
    total = kinetic + potential
    return float(np.max(np.abs(total - total[0])) / np.max(kinetic))


def energy_imbalance(
    model: mujoco.MjModel,
    p: ArmParameters,
    q: np.ndarray,
    v: np.ndarray,
    tau: np.ndarray,
    allowed: float,
) -> float:
    """T + V - (T + V)_0 - work + dissipated energy after DURATION, relative to the largest T [1].

    From q, v, shape (2N,), under constant inputs, shape (2N,) [N], between neighbouring modules:
    their generalised force is constant, so that their work is exact. Dissipation is integrated by
    Simpson's rule, whose error for a mode of rate r is (2 r h)^4 / 180 of what it dissipates; the
    model's timestep is divided until a quarter of `allowed` [1] holds it for the fastest one, which
    leaves room for rates that are 40 % above those at rest.
    """
    model = copy.copy(model)
    longest = (180.0 * allowed / 4.0) ** 0.25 / (2.0 * fastest_rate(p))
    model.opt.timestep /= np.ceil(model.opt.timestep / longest)
    steps = round(DURATION / model.opt.timestep)
    internal = InternalActuation(p.widths)
    q_t, v_t = simulate(model, q, v, steps, ctrl=internal.ctrl(tau))
    ends = [0, -1]
    kinetic, potential = lagrange.energy(p, q_t[ends], v_t[ends])
    work = (q_t[-1] - q_t[0]) @ internal.force(q, tau)
    power = np.sum(v_t * (v_t @ lagrange.damping_matrix(p)), axis=-1)
    dissipated = simpson(power, dx=model.opt.timestep)
    change = float(np.diff(kinetic + potential)[0])
    return float(abs(change - work + dissipated) / np.max(lagrange.kinetic_energy(p, q_t, v_t)))
