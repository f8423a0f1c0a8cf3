"""The arm linearised about a pose: its modes, and the longest physics step that bears them.

About a pose q0 that a constant generalised force holds, x = (q - q0, v) moves by x' = A x,

    A = [[0, 1], [-D^-1 dG/dq, -D^-1 B_c]]        all of it at q0

with the damping matrix B_c of the columns, eq (4). An eigenvalue of A is a mode: it decays, swings,
or grows, which is physics and no fault of a step.

The fastest mode of the hanging arm is a bound on that of every other pose: over bends within +-3.1
rad and modules of half to twice their length, for N = 1 to 12 and 1 to 150 times the nominal
damping, none was faster by more than 0.1 %.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from octarm.arm import lagrange
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError

SHORTEST_STEP, LONGEST_STEP = 1e-7, 0.1  # of the physics [s]
_GROWING = 1e-9  # share of an eigenvalue; a smaller positive real part is rounding


def state_matrix(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """A = d(v, v')/d(q, v) at rest at q, shape (..., 4N, 4N) [1/s].

    A constant generalised force holds the arm at q, shape (..., 2N) [m], [rad]; batch axes of q
    and of the parameters broadcast.
    """
    stiffness, damping = _per_inertia(p, q)
    return _companion(-stiffness, -damping)


def rates(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """The eigenvalues of `state_matrix`, complex, shape (..., 4N) [1/s]."""
    return np.linalg.eigvals(state_matrix(p, q))


class Mode(NamedTuple):
    """A motion in which the arm would swing about q without dampers.

    Attributes:
        frequency: of that [Hz]; NaN for a mode that grows instead.
        damping_ratio: x^T B_c x / (2 w x^T D x) with w = 2 pi frequency [1]; from 1 on the mode
            does not swing. It is exact where dampers are in proportion to springs, and close where
            damping is light. NaN for a mode that grows.
        shape: x, with x^T D x = 1, shape (2N,).
        slides: share of the slides in the kinetic energy, cross terms aside [1].
    """

    frequency: float
    damping_ratio: float
    shape: np.ndarray
    slides: float


def modes(p: ArmParameters, q: np.ndarray) -> list[Mode]:
    """The modes of one arm at q, shape (2N,), by ascending frequency."""
    inertia, damper = lagrange.mass_matrix(p, q), lagrange.damping_matrix(p)
    root = np.linalg.inv(np.linalg.cholesky(inertia))
    squares, turned = np.linalg.eigh(root @ lagrange.potential_hessian(p, q) @ root.T)
    shapes = root.T @ turned
    ascending: list[Mode] = []
    for square, x in zip(squares.tolist(), shapes.T, strict=True):
        w = float(np.sqrt(square)) if square > 0.0 else np.nan
        energy = np.diagonal(inertia) * x * x
        slides = float(energy[: p.modules].sum() / energy.sum())
        ascending.append(Mode(w / (2.0 * np.pi), float(x @ damper @ x) / (2.0 * w), x, slides))
    return ascending


def rate_bound(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """A bound on the modulus of `rates`, in a tenth of the time, shape (...) [1/s].

    A mode x has l^2 x = -l D^-1 B x - D^-1 K x, so that |l|^2 <= |l| b + k by the norms b and k.
    Both integrators are stable up to |l| h = 2.
    """
    with np.errstate(all="ignore"):
        k, b = (np.max(np.sum(np.abs(x), axis=-1), axis=-1) for x in _per_inertia(p, q))
        return 0.5 * (b + np.sqrt(b * b + 4.0 * k))


def longest_step(p: ArmParameters, q: np.ndarray, integrator: str = "rk4") -> np.ndarray:
    """The longest step at which no mode at q grows that does not grow by itself, shape (...) [s].

    It is 0 where the modes are beyond a float. The pose q has shape (..., 2N) [m], [rad], and the
    integrator a name of `INTEGRATORS`.
    """
    with np.errstate(all="ignore"):
        stiffness, damping = _per_inertia(p, q)
        good = np.all(np.isfinite(stiffness) & np.isfinite(damping), axis=(-2, -1))
        stiffness, damping = (np.where(good[..., None, None], x, 0.0) for x in (stiffness, damping))
        return np.where(good, INTEGRATORS[integrator](stiffness, damping), 0.0)


def _longest_of_rk4(stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """From D^-1 K and D^-1 B: |R(h lambda)| <= 1, R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24."""
    eigenvalues = np.linalg.eigvals(_companion(-stiffness, -damping))
    size = np.abs(eigenvalues)
    decays = (eigenvalues.real <= _GROWING * size) & (size > 0.0)
    size = np.where(decays, size, 1.0)
    direction = np.minimum(eigenvalues.real, 0.0) + 1j * eigenvalues.imag
    radius = _rk4_radius(np.where(decays, direction / size, -1.0))
    return np.min(np.where(decays, radius / size, np.inf), axis=-1)


def _rk4_radius(direction: np.ndarray) -> np.ndarray:
    """How far RK4 is stable in the left half-plane, in a direction of modulus 1, shape (...) [1].

    By bisection: every ray there leaves the region |R| <= 1 once, between 2.6 and 3.
    """
    low, high = np.full(direction.shape, 2.6), np.full(direction.shape, 3.0)
    for _ in range(30):
        middle = 0.5 * (low + high)
        z = middle * direction
        stable = np.abs(1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))) <= 1.0
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return low


def _longest_of_implicitfast(stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """From D^-1 K and D^-1 B: 4 D + 2 h B - h^2 K is positive semidefinite.

    A step takes v' from (D + h B)(v' - v) = -h (K q + B v) and then q' = q + h v'. With a mode z^k
    and h = 1/x, z = -1 is where x^2 D + x B/2 - K/4 becomes singular.
    """
    x = np.max(np.linalg.eigvals(_companion(stiffness / 4.0, -damping / 2.0)).real, axis=-1)
    return np.where(x > 0.0, 1.0 / np.where(x > 0.0, x, 1.0), np.inf)


# MuJoCo's integrators that an arm can be stepped with: from D^-1 K and D^-1 B, shapes
# (..., 2N, 2N), to the longest step, shape (...) [s].
INTEGRATORS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "rk4": _longest_of_rk4,
    "implicitfast": _longest_of_implicitfast,
}


def check_step(timestep: float) -> None:
    """Raises OctarmError for a physics step [s] that no arm is simulated with."""
    if not SHORTEST_STEP <= timestep <= LONGEST_STEP:
        raise OctarmError(
            f"timestep is {timestep:g} s; it must be between {SHORTEST_STEP:g} and "
            f"{LONGEST_STEP:g} s"
        )


def _per_inertia(p: ArmParameters, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D^-1 dG/dq and D^-1 B at q, each of shape (..., 2N, 2N)."""
    q = np.broadcast_to(q, (*np.broadcast_shapes(q.shape[:-1], p.batch_shape), q.shape[-1]))
    inertia, slope = lagrange.mass_matrix(p, q), lagrange.potential_hessian(p, q)
    damper = np.broadcast_to(lagrange.damping_matrix(p), slope.shape)
    slopes = np.concatenate([slope, damper], axis=-1)
    try:
        stiffness, damping = np.split(np.linalg.solve(inertia, slopes), 2, axis=-1)
    except np.linalg.LinAlgError:  # masses so small that their products vanish
        stiffness = damping = np.full_like(slope, np.nan)
    return stiffness, damping


def _companion(lower_left: np.ndarray, lower_right: np.ndarray) -> np.ndarray:
    n = lower_left.shape[-1]
    out = np.zeros((*lower_left.shape[:-2], 2 * n, 2 * n))
    out[..., :n, n:] = np.eye(n)
    out[..., n:, :n], out[..., n:, n:] = lower_left, lower_right
    return out
