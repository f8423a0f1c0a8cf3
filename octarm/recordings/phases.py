"""The phases of a run, instant by instant: reaching or sliding, inputs free or saturated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octarm.interfaces import Rows

COLORS = {  # of the phases and of how a run ends, as hexadecimal red, green, blue
    "running": "3E5C76",
    "reaching": "E0A030",
    "sliding": "48A06A",
    "free": "3E5C76",
    "saturated": "E05A4E",
    "diverged": "E03A3A",
    "interrupted": "8A6FBF",
}


class Phases:
    """Watches a run block by block and reports the changes of phase, lane by lane.

    If the controller has a robust part, the signal `switching`, a coordinate is `sliding` while
    |s| <= phi; without a boundary layer it slides from the instant at which s first has another
    sign than at the start. The lane `surface` is `sliding` while all coordinates are; `each/theta1`
    is the lane of one. The lane `inputs` is `saturated` while one input is at its limit.
    """

    def __init__(
        self, names: Sequence[str], layer: np.ndarray | None, limit: np.ndarray | None
    ) -> None:
        """Starts before the first row of a run.

        Args:
            names: of the coordinates.
            layer: half width phi of the boundary layer, shape (2N,) [m/s], [rad/s], if there is
                one.
            limit: of the inputs, shape (2N,) [N], if there is one.
        """
        self._names, self._layer, self._limit = names, layer, limit
        self._start: np.ndarray | None = None  # sign of s
        self._reached = np.zeros(len(names), dtype=bool)
        self._last: dict[str, bool] = {}

    def changes(self, rows: Rows) -> dict[str, list[tuple[int, str]]]:
        """The rows of this block at which a lane changes and its phase from there on, by lane."""
        changes: dict[str, list[tuple[int, str]]] = {}

        def add(lane: str, flags: np.ndarray, words: tuple[str, str]) -> None:
            last = self._last.get(lane, not flags[0])
            self._last[lane] = bool(flags[-1])
            at = np.flatnonzero(flags != np.concatenate([[last], flags[:-1]]))
            if at.size:
                changes[lane] = [(int(row), words[int(flags[row])]) for row in at]

        s = rows.get("s") if "switching" in rows else None  # else s is only a filtered error
        if s is not None and s.shape[1:] == (len(self._names),):
            sliding = self._sliding(s)
            add("surface", np.all(sliding, axis=1, keepdims=True)[:, 0], ("reaching", "sliding"))
            for name, flags in zip(self._names, sliding.T, strict=True):
                add(f"each/{name}", flags, ("reaching", "sliding"))
        if self._limit is not None:
            full = np.any(np.abs(rows["tau"]) >= self._limit, axis=1)
            add("inputs", full, ("free", "saturated"))
        return changes

    def _sliding(self, s: np.ndarray) -> np.ndarray:
        """Whether each coordinate slides, for s of shape (k, 2N)."""
        if self._layer is not None:
            return np.abs(s) <= self._layer
        if self._start is None:
            self._start = np.sign(s[0])
        reached = np.logical_or.accumulate(s * self._start <= 0.0, axis=0) | self._reached
        self._reached = reached[-1]
        return reached
