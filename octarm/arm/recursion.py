"""Recursions along the arm, each written once, for numbers, and run in three ways.

A recursion is a function of rows of entries that writes its results into further rows. For one arm
an entry is a number of Python. For a batch it is an array over the arms; where the compiler numba
is loaded, as the engine `lagrange` does, the recursion runs in machine code instead, arm by arm.
All ways give the same bits: they take the same steps of IEEE 754 arithmetic in the same order.
Cosines and sines are computed before, by NumPy, since libraries round them differently.
"""

from __future__ import annotations

import functools
import importlib
import sys
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octarm.arrays import Entry, cos_sin, split
from octarm.errors import OctarmError

Row = Sequence[Entry]
_PATIENCE = 60.0  # [s] that another process may take to compile
OutRow = Any  # a list of entries, or an array in compiled code

# How many entries a row has, by its name: m is 2N, g is 1, b is N or 0. Others have N.
_LENGTHS: dict[str, str] = {
    **dict.fromkeys(["q", "v", "a", "v_r", "tau", "force"], "m"),
    **dict.fromkeys(["k_s", "k_t", "c_s", "c_t"], "b"),
    **dict.fromkeys(["gravity", "energy"], "g"),
}


class Constants:
    """Rows of what does not change: arrays of shape (..., k), and for one arm lists of numbers."""

    def __init__(self, *arrays: np.ndarray) -> None:
        """Rows of one arm, or of a batch of arms; the first row has N entries."""
        self.arrays = arrays
        self.batch_shape = np.broadcast_shapes(*(x.shape[:-1] for x in arrays))
        self.coordinates = 2 * arrays[0].shape[-1]
        self.numbers = None if self.batch_shape else [x.tolist() for x in arrays]


class Recursion:
    """A function of rows as one of arrays of shape (..., k), whose batch axes broadcast."""

    def __init__(self, function: Callable[..., None]) -> None:
        """A recursion by a function of positional rows, whose names say their lengths.

        They are q; the cosines and sines of the plates that the modules stand on, if it asks for
        `cos` and `sin`; other inputs; constants; then the results, annotated as `OutRow`: the
        first one is returned, the others are to work with. The function must be of the kind that
        numba compiles, and so must other functions of its module that it calls.
        """
        code = function.__code__
        names = code.co_varnames[: code.co_argcount]
        letters = "".join(_LENGTHS.get(name, "n") for name in names)
        count = [function.__annotations__[name] for name in names].count("OutRow")
        self._function, self._bent = function, "cos" in names
        self._names = [name for name in names if name not in ("cos", "sin")]
        self._inputs, self._outputs = letters[:-count], letters[-count:]
        self._like = [self._inputs.index(letter) for letter in self._outputs]

    def __call__(self, constants: Constants, q: np.ndarray, *others: np.ndarray) -> np.ndarray:
        """The first result, shape (..., k), in the memory order of q.

        The inputs have shape (..., 2N). Raises OctarmError if the last axis of one has not.
        """
        shape, one = (constants.coordinates,), True
        for i, x in enumerate((q, *others)):
            if x.shape != shape:
                check_coordinates(self._names[i], x, constants.coordinates)
                one = False
        if one and constants.numbers is not None:
            return self._of_one(constants.numbers, q, others)
        arrays = (q, *(plate_rows(q) if self._bent else ()), *others, *constants.arrays)
        batch, *more = {constants.batch_shape, *(x.shape[:-1] for x in (q, *others))}
        if more:
            batch = np.broadcast_shapes(batch, *more)
        kind = np.result_type(np.float64, *{x.dtype for x in (q, *others)})
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

    def _of_one(
        self, constants: list[list[float]], q: np.ndarray, others: Sequence[np.ndarray]
    ) -> np.ndarray:
        x = q.tolist()
        plates = _plates(*x[len(x) // 2 : -1]) if self._bent else ()
        inputs = [x, *plates, *[y.tolist() for y in others], *constants]
        results = [[0.0] * len(inputs[i]) for i in self._like]
        self._function(*inputs, *results)
        return np.array(results[0])

    @functools.cached_property
    def _compiled(self) -> Callable[..., Any]:
        """The same as a function of NumPy's kind that goes over the arms itself."""
        numba: Any = importlib.import_module("numba")
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
        layout = f"{inputs}->{outputs}"

        def compiler(**options: bool) -> Callable[[Any], Any]:
            return lambda function: (
                numba.guvectorize([signature], layout, **options)(function).ufunc
            )

        return kept(compiler, function)


def check_coordinates(name: str, array: np.ndarray, coordinates: int) -> None:
    """Raises OctarmError unless an array has the shape (..., coordinates)."""
    if array.shape[-1:] != (coordinates,):
        raise OctarmError(
            f"{name} has shape {array.shape}; its last axis must hold {coordinates} coordinates "
            f"for {coordinates // 2} modules"
        )


def kept(compiler: Callable[..., Any], function: Callable[..., Any]) -> Any:
    """A function as one of numba's compilers has it, kept on disk where that can be written.

    What a compiler keeps may be two files, which only fit together if the same process has written
    both: a call that does not find its other half ends the process. So processes wait for each
    other here, which helps with compilers that compile at once, such as `guvectorize`.
    """
    from filelock import FileLock  # which loads asyncio

    caching: Any = importlib.import_module("numba.core.caching")
    registry: Any = importlib.import_module("numba.core.registry")
    registry.cpu_target.target_context.refresh()  # it takes longest, and nobody has to wait for it
    try:
        folder = caching.FunctionCache(function).cache_path
        with FileLock(Path(folder) / "octarm.lock", timeout=_PATIENCE, mode=0o666):
            return compiler(cache=True)(function)
    except (RuntimeError, OSError):  # it cannot be written or locked
        return compiler()(function)


def plate_rows(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosines and sines of the plates that the modules stand on, each of shape (..., N) [1].

    Those of a batch are read-only.
    """
    bends = q[..., q.shape[-1] // 2 : -1]
    if q.ndim == 1:
        cos, sin = _plates(*bends.tolist())
        return np.array(cos), np.array(sin)
    bends = bends.T
    return _kept_rows(bends.tobytes(), bends.dtype, bends.shape)


# A control period asks for the same ones several times.
@functools.lru_cache(maxsize=4, typed=True)
def _plates(*bends: float) -> tuple[list[Entry], list[Entry]]:
    """Those of one arm, not to be changed; the bends are of all modules but the last [rad]."""
    cos: list[Entry] = [1.0]
    sin: list[Entry] = [0.0]
    angle = 0.0
    for theta in bends:
        angle = angle + theta
        c, s = cos_sin(angle)
        cos.append(c)
        sin.append(s)
    return cos, sin


@functools.lru_cache(maxsize=4)
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
