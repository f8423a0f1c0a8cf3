"""Motions whose tip follows a path: the inverse kinematics of the lumped arm.

Of all poses with the tip at its place the one is taken that is closest to rest, bends counted in
radians and slides in lengths of their modules: 1/2 (q - rest)^T W (q - rest) is the smallest, with
W = diag(1 / l^2, 1). It is a function of the place alone, so that a closed path of the tip is a
closed path of the coordinates. A spline of degree 5 through poses that are close to each other
gives q, and with it v and a.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from octarm.arm.actuation import GroundedActuation
from octarm.arm.kinematics import jacobian, last_axis, plate_axes, tip_position
from octarm.arm.lagrange import inverse_dynamics
from octarm.arm.limits import Limits
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.fields import Quantity, Words
from octarm.interfaces import Motion, Reference
from octarm.references.motions import Spline
from octarm.references.named import TIME, Hanging, NamedReference, Sizes

_A_ROUND = 200  # poses
_STAGES, _ITERATIONS = 8, 20  # of Newton's method, whose steps are quadratically small in the end
_ACCURACY = 1e-9  # of q [m], [rad]
_FLAT = 1e-9  # the tip moves along one line only if its Jacobian is so close to rank 1
# x^6 times this is an ease from 0 to 1 whose first five derivatives vanish at both ends.
_EASE = np.polynomial.Polynomial([462.0, -1980.0, 3465.0, -3080.0, 1386.0, -252.0])


@dataclasses.dataclass(frozen=True, kw_only=True)
class TipPath(NamedReference):
    """The tip follows a circle about its place at rest, or a line or an eight through it.

    It swings up to the full size within the first round. An angle turns the path, from across the
    hanging arm.
    """

    nominal: ClassVar[Sizes] = {"size": 0.04}
    path: Annotated[str, Words(alone=("circle", "line", "eight"))] = "circle"
    size: Annotated[float | None, Quantity("m", above=0.0, at_most=10.0)] = None
    period: Annotated[float, TIME] = 3.0
    angle: Annotated[float, Quantity("rad", at_least=-2.0 * np.pi, at_most=2.0 * np.pi)] = 0.0

    def start(self, arm: Hanging) -> Motion:
        p = arm.parameters()
        try:
            spline = self._spline(p, arm.rest, self.size_for(arm))
        except OctarmError as error:
            path = f"the {self.path} of size {self.size_for(arm):g} m"
            raise OctarmError(f"the tip cannot follow {path}: {error}") from None

        def motion(t: float) -> Reference:
            late = t - self.period
            return spline(t if late < 0.0 else self.period + late % self.period)

        return motion

    def _spline(self, p: ArmParameters, rest: np.ndarray, size: float) -> Spline:
        """The motion in the first two rounds."""
        rounds = np.arange(-4.0, 2.0 * _A_ROUND + 5.0) / _A_ROUND  # a little more on both sides
        tips = _tip(p, rest) + size * self.place(rounds)
        spline = Spline(times=self.period * rounds, points=reached(p, rest, tips))
        between = rounds[4:-5] + 0.5 / _A_ROUND
        q = np.stack([spline(t).q for t in (self.period * between).tolist()])
        far = np.abs(_tip(p, q) - _tip(p, rest) - size * self.place(between))
        if not np.max(far) < _ACCURACY:
            raise OctarmError(
                "its poses change too suddenly, as those of an arm that buckles; a smaller one, or "
                "a line across the arm, is smooth"
            )
        return spline

    def size_for(self, arm: Hanging) -> float:
        """The radius of the circle, or half the length of the line or the eight [m]."""
        if self.size is not None:
            return self.size
        p = arm.parameters()
        across = arm.bend() * np.sum(p.rest_length) / 0.36  # [m] that the nominal arm has
        if self.path == "line" and self.angle == 0.0:
            return 0.04 * float(across)
        usual = 0.04 * np.minimum(across, np.sum(arm.slide()) / 3.0)
        return float(np.minimum(usual, 0.5 * _smooth_until(p, arm.rest)))

    def place(self, rounds: np.ndarray) -> np.ndarray:
        """Where the tip is after so many rounds, shape (K,) [1], in sizes, shape (K, 2) [1].

        From its place at rest, along the hanging arm and across it.
        """
        turn = 2.0 * np.pi * rounds
        along, across = {
            "circle": (np.cos(turn), np.sin(turn)),
            "line": (0.0 * turn, np.sin(turn)),
            "eight": (0.5 * np.sin(2.0 * turn), np.sin(turn)),
        }[self.path]
        x = np.clip(rounds, 0.0, 1.0)
        ease, cos, sin = x**6 * _EASE(x), np.cos(self.angle), np.sin(self.angle)
        turned = [cos * along + sin * across, cos * across - sin * along]
        return ease[:, None] * np.stack(turned, axis=-1)


def reached(p: ArmParameters, rest: np.ndarray, tips: np.ndarray) -> np.ndarray:
    """The poses of one arm with its tip at these places, shape (K, 2N) [m], [rad].

    It begins at rest, shape (2N,) [m], [rad], from which springs resist. The places are in the base
    frame, along the hanging arm and across it, shape (K, 2) [m]. Raises OctarmError if the tip does
    not get there within the limits of the arm and its inputs.
    """
    sizes = np.linalg.svd(_jacobian(p, rest), compute_uv=False)
    if not sizes[1] > _FLAT * sizes[0]:
        raise OctarmError("the tip of this arm moves along one line only")
    place, n = _tip(p, rest), p.coordinates
    x = np.zeros((len(tips), n + 2))  # q - rest, and the multipliers of the place
    far = np.full(len(tips), np.inf)
    with np.errstate(all="ignore"):  # what is out of reach may be anywhere
        for share in np.linspace(0.0, 1.0, _STAGES + 1)[1:]:  # of the way from rest
            for _ in range(_ITERATIONS):
                step = _newton_step(p, rest, x, place + share * (tips - place))
                x, far = x - step, np.max(np.abs(step[:, :n]), axis=-1)
                if not np.any(far > _ACCURACY):
                    break
    q = rest + x[:, :n]
    _check(p, q, far <= _ACCURACY, tips - place)
    return q


def _newton_step(p: ArmParameters, rest: np.ndarray, x: np.ndarray, tips: np.ndarray) -> np.ndarray:
    """Newton's step to W (q - rest) = J^T f and tip(q) = tips, shape (K, 2N + 2)."""
    n = p.coordinates
    q, pull = rest + x[:, :n], x[:, n:]
    weights, J = _weights(p), _jacobian(p, q)
    matrix = np.zeros((len(x), n + 2, n + 2))
    matrix[:, :n, :n] = np.diag(weights) - _curvature(p, q, pull)
    matrix[:, :n, n:] = -np.swapaxes(J, 1, 2)
    matrix[:, n:, :n] = J
    missing = np.empty_like(x)
    missing[:, :n] = x[:, :n] * weights - np.einsum("kij,ki->kj", J, pull)
    missing[:, n:] = _tip(p, q) - tips
    try:
        return np.linalg.solve(matrix, missing[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.full_like(x, np.nan)


def _curvature(p: ArmParameters, q: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """The derivative of J^T f by q for f of shape (K, 2), shape (K, 2N, 2N)."""
    n = p.modules
    u, (cos, sin) = plate_axes(q), last_axis(q)
    along = np.einsum("kib,kb->ki", u, pull)
    across = u[..., 0] * pull[:, 1:] - u[..., 1] * pull[:, :1]
    beyond = p.tip_length * (cos * pull[:, 0] + sin * pull[:, 1])
    later = np.cumsum((q[:, :n] * along)[:, ::-1], axis=-1)[:, ::-1]  # of module i and all beyond
    bends = np.column_stack([later[:, 1:] + beyond[:, None], beyond])
    i = np.arange(n)
    out = np.zeros((len(q), 2 * n, 2 * n))
    out[:, n:, n:] = -bends[:, np.maximum(i[:, None], i)]
    out[:, :n, n:] = np.where(i < i[:, None], across[..., None], 0.0)
    out[:, n:, :n] = np.swapaxes(out[:, :n, n:], 1, 2)
    return out


def _weights(p: ArmParameters) -> np.ndarray:
    """The diagonal of W, shape (2N,) [1/m^2], [1/rad^2]."""
    return np.concatenate([1.0 / np.square(p.rest_length), np.ones(p.modules)])


def _smooth_until(p: ArmParameters, rest: np.ndarray) -> float:
    """How far up the tip of a straight arm goes before the closest poses are bent ones [m].

    As a column that buckles they may then bend to either side, and jump between both.
    """
    n = p.modules
    up = _curvature(p, rest[None], np.array([[-1.0, 0.0]]))[0, n:, n:]
    with np.errstate(divide="ignore"):
        return float(np.sum(np.square(p.rest_length)) / np.max(np.linalg.eigvalsh(up)))


def _check(p: ArmParameters, q: np.ndarray, solved: np.ndarray, ways: np.ndarray) -> None:
    """Raises OctarmError for a place that is out of reach, of ways from rest, shape (K, 2) [m]."""
    still, limits = np.zeros_like(q), Limits.of(p)
    tau = GroundedActuation(p.widths).inputs(q, inverse_dynamics(p, q, still, still))
    low, high = p.input_bounds(())
    within = np.all((tau >= low) & (tau <= high), axis=-1)
    reached = solved & limits.holding(q, still) & within
    if reached.all():
        return
    i = np.argmin(reached)
    why = limits.violation(q[i], still[i])
    if not solved[i]:
        why = "no pose has the tip there"
    elif not why:
        worst = tau[i][np.argmax(np.maximum(tau[i] - high, low - tau[i]))]
        why = f"an input of {worst:.4g} N is needed, beyond the input range"
    along, across = 1e3 * ways[i]
    raise OctarmError(
        f"{along:.3g} mm along the arm and {across:.3g} mm across from its place at rest, {why}"
    )


def _tip(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """The tip in the base frame, along the hanging arm and across it, shape (..., 2) [m]."""
    world = tip_position(q, p.tip_length)
    return np.stack([-world[..., 2], world[..., 0]], axis=-1)


def _jacobian(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """dtip/dq_j, shape (..., 2, 2N) [1], [m]."""
    n = p.modules
    J = jacobian(q)[..., -1, :, :].copy()
    cos, sin = last_axis(q)
    J[..., 0, n:] -= np.asarray(p.tip_length * sin)[..., None]
    J[..., 1, n:] += np.asarray(p.tip_length * cos)[..., None]
    return J
