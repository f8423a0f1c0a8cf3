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

import numpy as np

from octarm.arm import lagrange
from octarm.arm.modes import rates
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError


def apparent_mass(p: ArmParameters) -> np.ndarray:
    """What each coordinate of the hanging arm feels when the others are free, 1 / [D^-1]_jj.

    Shape (..., 2N) [kg], [kg m^2].

    Raises:
        OctarmError: if masses are so far apart that D cannot be inverted.
    """
    inertia = lagrange.mass_matrix(p, lagrange.equilibrium(p))
    try:
        inverse = np.linalg.inv(inertia)
    except np.linalg.LinAlgError:
        raise _beyond("masses") from None
    return 1.0 / np.diagonal(inverse, axis1=-2, axis2=-1)


def undamped_modes(p: ArmParameters) -> np.ndarray:
    """The squares of the circular frequencies of the hanging arm, rising, shape (..., 2N) [1/s^2].

    With a negative one the arm does not stay where it hangs.

    Raises:
        OctarmError: if masses or stiffnesses are beyond a float.
    """
    rest = lagrange.equilibrium(p)
    try:
        # D = L L^T: L^-1 K L^-T is symmetric, and has the eigenvalues of D^-1 K.
        half = np.linalg.inv(np.linalg.cholesky(lagrange.mass_matrix(p, rest)))
        stiffness = half @ lagrange.potential_hessian(p, rest) @ half.swapaxes(-1, -2)
        return np.linalg.eigvalsh(stiffness)
    except np.linalg.LinAlgError:
        raise _beyond("masses and stiffnesses") from None


def time_scale(p: ArmParameters) -> np.ndarray:
    """1 / omega of the fastest undamped mode, shape () for one arm, else (..., 1) [s].

    Raises:
        OctarmError: if no mode is stable, or if it is beyond a float.
    """
    fastest = undamped_modes(p)[..., -1]
    if not np.all((fastest > 0.0) & np.isfinite(fastest)):
        raise _beyond("masses and stiffnesses")
    return np.asarray(1.0 / np.sqrt(fastest[..., None] if fastest.ndim else fastest))


def _beyond(what: str) -> OctarmError:
    return OctarmError(
        f"the gains have no scale: the {what} of the nominal model leave no mode that swings, or "
        "are beyond a float"
    )


def descriptors(p: ArmParameters) -> Mapping[str, np.ndarray]:
    """Ratios in which arms may differ that are not similar, each of shape (...) [1].

    `modules` N; `mode_ratio`, the fastest over the slowest undamped frequency; `damping_ratio` of
    the slowest mode; `weight_ratio`, the weight over the force that doubles the first module's
    length; `mass_ratio`, the last module's mass over the first one's.
    """
    modes = np.sqrt(np.abs(undamped_modes(p)))
    eigenvalues: np.ndarray = rates(p, lagrange.equilibrium(p))
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
