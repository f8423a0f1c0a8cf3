"""The analytic model of the arm, eqs (1)-(5): F_coeff tau = D q'' + C q' + G.

With the ends of the modules p_i and the angles phi_i = theta_1 + .. + theta_i of their plates, see
`octarm.arm.kinematics`:

    T = 1/2 sum m_i |p_i'|^2 + I_i phi_i'^2
    V = -g u(0).sum m_i p_i + 1/2 sum k_ai (L_ai - L0_ai)^2     gravity along the hanging arm
    R = 1/2 sum c_ai L_ai'^2,    L_1i, L_2i = s_i +- (l_i/2) theta_i

L0 being L at the rest length and the rest angle of a module, mostly 0. A backbone adds the terms of
a spring and a damper on s_i, and of others on theta_i, that relax there, too.

Pure functions that never see MuJoCo: they are what it is checked against, and what the controllers
use as their nominal model. `inverse_dynamics` is the recursion that runs in the control loop; the
matrices are built from the Jacobians instead, so that each checks the other.

Shapes: coordinates q = [s1..sN, theta1..thetaN] [m], [rad], velocities v, accelerations a and
generalised forces are arrays of shape (..., 2N). Their batch axes broadcast against those of the
parameters. An array whose last axis is not 2N long raises OctarmError.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from octarm.arm.kinematics import jacobian, jacobian_rate, plate_axes
from octarm.arm.kinematics import positions as positions
from octarm.arm.parameters import ArmParameters
from octarm.arm.recursion import OutRow, Recursion, Row, check_coordinates
from octarm.arrays import Entry, split
from octarm.errors import OctarmError

NO_EQUILIBRIUM = "no static equilibrium was found: stiffness is too low for this weight"


def inverse_dynamics(
    p: ArmParameters, q: np.ndarray, v: np.ndarray, a: np.ndarray, v_r: np.ndarray | None = None
) -> np.ndarray:
    """The generalised force D(q) a + (C(q, v) + B) v_r + G(q), eq (1), in O(N).

    A Newton-Euler recursion with two velocities: C(q, v) v_r is bilinear, and because C is in
    Christoffel form, it is the inertial force of the acceleration sum_jk d2p/dq_j dq_k v_j v_r_k.

    All have shape (..., 2N), the force in [N], [N m]; v_r is v when not given.
    """
    return _DYNAMICS(p.rows, q, v, a, v if v_r is None else v_r)


def _dynamics(
    q: Row, cos: Row, sin: Row, v: Row, a: Row, v_r: Row,
    mass: Row, inertia: Row, gravity: Row, half: Row, rest_length: Row, rest_angle: Row,
    k1: Row, k2: Row, c1: Row, c2: Row, k_s: Row, k_t: Row, c_s: Row, c_t: Row,
    force: OutRow, fx: OutRow, fy: OutRow, couple: OutRow,
) -> None:  # fmt: skip
    """Outwards what accelerates the modules, inwards force and moment that each of them carries."""
    n = len(mass)
    column_forces(q, v_r, half, rest_length, rest_angle, k1, k2, c1, c2, k_s, k_t, c_s, c_t, force)
    inertial_forces(q, cos, sin, v, a, v_r, mass, inertia, gravity, fx, fy, couple)
    x = y = moment = 0.0
    for i in range(n - 1, -1, -1):
        x, y, moment = x + fx[i], y + fy[i], moment + couple[i]
        force[n + i] = moment + force[n + i]
        if i == 0:  # it stands on the ground, along x
            force[0] = x + force[0]
        else:
            force[i] = x * cos[i] + y * sin[i] + force[i]
            moment = moment + q[i] * (y * cos[i] - x * sin[i])


def inertial_forces(
    q: Row, cos: Row, sin: Row, v: Row, a: Row, v_r: Row, mass: Row, inertia: Row, gravity: Row,
    fx: OutRow, fy: OutRow, couple: OutRow,
) -> None:  # fmt: skip
    """What accelerates the masses and inertias against gravity, from the base outwards.

    Rows are those of `inverse_dynamics`, of `plate_rows` and of `ArmParameters.rows`, with entries
    of shape (...). For each module it writes force along x, force along y and couple on its end
    [N], [N], [N m].
    """
    n = len(mass)
    # The first module stands on the ground, which accelerates against gravity and does not turn.
    w, w_r, alpha = v[n], v_r[n], a[n]
    ax, ay = a[0] - gravity[0], 0.0
    fx[0], fy[0], couple[0] = mass[0] * ax, ay, inertia[0] * alpha
    for i in range(1, n):
        along = a[i] - q[i] * (w * w_r)
        across = q[i] * alpha + (v[i] * w_r + v_r[i] * w)
        ax = ax + (along * cos[i] - across * sin[i])
        ay = ay + (along * sin[i] + across * cos[i])
        w, w_r, alpha = w + v[n + i], w_r + v_r[n + i], alpha + a[n + i]
        fx[i], fy[i], couple[i] = mass[i] * ax, mass[i] * ay, inertia[i] * alpha


def mass_matrix(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """Inertia matrix D(q), eq (3), symmetric positive definite, shape (..., 2N, 2N)."""
    n = _modules(p, "q", q)
    J = jacobian(q)
    rotation = np.tril(np.ones((n, n)))  # d phi_b / d theta_k
    out = np.einsum("...b,...bxi,...bxj->...ij", p.mass, J, J)
    out[..., n:, n:] += np.einsum("...b,bi,bj->...ij", p.inertia, rotation, rotation)
    return out


def coriolis_matrix(p: ArmParameters, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """C(q, v) of eq (4) in Christoffel form and without damping, shape (..., 2N, 2N).

    For point masses and constant angular Jacobians the Christoffel symbols are
    sum m_b dp_b/dq_i . d2p_b/dq_j dq_k, hence C = sum m_b J_b^T J_b'; x^T (D' - 2C) x = 0 for
    every x. Units: force per velocity, [N s/m] to [N m s].
    """
    _modules(p, "q v", q, v)
    return np.einsum("...b,...bxi,...bxj->...ij", p.mass, jacobian(q), jacobian_rate(q, v))


def damping_matrix(p: ArmParameters) -> np.ndarray:
    """The c terms of eq (4): B = T diag(c) T^T, shape (..., 2N, 2N) [N s/m] to [N m s].

    The dampers of the backbone stand on the diagonal.
    """
    return _column_matrix(p, p.damping, p.backbone_damping)


def stiffness_matrix(p: ArmParameters) -> np.ndarray:
    """The k terms of eq (5): K = T diag(k) T^T, shape (..., 2N, 2N) [N/m] to [N m].

    The springs of the backbone stand on the diagonal.
    """
    return _column_matrix(p, p.stiffness, p.backbone_stiffness)


def potential_force(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """G(q), eq (5): what holds the arm against gravity and springs, shape (..., 2N) [N], [N m]."""
    _modules(p, "q", q)
    gravity = np.asarray(p.gravity)[..., None]
    out = -gravity * np.einsum("...b,...bi->...i", p.mass, jacobian(q)[..., 0, :])
    forces: list[Entry] = [0.0] * p.coordinates
    still = np.zeros_like(q)
    column_forces(split(q), split(still), *map(split, p.elastic.arrays), force=forces)
    return out + np.stack(forces, axis=-1)


def force_coefficients(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """F_coeff(q), eq (2), by virtual work, shape (..., 2N, 2N) [1] and [m].

    Column (a, i): a unit force on the end of module i along u(phi_{i-1}) and a couple +-l/2 on its
    plate, both reacting on the ground.
    """
    n = _modules(p, "q", q)
    pushes = np.einsum("...bxi,...bx->...ib", jacobian(q), plate_axes(q))
    batch = np.broadcast_shapes(q.shape[:-1], p.batch_shape)
    out = np.array(np.broadcast_to(np.repeat(pushes, 2, axis=-1), (*batch, 2 * n, 2 * n)))
    turns = np.triu(np.ones((n, n)))  # the couple on plate b turns every theta_k with k <= b
    half = 0.5 * p.widths[..., None, :]
    out[..., n:, 0::2] += half * turns
    out[..., n:, 1::2] -= half * turns
    return out


def forward_dynamics(
    p: ArmParameters, q: np.ndarray, v: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Generalised accelerations under a generalised force, shape (..., 2N) [m/s^2], [rad/s^2]."""
    _modules(p, "q v force", q, v, force)
    rest = inverse_dynamics(p, q, v, np.zeros_like(q))
    return np.linalg.solve(mass_matrix(p, q), (force - rest)[..., None])[..., 0]


