"""What makes two arms alike but for their size: scales of length, force and time, and ratios.

Gains are multiples of these scales, so that dynamically similar arms behave identically: arms whose
masses, lengths and times differ by three factors, and everything else accordingly.

- Length of a coordinate: the rest length of a slide, 1 rad of a bend; `LagrangeModel.scale`.
- Time: 1 / omega of the fastest undamped mode of the hanging arm. It is the mode that a sampled
  loop has to bear. It hardly changes with the number of modules, as neighbours of the same kind
  swing against each other in it (3 modules 154 rad/s, 30 of them 181 rad/s), while the slowest one
  becomes slower and slower (15 and 1.9 rad/s).
- Force of a coordinate: what accelerates it, all others being free, by its length within the square
  of the time. So K_v = 1 in these scales is a decay at the rate of the fastest mode, whatever the
  number of modules.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from octarm.arm import lagrange
from octarm.arm.modes import rates
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError

_BEYOND = (
    "gains have no scale here: masses, lengths and stiffnesses of the nominal model are beyond a "
    "float, or leave no mode that swings"
)


class Scales(NamedTuple):
    """The scales of an arm.

    Attributes:
        time: 1 / omega of the fastest undamped mode, shape () for one arm, else (..., 1) [s].
        force: what accelerates a coordinate, all others being free, by its length in the time
            squared, shape (..., 2N) [N], [N m], contiguous along the arms; its mass is
            1 / [D^-1]_jj.
    """

    time: np.ndarray
    force: np.ndarray


def scales(p: ArmParameters) -> Scales:
    """The scales of the hanging arm.

    Raises OctarmError if no mode swings, or masses, lengths or stiffnesses are beyond a float.
    """
    length = np.concatenate([p.rest_length, np.ones_like(p.rest_length)], axis=-1)
    with np.errstate(all="ignore"):
        squares, half = _modes(p, lagrange.equilibrium(p))
        fastest = squares[..., -1:] if squares.ndim > 1 else squares[-1]
        mass = 1.0 / np.sum(half * half, axis=-2)  # D^-1 = half^T half
        force = length * mass * fastest
        both = Scales(np.asarray(1.0 / np.sqrt(fastest)), np.array(force.T, order="C").T)
    if not all(np.all(np.isfinite(scale) & (scale > 0.0)) for scale in both):
        raise OctarmError(_BEYOND)
    return both


def _modes(p: ArmParameters, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The squares of the undamped frequencies at rest, rising, and L^-1 of D = L L^T.

    Shapes (..., 2N) [1/s^2] and (..., 2N, 2N). With a negative square the arm does not stay there.
    """
    try:
        half = np.linalg.inv(np.linalg.cholesky(lagrange.mass_matrix(p, rest)))
        # L^-1 K L^-T is symmetric, and has the eigenvalues of D^-1 K.
        stiffness = half @ lagrange.potential_hessian(p, rest) @ half.swapaxes(-1, -2)
        return np.linalg.eigvalsh(stiffness), half
    except np.linalg.LinAlgError:
        raise OctarmError(_BEYOND) from None


def descriptors(p: ArmParameters) -> Mapping[str, np.ndarray]:
    """Ratios in which arms may differ that are not similar, each of shape (...) [1].

    `modules` N; `mode_ratio`, the fastest over the slowest undamped frequency; `damping_ratio` of
    the slowest mode; `weight_ratio`, the weight over the force that doubles the first module's
    length; `mass_ratio`, the last module's mass over the first one's.
    """
    rest = lagrange.equilibrium(p)
    modes = np.sqrt(np.abs(_modes(p, rest)[0]))
    eigenvalues: np.ndarray = rates(p, rest)
    size, decay = np.abs(eigenvalues), -np.real(eigenvalues)
    slowest = np.argmin(size, axis=-1)[..., None]
    damping = np.take_along_axis(decay / size, slowest, -1)[..., 0]
    doubling = np.sum(p.stiffness[..., 0], axis=-1) * p.rest_length[..., 0]
    return {
        "modules": np.asarray(float(p.modules)),
        "mode_ratio": np.max(modes, axis=-1) / np.min(modes, axis=-1),
        "damping_ratio": damping,
        "weight_ratio": np.abs(p.gravity) * np.sum(p.mass, axis=-1) / doubling,
        "mass_ratio": p.mass[..., -1] / p.mass[..., 0],
    }
