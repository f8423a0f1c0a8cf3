"""What a section of the benchmark is given, how it takes times, and what it returns."""

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from dm_control.rl import control

from octarm.interfaces import Controller, Instant
from octarm.simulation.rollout import Observer, simulate

# Floating-point operations of the arithmetic for an arm of three modules: an RK4 step of the plant,
# and a step of AFSMC. A plain C program that computes four arms a vector takes so long for the
# plant, and for both [s]; its AFSMC omits the map from Q to tau. They were measured on another day.
PLANT_OPERATIONS, LAW_OPERATIONS = 1936, 2185
C_PLANT, C_LOOP = 0.25e-6, 0.66e-6
FEWEST = 3  # turns


class LeftOut(Exception):
    """A section that cannot run without an extra of octarm; its text says which."""

    def __init__(self, extra: str, needed_by: str) -> None:
        """The extra, and what needs it."""
        super().__init__(f"left out: {needed_by} needs pip install 'octarm[{extra}]'")


class Row(NamedTuple):
    """One figure."""

    name: str  # what was measured
    value: float
    unit: str  # 1 for a ratio
    at_most: float | None = None  # what it should not exceed; None where nothing is asked
    at_least: float | None = None  # what it should reach; likewise

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
    """How much to measure."""

    arms: int  # in a batch
    seconds: float  # the measure of how long a section takes; each says how many of them [s]
    episodes: int  # of the largest sweep


def ratios(law: str, what: str, by_clock: Sequence[float], least: float | None) -> list[Row]:
    """How many times faster a law is, by both of `clocks`."""
    wall, computed = by_clock
    return [
        Row(f"{law}, {what}", wall, "1", at_least=least),
        Row(f"{law}, by processor time", computed, "1", at_least=least),
    ]


def clocks() -> np.ndarray:
    """Wall time, and time that all threads of this process have computed, shape (2,) [s]."""
    return np.array([time.perf_counter(), time.process_time()])


def duration_of(call: Callable[[], object]) -> np.ndarray:
    """How long it takes, by `clocks` [s]."""
    begun = clocks()
    call()
    return clocks() - begun


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


class _TimeIsUp(Exception):
    """Ends a measurement."""


def turns(
    environment: control.Environment, controller: Controller, duration: float, observer: Observer,
    rival: Callable[[], object], periods: int, seconds: float,
) -> np.ndarray:  # fmt: skip
    """How long a loop takes for so many control periods, and after each of them a rival's call.

    The loop simulates a duration [s], or ends when it was measured for so many seconds. The first
    turn warms up and is left out: by `clocks`, shape (turns, 2, 2) [s].
    """
    times: list[tuple[np.ndarray, np.ndarray]] = []
    count, end, begun = 0, time.perf_counter() + seconds, clocks()

    def observe(instant: Instant) -> None:
        nonlocal count, begun
        observer(instant)
        count += 1
        if count % periods == 0:
            times.append((clocks() - begun, duration_of(rival)))
            if len(times) > FEWEST and time.perf_counter() > end:
                raise _TimeIsUp
            begun = clocks()

    with contextlib.suppress(_TimeIsUp):
        simulate(environment, controller, duration, observe)
    return np.array(times[1:])
