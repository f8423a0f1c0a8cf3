"""Tables of checks: every row says what, measured, allowed, pass or fail."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class Check:
    """One measured value against the smallest and the largest one allowed, all in one unit.

    An error has no smallest value; a ratio has the unit "1".
    """

    what: str
    measured: float
    high: float
    low: float = -np.inf
    unit: str = "1"

    @property
    def passed(self) -> bool:
        """Whether the measured value is allowed; NaN never is."""
        return bool(self.low <= self.measured <= self.high)

    @property
    def allowed(self) -> str:
        """The allowed range in words, without the unit."""
        if self.low == -np.inf:
            return f"<= {self.high:.2g}"
        return f"{self.low:.3g} .. {self.high:.3g}"

    def to_dict(self) -> dict[str, Any]:
        """The row for JSON; what is not finite becomes None."""
        numbers = {"measured": self.measured, "low": self.low, "high": self.high}
        finite = {k: float(x) if np.isfinite(x) else None for k, x in numbers.items()}
        return {"what": self.what, **finite, "unit": self.unit, "passed": self.passed}


@dataclasses.dataclass(frozen=True)
class CheckTable:
    """The outcome of a set of checks; as text, it is title, table and verdict.

    The parameters are those of the arm, as plain numbers and lists; the seed is that of so many
    random states and of motions.
    """

    title: str
    parameters: Mapping[str, Any]
    states: int
    seed: int
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every row passed."""
        return all(check.passed for check in self.checks)

    def to_dict(self) -> dict[str, Any]:
        """The table for JSON."""
        rows = [check.to_dict() for check in self.checks]
        return {"title": self.title, "passed": self.passed, **vars(self), "checks": rows}

    def __str__(self) -> str:
        rows = [("what", "measured", "allowed", "unit", "")]
        rows += [
            (c.what, f"{c.measured:.3g}", c.allowed, c.unit, "pass" if c.passed else "FAIL")
            for c in self.checks
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        failed = sum(not check.passed for check in self.checks)
        count = len(self.checks)
        verdict = f"{failed} of {count} checks FAILED" if failed else f"all {count} checks passed"
        return "\n".join([self.title, "", *lines, "", verdict])


def run_checks(
    parts: Mapping[str, Iterable[Check]], progress: Callable[[str], object] | None = None
) -> tuple[Check, ...]:
    """The rows of all parts of a table, by their names, in order; a generator does its work here.

    The progress is called with the name of each part before it starts.
    """
    checks: list[Check] = []
    for name, part in parts.items():
        if progress is not None:
            progress(name)
        checks += part
    return tuple(checks)
