"""The arm let go: MuJoCo's integrators against an accurate solution of the analytic equations.

Also what follows from motion alone: the energy kept, and the frequencies of small oscillations.
Time is a count of steps, so that every run ends at the same instant whatever its timestep.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.integrate import solve_ivp

from octarm.arm import lagrange
from octarm.arm.mjcf import paper_order
from octarm.arm.modes import modes, rates
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


class FreeMotion(NamedTuple):
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
        """Order of convergence of an integrator [1]; see the function of this name.

        The longer timestep is a tenth of the arm's shortest time constant, which lets the leading
        term dominate.
        """
        fastest, whole = fastest_rate(self.parameters), 8 * (len(self.reference) - 1)
        steps = whole * int(np.ceil(self.duration * fastest / 0.1 / whole))
        return float(observed_order(lambda n: np.array([self.error(integrator, n)]), steps)[0])


def observed_order(errors: Callable[[int], np.ndarray], steps: int) -> np.ndarray:
    """Orders of convergence by the errors, shape (k,), at `steps` and at twice as many, shape (k,).

    There are fewer steps, a half up to three times, where the first one's timestep is so short, by
    much damping, that the motion which matters is followed to rounding.
    """
    rough, fine = errors(steps), errors(2 * steps)
    for _ in range(3):
        if not rough[0] < 1e-9:
            break
        steps //= 2
        rough, fine = errors(steps), rough
    return np.log2(rough / fine)


def fastest_rate(p: ArmParameters) -> float:
    """The largest absolute eigenvalue of the arm's motion about its equilibrium [1/s]."""
    return float(np.max(np.abs(rates(p, lagrange.equilibrium(p)))))


def undamped_frequencies(p: ArmParameters) -> np.ndarray:
    """Those about the equilibrium, ascending, shape (2N,) [Hz]; NaN for an unstable mode."""
    return np.array([mode.frequency for mode in modes(p, lagrange.equilibrium(p))])


def measured_frequencies(model: mujoco.MjModel, p: ArmParameters) -> np.ndarray:
    """Frequencies at which MuJoCo's arm oscillates in its undamped modes, shape (2N,) [Hz].

    Each mode is let go 1 um from the equilibrium and followed for ten periods of 200 steps or more,
    of which RK4 misjudges the length by 8e-9. The steps are also short enough for the fastest mode
    of the arm, or rounding would grow in it while a slow one is followed. A sampled sine has
    x[k+1] + x[k-1] = 2 cos(w h) x[k], so that w is measured without being presupposed.
    """
    model, still = undamped(model), lagrange.equilibrium(p)
    inertia, fastest = lagrange.mass_matrix(p, still), np.nanmax(undamped_frequencies(p))
    measured: list[float] = []
    for mode in modes(p, still):
        if np.isnan(mode.frequency):
            measured.append(np.nan)
            continue
        steps = max(200, int(np.ceil(np.pi * fastest / mode.frequency)))  # RK4 bears 2.83 a step
        h = model.opt.timestep = 1.0 / mode.frequency / steps
        start = 1e-6 * mode.shape / np.max(np.abs(mode.shape) * levers(p))
        q, _ = simulate(model, still + start, np.zeros_like(still), 10 * steps)
        x = (q - still) @ inertia @ mode.shape
        cosine = np.sum(x[1:-1] * (x[2:] + x[:-2])) / (2.0 * np.sum(x[1:-1] ** 2))
        measured.append(float(np.arccos(cosine)) / (2.0 * np.pi * h))
    return np.array(measured)


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
