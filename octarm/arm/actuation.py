"""From the actuators' input forces tau to the generalised force Q = F(q) tau, and back.

tau has shape (..., 2N) in the column order of eq (2): module 1 columns 1 and 2, module 2 columns
1 and 2, and so on. Both maps here have determinant +-l^N, so both can always be inverted. They work
by recursion along the arm, one arithmetic operation an element, so that an arm's result does not
depend on the batch it is in. The motors of the model exert F(q) tau themselves: the maps are for
those who want a Q and ask for its tau.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
from typing import ClassVar

import numpy as np

from octarm.arm.recursion import Constants, OutRow, Recursion, Row
from octarm.arrays import Entry


@dataclasses.dataclass(frozen=True)
class Actuation(abc.ABC):
    """How input forces act on the arm. Q has shape (..., 2N) [N], [N m], tau (..., 2N) [N].

    Attributes:
        width: distance l between the two columns of each module, shape (..., N) [m].
    """

    name: ClassVar[str]
    width: np.ndarray

    _force: ClassVar[Recursion]
    _inputs: ClassVar[Recursion]

    @functools.cached_property
    def _constants(self) -> Constants:
        return Constants(self.width)

    def force(self, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Q = F(q) tau, with q of shape (..., 2N) [m], [rad]."""
        return self._force(self._constants, q, tau)

    def inputs(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """tau = F(q)^-1 Q, with q of shape (..., 2N) [m], [rad]."""
        return self._inputs(self._constants, q, force)

    @abc.abstractmethod
    def ctrl(self, tau: np.ndarray) -> np.ndarray:
        """`ctrl` of the model under tau, shape (..., 4N - 2) [N].

        It is tau for the motors on the columns, and then for those that put the reactions of the
        modules from the second on the ground, which bears those of the first one anyway.
        """


def carried_moment(
    moment: Entry, length: Entry, cos: Entry, sin: Entry, fx: Entry, fy: Entry
) -> Entry:
    """The moment [N m] at the beginning of a module, of a moment and a force at its end.

    Entries of shape (...): moment [N m], length [m], the module's axis (cos, sin), force [N].
    """
    return moment + length * (cos * fy - sin * fx)


def _internal_force(q: Row, tau: Row, width: Row, force: OutRow) -> None:
    n = len(width)
    for i in range(n):
        left, right = tau[2 * i], tau[2 * i + 1]
        force[i], force[n + i] = left + right, 0.5 * width[i] * (left - right)


def _internal_inputs(q: Row, force: Row, width: Row, tau: OutRow) -> None:
    n = len(width)
    for i in range(n):
        half, turn = 0.5 * force[i], force[n + i] / width[i]
        tau[2 * i], tau[2 * i + 1] = half + turn, half - turn


def _grounded_force(q: Row, cos: Row, sin: Row, tau: Row, width: Row, force: OutRow) -> None:
    n = len(width)
    fx = fy = moment = 0.0  # that module i carries
    for i in range(n - 1, -1, -1):
        if i + 1 < n:
            moment = carried_moment(moment, q[i + 1], cos[i + 1], sin[i + 1], fx, fy)
        left, right = tau[2 * i], tau[2 * i + 1]
        push = left + right
        fx, fy = fx + push * cos[i], fy + push * sin[i]
        moment = moment + 0.5 * width[i] * (left - right)
        force[i], force[n + i] = cos[i] * fx + sin[i] * fy, moment


def _grounded_inputs(q: Row, cos: Row, sin: Row, force: Row, width: Row, tau: OutRow) -> None:
    n = len(width)
    fx = fy = along = carried = 0.0  # force and moment of the modules below
    for i in range(n - 1, -1, -1):
        push = force[i] - along
        half, turn = 0.5 * push, (force[n + i] - carried) / width[i]
        tau[2 * i], tau[2 * i + 1] = half + turn, half - turn
        if i > 0:
            fx, fy = fx + push * cos[i], fy + push * sin[i]
            along = cos[i - 1] * fx + sin[i - 1] * fy
            carried = carried_moment(force[n + i], q[i], cos[i], sin[i], fx, fy)


class InternalActuation(Actuation):
    """A column pushes neighbouring modules apart: Q = T tau with T constant.

    Column a of module i acts on s_i with its force and on theta_i with +-l/2 times it.
    """

    name: ClassVar[str] = "internal"
    _force = Recursion(_internal_force)
    _inputs = Recursion(_internal_inputs)

    def ctrl(self, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([tau, np.zeros_like(tau[..., 2:])], axis=-1)


class GroundedActuation(Actuation):
    """The paper's F_coeff, eq (2): forces and couples that react on the ground.

    The two inputs of module i push its end along the axis of module i-1's plate, and turn it by
    +-l/2 times their force. The inverse is a back-substitution from the tip.
    """

    name: ClassVar[str] = "f-coeff"
    _force = Recursion(_grounded_force)
    _inputs = Recursion(_grounded_inputs)

    def ctrl(self, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([tau, tau[..., 2:]], axis=-1)


ACTUATIONS: dict[str, type[Actuation]] = {
    kind.name: kind for kind in (GroundedActuation, InternalActuation)
}
