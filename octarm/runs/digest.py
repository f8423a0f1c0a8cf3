"""A number that stands for a motion, bit by bit."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from octarm.errors import OctarmError
from octarm.interfaces import Instant

CHECKPOINTS = 20  # instants of a run at which the number is kept

_START = np.uint64(0x9E3779B97F4A7C15)
_FACTOR = np.uint64(0xD6E8FEB86659FD93)


class StateDigest:
    """64 bits for each arm, into which the states of all control instants go.

    Any bit of any q or v counts, and so does their order. The number of an arm is the same alone
    and in a batch. It is an observer of `simulate`.

    Attributes:
        checkpoints: the number after the k-th of `CHECKPOINTS` equal parts of the run, each of
            shape (n,) of uint64; n is 1 for an arm alone.
    """

    def __init__(self, periods: int, intact: Callable[[], np.ndarray | bool] | None = None) -> None:
        """The digest of a run of so many control periods.

        `intact` gives the arms that have not diverged, shape (n,) of bool; all when not given.
        """
        self.checkpoints: list[np.ndarray] = []
        self._periods, self._count, self._intact = periods, 0, intact
        self._alive: np.ndarray | None = None
        self._value: np.ndarray | None = None

    def __call__(self, instant: Instant) -> None:
        """Takes up the true states of a control instant."""
        self.update(instant.q, instant.v, self._alive)
        if self._intact is not None:  # an arm that is lost in this period counts a last time
            alive = np.atleast_1d(self._intact())
            self._alive = None if alive.all() else alive

    def update(self, q: np.ndarray, v: np.ndarray, alive: np.ndarray | None = None) -> None:
        """Takes up the states at one instant, q and v of shape (2N,), or (n, 2N) for a batch.

        The number of arms that are not alive, shape (n,) of bool, stays as it is.
        """
        value = _mixed(q, 0)
        value += _mixed(v, q.shape[-1])
        before = np.full_like(value, _START) if self._value is None else self._value
        value ^= before
        value *= _FACTOR
        value ^= value >> np.uint64(29)
        self._value = value if alive is None else np.where(alive, value, before)
        self._count += 1
        while self._count * CHECKPOINTS >= (len(self.checkpoints) + 1) * self._periods:
            self.checkpoints.append(self._value)

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """The number, shape (n,), and the checkpoints, shape (n, CHECKPOINTS), of uint64.

        A run that ended early has its last number at the checkpoints that it did not reach.
        """
        if self._value is None:
            raise OctarmError("there is no digest of a run without a control instant")
        missing = CHECKPOINTS - len(self.checkpoints)
        return self._value, np.stack([*self.checkpoints, *[self._value] * missing], axis=-1)


def _mixed(x: np.ndarray, first: int) -> np.ndarray:
    """The bits of all coordinates in one number an arm, shape (n,) of uint64."""
    rows = np.ascontiguousarray(np.atleast_2d(x).T)  # arms last
    bits = rows.view(np.uint64)
    # Signs go to lower places first: a product keeps what is in the highest place there.
    mixed = bits >> np.uint64(32)
    mixed ^= bits
    mixed *= _weights(first, len(rows))[:, None]
    return np.add.reduce(mixed, axis=0)  # modulo 2^64: exact in any order


@functools.cache
def _weights(first: int, count: int) -> np.ndarray:
    """Odd numbers without a pattern, one for each place in the state."""
    x = (np.arange(first + 1, first + count + 1, dtype=np.uint64)) * _START
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (x ^ (x >> np.uint64(31))) | np.uint64(1)
