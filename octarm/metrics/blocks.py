"""Rows of a run, a block at a time, and the small tools with which accumulators take them up.

Whatever is said of a run must not depend on how the run was cut into blocks, nor on how many arms
were run side by side, not even in the last bit. Hence arithmetic is elementwise, largest values
and counts may be taken in any order, but sums over time are added up row after row. Accumulators
take up one row or more at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from octarm.errors import OctarmError
from octarm.interfaces import Rows

SETTLED_AFTER = 2.0  # [s]; what is said of the steady regime counts from here on


class Block(NamedTuple):
    """k consecutive control instants of one arm or a batch; row i is the instant t[i].

    The arrays are only read, and nothing keeps a reference to them: a loop may reuse their memory.
    For one arm the rows of all arrays have the shape (2N,); those of `q_d` may as well have the
    shape (1, 2N) when the arms of a batch share their reference.

    Attributes:
        t: time, shape (k,) [s].
        q: true coordinates, shape (k, ..., 2N) [m], [rad].
        q_d: desired coordinates, shape (k, ..., 2N) [m], [rad].
        tau: input forces that the actuators are asked for in the period that begins at t, shape
            (k, ..., 2N) [N].
        force: the controller's generalised force Q in that period, shape (k, ..., 2N) [N], [N m].
        signals: the controller's own quantities by name, each of shape (k, ..., its own axes).
    """

    t: np.ndarray
    q: np.ndarray
    q_d: np.ndarray
    tau: np.ndarray
    force: np.ndarray
    signals: Mapping[str, np.ndarray] = MappingProxyType({})

    @classmethod
    def of(cls, rows: Rows) -> Block:
        """A block of the fields that metrics know."""
        signals = {name: rows[name] for name in ("s", "reaching_bound") if name in rows}
        return cls(rows["t"], rows["q"], rows["q_d"], rows["tau"], rows["force"], signals)


def parts(block: Block, rows: int) -> Iterator[tuple[Block, bool]]:
    """The block in parts of a few rows at most, each with whether it is past `SETTLED_AFTER`."""
    settled = int(np.searchsorted(block.t, SETTLED_AFTER))
    for begin, end, steady in ((0, settled, False), (settled, len(block.t), True)):
        for start in range(begin, end, rows):
            yield _rows(block, slice(start, min(start + rows, end))), steady


def _rows(block: Block, cut: slice) -> Block:
    t, q, q_d, tau, force, signals = block
    part = {name: array[cut] for name, array in signals.items()}
    return Block(t[cut], q[cut], q_d[cut], tau[cut], force[cut], part)


def add_rows(total: np.ndarray, rows: np.ndarray) -> None:
    """Adds rows, shape (k, ...), to a total, shape (...), one after another."""
    for row in rows:
        total += row


def filled(name: str, value: npt.ArrayLike, like: np.ndarray) -> np.ndarray:
    """A value as an array of the shape and memory order of a row.

    Raises:
        ValueError: if it does not broadcast to that shape; `name` says whose it is.
    """
    out = np.empty_like(like)
    try:
        out[...] = value
    except ValueError:
        raise OctarmError(
            f"{name} has shape {np.shape(value)}; it must broadcast to {like.shape}"
        ) from None
    return out


class Before:
    """The row before each row, across blocks; the first of all counts as its own.

    Attributes:
        last: a copy of the last row so far; 0 before the first.
    """

    def __init__(self) -> None:
        self.last: np.ndarray | float = 0.0
        self._begun = False

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Rows of shape (k, ...), one instant earlier."""
        first = np.asarray(self.last) if self._begun else rows[0]
        self.last, self._begun = rows[-1].copy(order="K"), True
        if len(rows) == 1:
            return first[None]
        out = np.empty_like(rows)
        out[0] = first
        out[1:] = rows[:-1]
        return out


class Extremes:
    """Largest and smallest value so far.

    Attributes:
        largest: shape of a row; -inf before the first.
        smallest: likewise; +inf before the first.
    """

    def __init__(self, like: np.ndarray) -> None:
        self.largest = np.full_like(like, -np.inf)
        self.smallest = np.full_like(like, np.inf)

    def update(self, rows: np.ndarray) -> None:
        """Takes up rows of shape (k, ...)."""
        keep_largest(self.largest, rows)
        one = rows[0] if len(rows) == 1 else np.min(rows, axis=0)
        np.minimum(self.smallest, one, out=self.smallest)


def keep_largest(largest: np.ndarray, rows: np.ndarray) -> None:
    """Raises the values of `largest`, shape (...), to those of rows, shape (k, ...)."""
    one = rows[0] if len(rows) == 1 else np.max(rows, axis=0)
    np.maximum(largest, one, out=largest)


class Count:
    """How many rows were true."""

    def __init__(self, like: np.ndarray) -> None:
        self._total = np.zeros_like(like, dtype=np.int64)
        # Bytes are four times as fast to add up, as long as they cannot overflow.
        self._recent = np.zeros_like(like, dtype=np.uint8)
        self._pending = 0

    def update(self, rows: np.ndarray) -> None:
        """Takes up rows of bool, shape (k, ...)."""
        for row in rows.view(np.uint8):
            self._recent += row
            self._pending += 1
            if self._pending == 255:
                self._total += self._recent
                self._recent[...] = 0
                self._pending = 0

    def result(self) -> np.ndarray:
        """The number so far, shape of a row."""
        return self._total + self._recent


def first_true(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether any row is true, and the number of the first that is, both of shape (...)."""
    return np.any(rows, axis=0), np.argmax(rows, axis=0)
