"""The errors of chains over the number of modules: their orders, limits, checks and table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from octarm.tolerances import Check

MODULES = (1, 2, 3, 5, 10, 20, 40)

# Weights of the errors at N = 10, 20, 40 that leave out the terms 1/N and 1/N^2, or 1/N^2 and
# 1/N^4; and the error that may be left, of the order 1/N^3 or 1/N^6.
_ENDLESS = {1: np.array([1.0, -6.0, 8.0]) / 3.0, 2: np.array([1.0, -20.0, 64.0]) / 45.0}
_LEFT = {1: 2e-4, 2: 1e-6}
_CLOSE = 0.15  # of an observed order to that of theory


class Curve(NamedTuple):
    """The errors of one quantity over the number of modules.

    Attributes:
        case: what is compared.
        layout: of the chains.
        errors: relative to the rod's value, at each of MODULES, shape (7,) [1]; NaN where a chain
            has no such quantity. Those of a motion are distances in lengths of the rod.
        order: at which they vanish; 0 where they are zero, None where terms cancel up to N = 40.
        signed: whether errors have a sign, so that they can be extrapolated.
    """

    case: str
    layout: str
    errors: np.ndarray
    order: int | None
    signed: bool = True

    @property
    def observed(self) -> float:
        """The order between the two largest numbers of modules [1]."""
        return float(np.log2(np.abs(self.errors[-2] / self.errors[-1])))

    @property
    def endless(self) -> float:
        """The error to which those of the three largest numbers of modules tend [1]."""
        return float(_ENDLESS[self.order or 1] @ self.errors[-3:])

    def needed(self, error: float) -> int:
        """The number of modules from which on errors are at most `error` [1].

        Between MODULES by straight lines in logarithmic scales, beyond them by the order.
        """
        size = np.abs(self.errors)
        above = np.flatnonzero(~(size <= error))
        if not above.size:
            return MODULES[0]
        i, slope = int(above[-1]), float(self.order or 1)
        if i < len(size) - 1:
            slope = math.log(size[i] / size[i + 1]) / math.log(MODULES[i + 1] / MODULES[i])
        return math.ceil(MODULES[i] * (size[i] / error) ** (1.0 / slope) * (1.0 - 1e-9))

    def checks(self) -> Iterator[Check]:
        """The order, and what errors tend to; or that they are zero."""
        what = f"{self.case}, {self.layout}"
        if self.order == 0:
            yield Check(f"{what}: largest error", float(np.max(np.abs(self.errors))), 1e-9)
            return
        if self.order is not None:
            low, high = self.order - _CLOSE, self.order + _CLOSE
            yield Check(f"{what}: order", self.observed, high, low)
        if self.signed:
            left = _LEFT[self.order or 1]
            yield Check(f"{what}: error, extrapolated", abs(self.endless), left)

    def to_dict(self) -> dict[str, Any]:
        """The errors for JSON; None where there is none."""
        errors = [None if math.isnan(x) else float(x) for x in self.errors]
        return {"case": self.case, "layout": self.layout, "error": errors}


def table(curves: Sequence[Curve]) -> str:
    """The errors of all curves in percent, observed orders, and how many modules are enough."""
    head = ("error [%] at N =", "layout", *map(str, MODULES), "order", "5 % from", "1 % from")
    rows = [head, *map(_row, curves)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines: list[str] = []
    for row in rows:
        cells = [text.rjust(width) for text, width in zip(row, widths, strict=True)]
        cells[:2] = [text.ljust(width) for text, width in zip(row[:2], widths[:2], strict=True)]
        lines.append("  ".join(cells))
    return "\n".join(lines)


def _row(curve: Curve) -> tuple[str, ...]:
    """The line of a curve in the table of errors."""
    errors = ["-" if math.isnan(x) else _percent(x) for x in curve.errors]
    zero = curve.order == 0
    order = "-" if zero or curve.order is None else f"{curve.observed:.2f}"
    needed = ["1" if zero else str(curve.needed(x)) for x in (0.05, 0.01)]
    return (curve.case, curve.layout, *errors, order, *needed)


def _percent(error: float) -> str:
    """An error in percent, to three digits at most."""
    percent = 100.0 * error
    if abs(percent) < 0.005:
        return "0"
    return f"{percent:.{0 if abs(percent) >= 99.5 else 1 if abs(percent) >= 9.95 else 2}f}"
