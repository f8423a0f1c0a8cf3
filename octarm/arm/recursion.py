"""Recursions along the arm, each written once, for numbers, and run in three ways.

A recursion is a function of rows of entries that writes its results into further rows. For one arm
an entry is a number of Python. For a batch it is an array over the arms; where the compiler numba
is loaded, as the engine `lagrange` does, the recursion runs in machine code instead, arm by arm.
All ways give the same bits: they take the same steps of IEEE 754 arithmetic in the same order.
Cosines and sines are computed before, by NumPy, since libraries round them differently.
"""

from __future__ import annotations

import functools
import sys
import types
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from octarm.arrays import Entry, split

Row = Sequence[Entry]
OutRow = Any  # a list of entries, or an array in compiled code


class Constants:
    """Rows of what does not change: arrays of shape (..., k), and for one arm lists of numbers."""

    def __init__(self, *arrays: np.ndarray) -> None:
        """Rows of one arm, or of a batch of arms."""
        self.arrays = arrays
        one = all(x.ndim == 1 for x in arrays)
        self.numbers = [x.tolist() for x in arrays] if one else None


class Recursion:
    """A function of rows as one of arrays of shape (..., k), whose batch axes broadcast."""

    def __init__(self, layout: str, function: Callable[..., None]) -> None:
        """A recursion with a layout such as "mnnmn->mn", a letter for the length of each row.

        The function gets the rows of q, of the cosines and sines of the plates that the modules
        stand on, of other inputs and of constants; then those of the result, and of what it needs
        to work with. It must be of the kind that numba compiles, and so must other functions of its
        module that it calls.
        """
        self._inputs, self._outputs = layout.split("->")
        self._like = [self._inputs.index(letter) for letter in self._outputs]
        self._function = function

    def __call__(self, constants: Constants, q: np.ndarray, *others: np.ndarray) -> np.ndarray:
        """The result, shape (..., k), in the memory order of q."""
        if constants.numbers is not None and {x.ndim for x in (q, *others)} == {1}:
            x = q.tolist()
            inputs = [x, *_plates(x), *[x.tolist() for x in others], *constants.numbers]
            numbers = [[0.0] * len(inputs[i]) for i in self._like]
            self._function(*inputs, *numbers)
            return np.array(numbers[0])
        arrays = (q, *plate_rows(q), *others, *constants.arrays)
        batch = np.broadcast_shapes(*{x.shape[:-1] for x in arrays})
        kind = np.result_type(*{x.dtype for x in arrays})
        results = [
            np.empty_like(q, shape=(*batch, arrays[i].shape[-1]), dtype=kind) for i in self._like
        ]
        if kind == np.float64 and "numba" in sys.modules:
            self._compiled(*arrays, *results)
        else:
            rows: list[list[Entry]] = [[0.0] * x.shape[-1] for x in results]
            self._function(*map(split, arrays), *rows)
            for i, entry in enumerate(rows[0]):
                results[0][..., i] = entry
        return results[0]

    @functools.cached_property
    def _compiled(self) -> Callable[..., Any]:
        """The same as a function of NumPy's kind that goes over the arms itself."""
        numba: Any = sys.modules["numba"]
        code, names = self._function.__code__, self._function.__globals__
        called = {
            name: numba.njit(names[name])
            for name in code.co_names
            if isinstance(names.get(name), types.FunctionType)
        }
        function = types.FunctionType(code, names | called, self._function.__name__)
        function.__module__ = self._function.__module__
        inputs, outputs = (
            ",".join(f"({x})" for x in rows) for rows in (self._inputs, self._outputs)
        )
        signature = f"void({', '.join(['f8[:]'] * len(self._inputs + self._outputs))})"
        compiled = functools.partial(numba.guvectorize, [signature], f"{inputs}->{outputs}")
        try:
            return compiled(cache=True)(function).ufunc
        except RuntimeError:  # neither this folder nor a home can be written
            return compiled()(function).ufunc


def plate_rows(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosines and sines of the plates that the modules stand on, each of shape (..., N) [1].

    They are read-only.
    """
    if q.ndim == 1:
        cos, sin = _plates(q.tolist())
        return np.array(cos), np.array(sin)
    bends = q[..., q.shape[-1] // 2 : -1].T
    return _kept_rows(bends.tobytes(), bends.dtype, bends.shape)


def _plates(q: list[float]) -> tuple[list[float], list[float]]:
    """The same for one arm."""
    cos, sin, angle = [1.0], [0.0], 0.0
    for theta in q[len(q) // 2 : -1]:
        angle = angle + theta
        cos.append(float(np.cos(angle)))
        sin.append(float(np.sin(angle)))
    return cos, sin


@functools.lru_cache(maxsize=4)  # a control period asks for the same ones several times
def _kept_rows(
    bends: bytes, kind: np.dtype[Any], shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Those of a batch, whose bends are an array (N - 1, ...) of this shape in C order."""
    cos = np.ones((shape[0] + 1, *shape[1:]), dtype=np.result_type(kind, 1.0))
    sin, angle = np.zeros_like(cos), 0.0
    for i, theta in enumerate(np.frombuffer(bends, kind).reshape(shape), 1):
        angle = angle + theta
        np.cos(angle, out=cos[i])
        np.sin(angle, out=sin[i])
    for x in (cos, sin):
        x.setflags(write=False)
    return cos.T, sin.T
