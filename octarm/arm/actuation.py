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
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from octarm.arm.kinematics import plate_entries
from octarm.arrays import Entry, join, split


@dataclasses.dataclass(frozen=True)
class Actuation(abc.ABC):
    """How input forces act on the arm. Q has shape (..., 2N) [N], [N m], tau (..., 2N) [N].

    Attributes:
        width: distance l between the two columns of each module, shape (..., N) [m].
    """

    name: ClassVar[str]
    width: np.ndarray

    @functools.cached_property
    def _widths(self) -> Sequence[Entry]:
        return split(self.width)

    @functools.cached_property
    def _levers(self) -> Sequence[Entry]:
        return split(0.5 * self.width)

    @abc.abstractmethod
    def force(self, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Q = F(q) tau, with q of shape (..., 2N) [m], [rad]."""

    @abc.abstractmethod
    def inputs(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """tau = F(q)^-1 Q, with q of shape (..., 2N) [m], [rad]."""

    @abc.abstractmethod
    def ctrl(self, tau: np.ndarray) -> np.ndarray:
        """`ctrl` of the model under tau, shape (..., 4N - 2) [N].

        It is tau for the motors on the columns, and then for those that put the reactions of the
        modules from the second on the ground, which bears those of the first one anyway.
        """

    def _joined(self, entries: Sequence[Entry], like: np.ndarray, other: np.ndarray) -> np.ndarray:
        return join(entries, like, other.shape, (*self.width.shape[:-1], len(entries)))


class InternalActuation(Actuation):
    """A column pushes neighbouring modules apart: Q = T tau with T constant.

    Column a of module i acts on s_i with its force and on theta_i with +-l/2 times it.
    """

    name: ClassVar[str] = "internal"

    def force(self, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        inputs, half = split(tau), self._levers
        lefts, rights = inputs[0::2], inputs[1::2]
        out = [left + right for left, right in zip(lefts, rights, strict=True)]
        out += [x * (left - right) for x, left, right in zip(half, lefts, rights, strict=True)]
        return self._joined(out, tau, q)

    def inputs(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        n, wanted, out = force.shape[-1] // 2, split(force), list[Entry]()
        for push, couple, width in zip(wanted[:n], wanted[n:], self._widths, strict=True):
            half, turn = 0.5 * push, couple / width
            out += [half + turn, half - turn]
        return self._joined(out, force, q)

    def ctrl(self, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([tau, np.zeros_like(tau[..., 2:])], axis=-1)


class GroundedActuation(Actuation):
    """The paper's F_coeff, eq (2): forces and couples that react on the ground.

    The two inputs of module i push its end along the axis of module i-1's plate, and turn it by
    +-l/2 times their force. The inverse is a back-substitution from the tip.
    """

    name: ClassVar[str] = "f-coeff"

    def force(self, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        n = q.shape[-1] // 2
        s, axes = split(q), plate_entries(q)
        inputs, half = split(tau), self._levers
        out: list[Entry] = [0.0] * (2 * n)
        fx = fy = moment = 0.0  # that module i carries
        for i in reversed(range(n)):
            if i + 1 < n:
                moment = carried_moment(moment, s[i + 1], axes[i + 1], fx, fy)
            cos, sin = axes[i]
            left, right = inputs[2 * i], inputs[2 * i + 1]
            push = left + right
            fx, fy = fx + push * cos, fy + push * sin
            moment = moment + half[i] * (left - right)
            out[i], out[n + i] = cos * fx + sin * fy, moment
        return self._joined(out, q, tau)

    def inputs(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        n: int = q.shape[-1] // 2
        s, axes = split(q), plate_entries(q)
        wanted, width = split(force), self._widths
        out: list[Entry] = [0.0] * (2 * n)
        fx = fy = along = carried = 0.0  # force and moment of the modules below
        for i in reversed(range(n)):
            push = wanted[i] - along
            half, turn = 0.5 * push, (wanted[n + i] - carried) / width[i]
            out[2 * i], out[2 * i + 1] = half + turn, half - turn
            if i > 0:
                (cos, sin), (cos_above, sin_above) = axes[i], axes[i - 1]
                fx, fy = fx + push * cos, fy + push * sin
                along = cos_above * fx + sin_above * fy
                carried = carried_moment(wanted[n + i], s[i], axes[i], fx, fy)
        return self._joined(out, q, force)

    def ctrl(self, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([tau, tau[..., 2:]], axis=-1)


def carried_moment(
    moment: Entry, length: Entry, axis: tuple[Entry, Entry], fx: Entry, fy: Entry
) -> Entry:
    """The moment [N m] at the beginning of a module, of a moment and a force at its end.

    Entries of shape (...): moment [N m], length [m], the module's axis (cos, sin), force [N].
    """
    cos, sin = axis
    return moment + length * (cos * fy - sin * fx)


ACTUATIONS: dict[str, type[Actuation]] = {
    kind.name: kind for kind in (GroundedActuation, InternalActuation)
}
