"""Small tools with which accumulators take a run, a few rows at a time.

A result must not depend on how the run was cut into blocks of rows, nor on how many arms were run
side by side, not even in the last bit. Hence arithmetic is elementwise, largest values and counts
may be taken in any order, but sums over time are added row after row.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from octarm.errors import OctarmError

_FEW = 30  # numbers of a row; calls for every row would cost more than the arithmetic


def add_rows(total: np.ndarray, rows: np.ndarray) -> None:
    """Adds rows, shape (k, ...), to a total, shape (...), one after another."""
    if len(rows) > 1 and total.size <= _FEW:
        total[...] = np.add.accumulate(np.concatenate([total[None], rows]))[-1]
        return
    for row in rows:
        total += row


def filled(name: str, value: npt.ArrayLike, like: np.ndarray) -> np.ndarray:
    """A value as an array of the shape and memory order of a row, shape (...).

    Raises OctarmError if it does not broadcast to that shape; the sentence begins with `name`.
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
    """The row before each row, across blocks; the first row of all stands before itself.

    Attributes:
        last: a copy of the last row so far, shape of a row; None before the first.
    """

    last: np.ndarray | None = None

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Rows of shape (k, ...), one instant earlier."""
        first = rows[0] if self.last is None else self.last
        self.last = rows[-1].copy(order="K")
        if len(rows) == 1:
            return first[None]
        out = np.empty_like(rows)
        out[0] = first
        out[1:] = rows[:-1]
        return out


class Size:
    """Root mean square and largest absolute value of rows, from their squares."""

    def __init__(self, like: np.ndarray) -> None:
        self._rows = 0
        self._sum, self._largest = np.zeros_like(like), np.zeros_like(like)

    def update(self, squares: np.ndarray) -> None:
        """Takes the squares of rows, shape (k, ...)."""
        self._rows += len(squares)
        add_rows(self._sum, squares)
        keep_largest(self._largest, squares)

    def root(self) -> np.ndarray:
        """The root mean square so far, shape of a row; NaN without a row."""
        return np.sqrt(self._sum / (self._rows or math.nan))

    def peak(self) -> np.ndarray:
        """The largest so far, shape of a row; NaN without a row. sqrt(x^2) is exactly |x|."""
        return np.sqrt(self._largest * (1.0 if self._rows else math.nan))


class Extremes:
    """Largest and smallest value so far, shape of a row; infinite before the first."""

    def __init__(self, like: np.ndarray) -> None:
        self.largest = np.full_like(like, -np.inf)
        self.smallest = np.full_like(like, np.inf)

    def update(self, rows: np.ndarray) -> None:
        """Takes rows of shape (k, ...)."""
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
        """Takes rows of bool, shape (k, ...)."""
        for start in range(0, len(rows), 255):
            part = rows[start : start + 255].view(np.uint8)
            self._pending += len(part)
            if self._pending > 255:
                self._total += self._recent
                self._recent[...] = 0
                self._pending = len(part)
            self._recent += np.add.reduce(part, axis=0, dtype=np.uint8)

    def result(self) -> np.ndarray:
        """The number so far, shape of a row."""
        return self._total + self._recent
