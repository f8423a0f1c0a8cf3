"""The analytic Lagrange model as a controller's nominal model, with its scales and input range.

What makes two arms alike but for their size are scales of length, force and time, and ratios.
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

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from octarm.arm import lagrange, model_error
from octarm.arm.actuation import GroundedActuation
from octarm.arm.modes import rates
from octarm.arm.parameters import ArmParameters
from octarm.arrays import coordinate_names, coordinate_units
from octarm.errors import OctarmError
from octarm.interfaces import NominalModel

_BEYOND = (
    "gains have no scale here: masses, lengths and stiffnesses of the nominal model are beyond a "
    "float, or leave no mode that swings"
)


@dataclasses.dataclass(frozen=True, eq=False)
class LagrangeModel(NominalModel):
    """The planar arm with these parameters, by `octarm.arm.lagrange`.

    `octarm.interfaces.NominalModel` says what each method takes and gives; errors are those of
    `octarm.arm.model_error`.

    Attributes:
        parameters: what the controller believes of the arm, of one arm or of a batch.
    """

    parameters: ArmParameters

    @property
    def modules(self) -> int:
        return self.parameters.modules

    @property
    def coordinates(self) -> int:
        return self.parameters.coordinates

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(coordinate_names(self.modules))

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(coordinate_units(self.modules))

    @property
    def scale(self) -> np.ndarray:
        """Rest lengths of slides, 1 rad for bends, shape (..., 2N) [m], [rad]."""
        lengths = self.parameters.rest_length
        return np.concatenate([lengths, np.ones_like(lengths)], axis=-1)

    @property
    def time_scale(self) -> np.ndarray:
        return self._scales[0]

    @property
    def force_scale(self) -> np.ndarray:
        return self._scales[1]

    @functools.cached_property
    def _scales(self) -> tuple[np.ndarray, np.ndarray]:
        """Those of time and of force; the mass of a coordinate is 1 / [D^-1]_jj."""
        with np.errstate(all="ignore"):
            squares, half = _modes(self.parameters, self.equilibrium())
            fastest = squares[..., -1:] if squares.ndim > 1 else squares[-1]
            mass = 1.0 / np.sum(half * half, axis=-2)  # D^-1 = half^T half
            force = self.scale * mass * fastest
            # Forces are contiguous along the arms.
            both = np.asarray(1.0 / np.sqrt(fastest)), np.array(force.T, order="C").T
        if not all(np.all(np.isfinite(scale) & (scale > 0.0)) for scale in both):
            raise OctarmError(_BEYOND)
        return both

    @property
    def descriptors(self) -> Mapping[str, np.ndarray]:
        """Ratios in which arms may differ that are not similar, each of shape (...) [1].

        `modules` N; `mode_ratio`, the fastest over the slowest undamped frequency; `damping_ratio`
        of the slowest mode; `weight_ratio`, the weight over the force that doubles the first
        module's length; `mass_ratio`, the last module's mass over the first one's.
        """
        p, rest = self.parameters, self.equilibrium()
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

    @property
    def input_range(self) -> tuple[np.ndarray, np.ndarray]:
        return self._range.low, self._range.high

    @functools.cached_property
    def _range(self) -> InputRange:
        return InputRange(self.parameters)

    def inverse_dynamics(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, v_r: np.ndarray | None = None
    ) -> np.ndarray:
        return lagrange.inverse_dynamics(self.parameters, q, v, a, v_r)

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        return lagrange.mass_matrix(self.parameters, q)

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return lagrange.kinetic_energy(self.parameters, q, v)

    def potential_force(self, q: np.ndarray) -> np.ndarray:
        return lagrange.potential_force(self.parameters, q)

    def force_coefficients(self, q: np.ndarray) -> np.ndarray:
        return lagrange.force_coefficients(self.parameters, q)

    def shortfall(self, q: np.ndarray, force: np.ndarray) -> np.ndarray | None:
        return self._range.shortfall(q, force)

    def equilibrium(self) -> np.ndarray:
        return lagrange.equilibrium(self.parameters)

    def largest_inertia(self, q: np.ndarray) -> np.ndarray:
        return model_error.straight_inertia(self.parameters, q)

    def largest_error(
        self, uncertainty: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray, v_r: np.ndarray
    ) -> np.ndarray:
        return model_error.largest_error(self.parameters, uncertainty, q, v, a, v_r)


class InputRange:
    """The range of the inputs of one arm or of a batch, which act by F_coeff, eq (2).

    Attributes:
        low: lowest input forces, shape (..., 2N) [N].
        high: highest input forces, likewise.
    """

    def __init__(self, parameters: ArmParameters) -> None:
        """The range of arms with these parameters."""
        self.low, self.high = parameters.input_bounds(parameters.input_range.shape[:-2])
        self._actuation = GroundedActuation(parameters.widths)
        self._least_width = float(np.min(parameters.width))
        both_ways = np.minimum(-self.low, self.high).reshape(-1, parameters.modules, 2)
        self._surely = (0.999999 * both_ways.min(axis=(0, 2))).tolist()  # a number a module

    def shortfall(self, q: np.ndarray, force: np.ndarray) -> np.ndarray | None:
        """What of a force Q at q is lost when its inputs are cut off at their range.

        It is F_coeff(q) (tau - tau within the range) with tau = F_coeff(q)^-1 Q, all of shape (...,
        2N) [N], [N m]; None if nothing is cut off of any arm.
        """
        if self._surely_within(q, force):
            return None
        tau = self._actuation.inputs(q, force)
        excess = tau - np.minimum(np.maximum(tau, self.low), self.high)
        return self._actuation.force(q, excess) if excess.any() else None

    def _surely_within(self, q: np.ndarray, force: np.ndarray) -> bool:
        """Whether |F_coeff^-1 Q| is within the range however the arms are bent.

        The sizes in the back-substitution of `GroundedActuation.inputs`, of all arms at once: a
        fraction of the work where no input comes near its limit.
        """
        n = len(self._surely)
        wanted, lengths = _largest(force), _largest(q[..., :n])
        below = carried = 0.0  # force and moment of the modules below
        for i in reversed(range(n)):
            if i + 1 < n:
                carried = wanted[n + i + 1] + lengths[i + 1] * below
            push = wanted[i] + below
            couple = (wanted[n + i] + carried) / self._least_width
            if not 0.5 * push + couple <= self._surely[i]:
                return False
            below += push
        return True


def _largest(x: np.ndarray) -> list[float]:
    if x.ndim == 1:
        return [abs(value) for value in x.tolist()]
    return np.max(np.abs(x), axis=tuple(range(x.ndim - 1))).tolist()


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
