"""What a sweep on the analytic arm shows for it: some of its episodes, run again on MuJoCo.

Both engines take the same steps and differ by rounding: where the loop is stable, tips are within
1e-9 m of each other. A law that switches on sgn(s) may switch a period earlier or later once
rounding decides, which is worth some micrometres. A loop that is not stable, and an engine that is
wrong, show more than `LIMIT`.
"""

from __future__ import annotations

import math

import numpy as np

from octarm.arm.kinematics import tip
from octarm.disturbances.streams import stream
from octarm.interfaces import Instant
from octarm.simulation.engines import LAGRANGE
from octarm.sweeps.plan import Plan

LIMIT = 1e-4  # distance of tips [m]
COLUMN = "engine_difference"

_SHARE = 0.01  # of the episodes; one at least
_ROWS = 2000  # instants of an episode that are compared, about


def checked_episodes(plan: Plan) -> np.ndarray:
    """The episodes that are run again, shape (k,): drawn by the seed of the sweep, in order.

    There are none unless the engine is the analytic arm.
    """
    if plan.spec.engine != LAGRANGE:
        return np.empty(0, dtype=np.int64)
    draw = stream(np.random.SeedSequence(plan.spec.seed), "engine check")
    count = math.ceil(_SHARE * plan.episodes)
    return np.sort(draw.choice(plan.episodes, size=count, replace=False, shuffle=False))


class TipPaths:
    """Where the tips of some arms of a batch are; an observer of `simulate`."""

    def __init__(self, arms: np.ndarray, periods: int) -> None:
        """The paths of arms with these places in the batch, shape (k,), in a run of so long."""
        self._arms, self._stride, self._count = arms, max(1, periods // _ROWS), 0
        self._rows: list[tuple[float, np.ndarray]] = []

    def __call__(self, instant: Instant) -> None:
        """Takes a control instant."""
        if self._count % self._stride == 0:
            q = instant.q if instant.plant_q is None else instant.plant_q
            path = np.stack(tip(q[self._arms]), axis=-1)
            self._rows.append((instant.measurement.t, path))
        self._count += 1

    def difference(
        self, other: TipPaths, diverged_at: np.ndarray, other_diverged_at: np.ndarray
    ) -> np.ndarray:
        """The largest distance of the tips until either run of an arm diverged, shape (k,) [m].

        It is infinite where one of them diverged [s] and the other, NaN, did not.
        """
        end = np.fmin(diverged_at, other_diverged_at)
        largest = np.zeros(len(self._arms))
        for (t, one), (_, two) in zip(self._rows, other._rows, strict=False):
            distance = np.hypot(*np.moveaxis(one - two, -1, 0))
            largest = np.where(t >= end, largest, np.maximum(largest, distance))
        return np.where(np.isnan(diverged_at) != np.isnan(other_diverged_at), np.inf, largest)


def sentence(difference: np.ndarray, episodes: int) -> str:
    """What the check of a sweep of so many episodes has shown, shape (k,) [m]."""
    beyond = f", beyond the limit of {LIMIT:g} m" if np.any(difference > LIMIT) else ""
    return (
        f"{len(difference)} of {episodes} episodes ran on MuJoCo as well as on lagrange: "
        f"tips are at most {np.max(difference):.2g} m apart{beyond}."
    )
