"""The arm that a named reference is to suit: how it hangs, and how far and how fast it can move."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from octarm.arm.lagrange import equilibrium, stiffness_matrix
from octarm.arm.modes import rates
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import reach
from octarm.errors import OctarmError

# Amplitudes, lengths and frequencies are declared for arms like the nominal one: modules of 120 mm
# that can be held at twice these sizes, and whose lowest mode is no slower.
_BEND = 1.0  # [rad]
_SLIDE, _STRAIN = 0.06, 0.5  # [m], of a rest length [1]
_LOWEST = 2.4  # [Hz]


class Hanging(NamedTuple):
    """An arm, or arms side by side, as references begin with it.

    Attributes:
        rest: the pose in which it hangs, shape (..., 2N) [m], [rad].
        arm: its parameters, with the batch axes of `rest` or none; when None, all sizes are those
            of the nominal arm.
    """

    rest: np.ndarray
    arm: ArmParameters | None = None

    @property
    def modules(self) -> int:
        """Number of modules N."""
        return self.rest.shape[-1] // 2

    def bend(self) -> np.ndarray:
        """The size of bends, relative to the nominal arm's, shape () or (..., 1) [1].

        Half of the bend at which all modules can be held alike, and 1 rad at most.
        """
        held = self._each(lambda arm: np.min(np.abs(reach(arm).alike)))
        return np.minimum(1.0, held / (2.0 * _BEND))

    def slide(self) -> np.ndarray:
        """The size of each slide, relative to the nominal arm's, shape () or (..., N) [1].

        Half of what its inputs stretch a module by, and half of its rest length at most.
        """
        if self.arm is None:
            return np.ones(())
        strain = np.minimum(_STRAIN, 0.5 * self._each(_held_strain))
        return self.arm.rest_length * strain / _SLIDE

    def pace(self) -> np.ndarray:
        """The size of frequencies near the lowest mode, shape () or (..., 1) [1]; 1 at most."""
        slowest = self._each(lambda arm: np.min(np.abs(rates(arm, equilibrium(arm)))))
        return np.minimum(1.0, slowest / (2.0 * np.pi) / _LOWEST)

    def parameters(self) -> ArmParameters:
        """Those of one arm, the nominal ones when none are given; OctarmError for other arms."""
        from octarm.arm.mjcf import nominal_parameters  # which imports MuJoCo

        arm = nominal_parameters() if self.arm is None else self.arm
        if arm.batch_shape or self.rest.shape != (arm.coordinates,):
            raise OctarmError(
                f"the pose at rest has shape {self.rest.shape}; a path of the tip needs one arm, "
                "or several that are alike, and its parameters"
            )
        return arm

    def _each(self, function: Callable[[ArmParameters], Any]) -> np.ndarray:
        """A function of each arm, shape (), or (..., k); infinity without parameters."""
        if self.arm is None:
            return np.array(np.inf)
        if not self.arm.batch_shape:
            return np.asarray(function(self.arm))
        rows = [np.atleast_1d(function(self.arm.arm(i))) for i in range(len(self.rest))]
        return np.stack(rows)


def _held_strain(arm: ArmParameters) -> np.ndarray:
    """By how much both columns of each module stretch or shorten it, shape (N,) [1]."""
    force = np.max(np.abs(arm.input_bounds(())), axis=0).reshape(-1, 2).sum(axis=-1)
    axial = np.diagonal(stiffness_matrix(arm))[: arm.modules]
    return force / (axial * arm.rest_length)
