"""The analytic Lagrange model as a controller's nominal model, with the range of its inputs."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from octarm.arm import lagrange, model_error, similarity
from octarm.arm.actuation import GroundedActuation
from octarm.arm.parameters import ArmParameters
from octarm.arrays import coordinate_names, coordinate_units
from octarm.interfaces import NominalModel


@dataclasses.dataclass(frozen=True, eq=False)
class LagrangeModel(NominalModel):
    """The planar arm with these parameters, by `octarm.arm.lagrange`.

    `octarm.interfaces.NominalModel` says what each method takes and gives; scales are those of
    `octarm.arm.similarity`, errors those of `octarm.arm.model_error`.

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
        return self._scales.time

    @property
    def force_scale(self) -> np.ndarray:
        return self._scales.force

    @functools.cached_property
    def _scales(self) -> similarity.Scales:
        return similarity.scales(self.parameters)

    @property
    def descriptors(self) -> Mapping[str, np.ndarray]:
        return similarity.descriptors(self.parameters)

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
