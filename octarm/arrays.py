"""Small tools for arrays that carry coordinates on the last axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from octarm.errors import OctarmError, quoted

Entry = np.ndarray | float


def split(x: np.ndarray) -> Sequence[Entry]:
    """The entries of the last axis of an array of shape (..., k).

    They are floats for one arm, views of shape (...) for a batch. Arithmetic on an entry is then
    elementwise along the batch, and as fast as it can be for one arm. Both give the same bits.
    """
    return x.tolist() if x.ndim == 1 else [x[..., i] for i in range(x.shape[-1])]


def entry(x: np.ndarray | float) -> Entry:
    """A float for one arm, the array of shape (...) for a batch."""
    return float(x) if np.ndim(x) == 0 else x


def join(entries: Sequence[Entry], like: np.ndarray, *shapes: tuple[int, ...]) -> np.ndarray:
    """The array of shape (..., k) whose last axis has these entries; the inverse of `split`.

    For a batch it has the memory order of the array `like`, whose batch axes it has, and those of
    arrays of other shapes.
    """
    if like.ndim == 1 and sum(map(len, shapes)) == len(shapes):  # none has a batch axis
        return np.array(entries)
    others = [other for other in shapes if other != like.shape]
    shape = np.broadcast_shapes(like.shape, *others) if others else like.shape
    out = np.empty_like(like, shape=shape, dtype=np.result_type(like, 1.0))
    for i, value in enumerate(entries):
        out[..., i] = value
    return out


def added_up(x: np.ndarray, axis: int) -> np.ndarray:
    """The sum of an array of shape (.., k, .., n) along an axis of k entries, in order.

    The arms, n of them, are last. One arm gets the bits of a batch: NumPy adds rows one after
    another as long as these have several entries, which is much faster than to accumulate them.
    """
    if x.shape[-1] > 1:
        return np.add.reduce(np.ascontiguousarray(x), axis=axis)
    return np.add.accumulate(x, axis=axis).take(-1, axis)


def stacked(row: np.ndarray, count: int) -> np.ndarray:
    """Memory for rows like this one, each contiguous along the arms, shape (count, ...)."""
    backwards = np.empty((count, *row.shape[::-1]), dtype=row.dtype)
    return backwards.transpose(0, *range(row.ndim, 0, -1))


def cos_sin(angle: Entry) -> tuple[Entry, Entry]:
    """Cosine and sine [1] of a number or an array of shape (...) [rad].

    By the same NumPy loops for one arm and a batch, so that both get the same bits.
    """
    cos, sin = np.cos(angle), np.sin(angle)
    return (float(cos), float(sin)) if isinstance(angle, float) else (cos, sin)


def coordinate_names(modules: int) -> list[str]:
    """Names of the coordinates in the paper's order: s1..sN, theta1..thetaN."""
    return [f"{kind}{i}" for kind in ("s", "theta") for i in range(1, modules + 1)]


def coordinate_units(modules: int) -> list[str]:
    """Units of the coordinates in the same order: m for slides, rad for bends."""
    return ["m"] * modules + ["rad"] * modules


class Coordinates(NamedTuple):
    """Names and units of an arm's coordinates in the order of q, and names of its inputs tau.

    Attributes:
        groups: where the coordinates of one kind stand in q, by the name of the group; they share a
            unit and a scale, and are plotted together, group below group.
    """

    names: Sequence[str]
    units: Sequence[str]
    groups: Mapping[str, slice]
    inputs: Sequence[str]


def planar_coordinates(modules: int) -> Coordinates:
    """Those of the planar arm: q = [s1..sN, theta1..thetaN], and two columns for each module."""
    return Coordinates(
        names=coordinate_names(modules),
        units=coordinate_units(modules),
        groups={"bends": slice(modules, 2 * modules), "slides": slice(modules)},
        inputs=[f"column_{a}_{i}" for i in range(1, modules + 1) for a in (1, 2)],
    )


def read_only(
    name: str, value: npt.ArrayLike, *, unbounded: bool = False, unbounded_below: bool = False
) -> np.ndarray:
    """A read-only float64 copy, of the shape of the value; `name` is for errors.

    Raises OctarmError if it is not made of finite numbers; infinity may be allowed at either end.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise OctarmError(f"{name} is {quoted(value)}; it must be made of numbers") from None
    good = np.isfinite(array) | (unbounded & np.isposinf(array))
    good |= unbounded_below & np.isneginf(array)
    if not np.all(good):
        raise OctarmError(f"{name} holds {array[~good].flat[0]:g}; it must be finite")
    array.setflags(write=False)
    return array


def plain(value: Any) -> Any:
    """Arrays as lists, and infinity, which JSON lacks, as a word that `read_only` understands."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in cast("Sequence[Any]", value)]
    return str(value) if isinstance(value, float) and not np.isfinite(value) else value
