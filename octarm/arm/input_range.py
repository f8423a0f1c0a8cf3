"""What the columns of an arm can give of a generalised force, within the range of their inputs."""

from __future__ import annotations

import numpy as np

from octarm.arm.actuation import GroundedActuation
from octarm.arm.parameters import ArmParameters


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
    """The largest absolute value of each coordinate, of all arms."""
    if x.ndim == 1:
        return [abs(value) for value in x.tolist()]
    return np.max(np.abs(x), axis=tuple(range(x.ndim - 1))).tolist()
