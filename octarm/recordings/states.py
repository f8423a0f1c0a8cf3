"""In which state a run is, instant by instant: reaching or sliding, saturated, diverged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

COLORS = {  # of the states, as hexadecimal red, green, blue
    "running": "3E5C76",
    "reaching": "E0A030",
    "sliding": "48A06A",
    "free": "3E5C76",
    "saturated": "E05A4E",
    "diverged": "E03A3A",
    "interrupted": "8A6FBF",
}


class Event(NamedTuple):
    """A change of a lane: when [s], of which, and to what state; empty for none."""

    at: float
    lane: str
    state: str


class States:
    """Watches a run block by block and reports the changes of state, for each lane of a timeline.

    Of a controller with a robust part, `switching`, a coordinate is `sliding` while |s| <= phi;
    without a boundary layer it is from the instant at which s first has another sign than at the
    start. The inputs are `saturated` while one of them is at its limit.
    """

    def __init__(self, names: list[str], phi: np.ndarray | None, limit: np.ndarray | None) -> None:
        """Of coordinates by these names; phi [m/s], [rad/s] and the input limit [N] if known."""
        self._names, self._limit = names, limit
        self._phi = phi if phi is not None and np.all(phi > 0.0) else None
        self._sign: np.ndarray | None = None
        self._reached: np.ndarray | None = None
        self._last: dict[str, str] = {}

    def changes(
        self, tau: np.ndarray, signals: Mapping[str, np.ndarray]
    ) -> dict[str, list[tuple[int, str]]]:
        """Rows of this block at which a lane changes, and its new state.

        Args:
            tau: input forces, shape (k, 2N) [N].
            signals: the controller's, each of shape (k, ...).
        """
        flags: dict[str, tuple[np.ndarray, str, str]] = {}
        s = signals.get("s") if "switching" in signals else None  # else s is but a filtered error
        if s is not None and s.shape[1:] == (len(self._names),):
            inside = self._sliding(s)
            flags["surface"] = np.asarray(inside.all(axis=1)), "reaching", "sliding"
            for j, name in enumerate(self._names):
                flags[f"each/{name}"] = inside[:, j], "reaching", "sliding"
        if self._limit is not None and np.any(np.isfinite(self._limit)):
            full = np.any(np.abs(tau) >= self._limit, axis=1)
            flags["inputs"] = full, "free", "saturated"
        found = {lane: self._of(lane, *flag) for lane, flag in flags.items()}
        return {lane: changes for lane, changes in found.items() if changes}

    def _sliding(self, s: np.ndarray) -> np.ndarray:
        if self._phi is not None:
            return np.abs(s) <= self._phi
        sign, reached = self._sign, self._reached
        if sign is None or reached is None:
            sign, reached = np.sign(s[0]), np.zeros(s.shape[1], dtype=bool)
        there = np.logical_or.accumulate(s * sign <= 0.0, axis=0) | reached
        self._sign, self._reached = sign, there[-1]
        return there

    def _of(self, lane: str, flag: np.ndarray, off: str, on: str) -> list[tuple[int, str]]:
        before = self._last.get(lane)
        previous = np.concatenate([[not flag[0] if before is None else before == on], flag[:-1]])
        rows = np.flatnonzero(flag != previous)
        self._last[lane] = on if flag[-1] else off
        return [(int(row), on if flag[row] else off) for row in rows]


def events(disturbances: list[dict[str, Any]]) -> list[Event]:
    """What of the disturbances comes and goes, in the order of time."""
    found: list[Event] = []
    for entry in disturbances:
        asked = entry["asked"]
        size = next((v for v in asked.values() if isinstance(v, int | float)), None)
        start, length = asked.get("at"), asked.get("length", np.inf)
        if not isinstance(start, int | float) or not isinstance(length, int | float | str):
            continue
        text = entry["name"] if size is None else f"{entry['name']} {size:g}"
        found.append(Event(float(start), entry["name"], text))
        if np.isfinite(float(length)):
            found.append(Event(float(start) + float(length), entry["name"], ""))
    return sorted(found)
