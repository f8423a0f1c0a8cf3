"""What a desired motion, which may be a function of the user's, wants at an instant."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from octarm.errors import OctarmError, quoted
from octarm.interfaces import Motion, Reference

REAL = "fiu"  # NumPy's kinds of real numbers


def wanted(motion: Motion, t: float, shape: tuple[int, ...]) -> Reference:
    """What a desired motion, which may be a function of the user's, wants at a time t [s].

    Raises OctarmError unless the answer is a Reference of three arrays of finite numbers that
    broadcast to the shape of the coordinates, (..., 2N).
    """
    answer: Any = motion(t)
    if _plainly_right(answer, shape):
        return answer
    if type(answer) is not Reference:
        raise OctarmError(
            f"the reference answers {quoted(answer)} at t = {t:g} s; it must be a Reference of "
            "arrays q, v and a"
        )
    for name, part in zip(("q", "v", "a"), answer, strict=True):
        if type(part) is not np.ndarray or part.dtype.kind not in REAL:
            wrong = f"is {quoted(part)}; it must be an array of real numbers"
        elif part.shape != shape and not _broadcasts(part.shape, shape):
            wrong = f"has shape {part.shape}; it must be {shape}"
        elif not np.isfinite(part).all():
            wrong = f"holds {part[~np.isfinite(part)].flat[0]:g}; it must be finite"
        else:
            continue
        raise OctarmError(f"the reference's {name} at t = {t:g} s {wrong}")
    return answer


def _plainly_right(answer: Any, shape: tuple[int, ...]) -> bool:
    """Whether an answer for one arm, or for all alike, is right at a glance: it costs 1 us."""
    if type(answer) is not Reference:
        return False
    total = 0.0
    for part in answer:
        if type(part) is not np.ndarray or part.dtype.char != "d" or part.shape != shape[-1:]:
            return False
        total += sum(part.tolist())
    return math.isfinite(total)


def _broadcasts(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether arms may share coordinates of this shape; an arm has all of its coordinates."""
    try:
        return shape[-1:] == wanted[-1:] and np.broadcast_shapes(shape, wanted) == wanted
    except ValueError:
        return False
