"""What a section of the benchmark is given, and what it returns."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

# Floating-point operations of the arithmetic for an arm of three modules: an RK4 step of the plant,
# and a step of AFSMC. A plain C program that computes four arms a vector takes so long for the
# plant, and for both [s]; its AFSMC omits the map from Q to tau. They were measured on another day.
PLANT_OPERATIONS, LAW_OPERATIONS = 1936, 2185
C_PLANT, C_LOOP = 0.25e-6, 0.66e-6


class LeftOut(Exception):
    """A section that cannot run without an extra of octarm; its text says which."""

    def __init__(self, extra: str, needed_by: str) -> None:
        """The extra, and what needs it."""
        super().__init__(f"left out: {needed_by} needs pip install 'octarm[{extra}]'")


class Row(NamedTuple):
    """One figure.

    Attributes:
        name: what was measured.
        value: the figure.
        unit: its unit; 1 for a ratio.
        at_most: what it should not exceed; None where nothing is asked.
        at_least: what it should reach; likewise.
    """

    name: str
    value: float
    unit: str
    at_most: float | None = None
    at_least: float | None = None

    @property
    def target(self) -> str:
        """What is asked of it, as words; empty where nothing is."""
        bounds = (("at most", self.at_most), ("at least", self.at_least))
        return ", ".join(f"{words} {bound:g}" for words, bound in bounds if bound is not None)

    @property
    def met(self) -> bool | None:
        """Whether it is what was asked; None where nothing is."""
        if not self.target:
            return None
        low = -math.inf if self.at_least is None else self.at_least
        high = math.inf if self.at_most is None else self.at_most
        return bool(low <= self.value <= high)


class Settings(NamedTuple):
    """How much to measure.

    Attributes:
        arms: number of arms in a batch.
        seconds: the measure of how long a section takes [s]; each says how many of them it needs.
        episodes: of the largest sweep.
    """

    arms: int
    seconds: float
    episodes: int


Section = Callable[[Settings], list[Row]]


def fastest(calls: Sequence[Callable[[], object]], seconds: float) -> list[float]:
    """The shortest time that each call took [s], in turns, so that all meet the same machine."""
    best = [math.inf] * len(calls)
    end = time.perf_counter() + seconds * len(calls)
    while time.perf_counter() < end:
        for i, call in enumerate(calls):
            begun = time.perf_counter()
            call()
            best[i] = min(best[i], time.perf_counter() - begun)
    return best


def clocks() -> np.ndarray:
    """Wall time, and time that all threads of this process have computed, shape (2,) [s]."""
    return np.array([time.perf_counter(), time.process_time()])