def energy(p: ArmParameters, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic and potential energy, each of shape (...) [J]; no weight potential at the base."""
    n = _modules(p, "q v", q, v)
    velocity = np.einsum("...bxi,...i->...bx", jacobian(q), v)
    rate = np.cumsum(v[..., n:], axis=-1)
    kinetic = 0.5 * np.sum(
        p.mass * np.sum(velocity * velocity, axis=-1) + p.inertia * rate * rate, axis=-1
    )
    height = np.sum(p.mass * positions(q)[..., 0], axis=-1)
    length, turn = q[..., :n] - p.rest_length, q[..., n:] - p.rest_angle
    bend = 0.5 * p.widths * turn
    stretch = np.stack([length + bend, length - bend], axis=-2)  # L_ai - L0_ai
    springs = 0.5 * np.sum(p.stiffness * stretch * stretch, axis=(-2, -1))
    along, turning = p.backbone_stiffness[..., 0, :], p.backbone_stiffness[..., 1, :]
    springs = springs + 0.5 * np.sum(along * length * length + turning * turn * turn, axis=-1)
    return kinetic, springs - p.gravity * height


def kinetic_energy(p: ArmParameters, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """1/2 v^T D(q) v, shape (...) [J], in O(N) by recursion along the arm."""
    return _KINETIC(p.inertial, q, v)[..., 0]


def _kinetic(
    q: Row, cos: Row, sin: Row, v: Row, mass: Row, inertia: Row, gravity: Row, energy: OutRow
) -> None:
    n = len(mass)
    w, vx, vy = v[n], v[0], 0.0
    twice = mass[0] * (vx * vx) + inertia[0] * (w * w)
    for i in range(1, n):
        across = q[i] * w
        vx = vx + (v[i] * cos[i] - across * sin[i])
        vy = vy + (v[i] * sin[i] + across * cos[i])
        w = w + v[n + i]
        twice = twice + (mass[i] * (vx * vx + vy * vy) + inertia[i] * (w * w))
    energy[0] = 0.5 * twice


def equilibrium(p: ArmParameters) -> np.ndarray:
    """The coordinates at which the arm hangs still, G(q) = 0, shape (..., 2N) [m], [rad].

    By Newton's method from the unloaded arm; see `newton` for errors.
    """
    q = np.zeros((*p.batch_shape, p.coordinates))
    q[..., : p.modules], q[..., p.modules :] = p.rest_length, p.rest_angle
    return newton(lambda q: (potential_force(p, q), potential_hessian(p, q)), q, 1e-10)


def newton(
    linearised: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], q: np.ndarray, within: float
) -> np.ndarray:
    """Where the forces on an arm vanish, by Newton's method from q, shape (..., 2N).

    `linearised` gives the force at q and its slope, shapes (..., 2N) and (..., 2N, 2N). The last
    step is `within` so small a share of a coordinate or of 1; the next one would be about its
    square. Raises OctarmError if it does not converge: the springs are too soft for this weight.
    """
    with contextlib.suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        for _ in range(50):
            force, slope = linearised(q)
            step = np.linalg.solve(slope, force[..., None])[..., 0]
            q = q - step
            if np.all(np.abs(step) < within * np.maximum(1.0, np.abs(q))):
                return q
    raise OctarmError(NO_EQUILIBRIUM)


def potential_hessian(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """dG/dq, the stiffness felt at q, symmetric, shape (..., 2N, 2N) [N/m] to [N m].

    Gravity has the potential -g sum_i M_i s_i cos phi_{i-1}, M_i being the mass from module i on,
    of which only phi_{i-1} = theta_1 + .. + theta_{i-1} and s_i are variable.
    """
    n = _modules(p, "q", q)
    batch = np.broadcast_shapes(q.shape[:-1], p.batch_shape)
    out = np.array(np.broadcast_to(stiffness_matrix(p), (*batch, 2 * n, 2 * n)))
    axes = plate_axes(q)
    weight = np.asarray(p.gravity)[..., None] * _from_the_tip(p.mass)
    mixed = np.triu((weight * axes[..., 1])[..., None, :] * np.ones((n, n)), 1)  # [k, i], k < i
    out[..., n:, :n] += mixed
    out[..., :n, n:] += np.swapaxes(mixed, -1, -2)
    hanging = weight * q[..., :n] * axes[..., 0]
    bends = np.zeros((*batch, n + 1))
    bends[..., :n] = _from_the_tip(hanging)  # of the segments beyond theta_k and theta_l
    i = np.arange(n)
    out[..., n:, n:] += bends[..., np.maximum(i[:, None], i) + 1]
    return out


def _from_the_tip(x: np.ndarray) -> np.ndarray:
    return np.cumsum(x[..., ::-1], axis=-1)[..., ::-1]


def _modules(p: ArmParameters, names: str, *arrays: np.ndarray) -> int:
    for name, array in zip(names.split(), arrays, strict=True):
        check_coordinates(name, array, p.coordinates)
    return p.modules


def column_forces(
    q: Row, v: Row, half: Row, rest_length: Row, rest_angle: Row,
    k1: Row, k2: Row, c1: Row, c2: Row, k_s: Row, k_t: Row, c_s: Row, c_t: Row, force: OutRow,
) -> None:  # fmt: skip
    """Forces on s_i and couples on theta_i of springs and dampers, 2N entries [N], [N m]."""
    n = len(half)
    for i in range(n):
        stretch, turn = q[i] - rest_length[i], q[n + i] - rest_angle[i]
        bend, bend_rate = half[i] * turn, half[i] * v[n + i]
        first = k1[i] * (stretch + bend) + c1[i] * (v[i] + bend_rate)
        second = k2[i] * (stretch - bend) + c2[i] * (v[i] - bend_rate)
        force[i], force[n + i] = first + second, half[i] * (first - second)
        if len(k_s) > 0:
            force[i] = force[i] + (k_s[i] * stretch + c_s[i] * v[i])
            force[n + i] = force[n + i] + (k_t[i] * turn + c_t[i] * v[n + i])


def _column_matrix(p: ArmParameters, coefficient: np.ndarray, backbone: np.ndarray) -> np.ndarray:
    """T diag(coefficient) T^T with T the constant moments of the columns, and the backbone."""
    n = p.modules
    half = 0.5 * p.widths
    first, second = coefficient[..., 0, :], coefficient[..., 1, :]
    out = np.zeros((*p.batch_shape, 2 * n, 2 * n))
    i = np.arange(n)
    out[..., i, i] = first + second + backbone[..., 0, :]
    out[..., i, n + i] = out[..., n + i, i] = half * (first - second)
    out[..., n + i, n + i] = half * half * (first + second) + backbone[..., 1, :]
    return out


_DYNAMICS, _KINETIC = Recursion(_dynamics), Recursion(_kinetic)
