"""Robustness margins: how far something may grow before an error bound is broken.

Each seed has a margin of its own. The bound is tried on a coarse grid of values, the same for all
seeds, and then within the gap between the last one that met it and the first one that did not, of
every seed at once, until that is small. Where the grid shows that the bound is met again further
on, that is reported, and the margin is that of the first failure.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from dm_control.rl import control
from scipy.stats import binom

from octarm.arm.parameters import ArmParameters
from octarm.disturbances.varied import NOMINAL, Varied
from octarm.errors import OctarmError, closest, quoted
from octarm.interfaces import Controller, ControllerFactory
from octarm.memory import check_batch
from octarm.metrics.metric import SETTLED_AFTER, unsettled
from octarm.metrics.table import METRICS, Catalogue
from octarm.simulation.engines import usual_engine
from octarm.simulation.setup import Setup
from octarm.sweeps.progress import arm_seconds
from octarm.sweeps.shards import measure

_POINTS = 3  # values that are tried within a gap at a time
_SMALLEST = 1e-5  # gap, in shares of the way, that is never made smaller


class Attempt(NamedTuple):
    """What came of some arms.

    Attributes:
        excess: the measure over its bound, the largest of several, shape (n,) [1]; the bound is met
            up to 1. Infinite for an arm that diverged.
        digest: a number that stands for the motion, shape (n,).
    """

    excess: np.ndarray
    digest: np.ndarray


# Runs seeds at shares of the way from the low to the high value, both of shape (n,).
Try = Callable[[np.ndarray, np.ndarray], Attempt]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Brackets:
    """Between which shares of the way from the low to the high value the bound is broken.

    Attributes:
        met: the largest share that met it, all smaller ones that were tried included, shape (n,);
            -inf where not even the low value did.
        failed: the smallest one that did not, shape (n,); inf where the high value met it.
        again: whether a larger share met it again, shape (n,).
        grid: the shares of the coarse grid, shape (k,).
        excess: what came of them, shape (n, k).
        alike: whether all seeds gave the same motion on the grid; the rest is then that of the
            first.
    """

    met: np.ndarray
    failed: np.ndarray
    again: np.ndarray
    grid: np.ndarray
    excess: np.ndarray
    alike: bool

    @property
    def margins(self) -> np.ndarray:
        """The margin of each seed: `met`, or inf where the high value met the bound, shape (n,)."""
        return np.where(np.isinf(self.failed), np.inf, self.met)


def search(attempt: Try, seeds: int, *, intervals: int = 8, resolution: float = 0.01) -> Brackets:
    """The brackets of seeds 0, 1, ..; that of a seed does not depend on the other seeds.

    The gap between `met` and `failed` becomes at most the resolution, a share of `failed` [1].
    """
    grid = np.arange(intervals + 1) / intervals
    tried = attempt(np.repeat(np.arange(seeds), len(grid)), np.tile(grid, seeds))
    excess, digest = (np.reshape(x, (seeds, len(grid))) for x in tried)
    alike = seeds > 1 and bool(np.all(digest == digest[0]))
    n = 1 if alike else seeds
    met, failed, again = np.full(n, -np.inf), np.full(n, np.inf), np.zeros(n, dtype=bool)
    which, shares, good = np.arange(n), np.tile(grid, (n, 1)), excess[:n] <= 1.0
    part = np.arange(1, _POINTS + 1) / (_POINTS + 1)
    while len(which):
        for i, row, fine in zip(which, shares, good, strict=True):
            first = int(np.argmin(fine)) if not fine.all() else len(row)  # that failed
            again[i] |= bool(fine[first:].any())
            if first > 0:
                met[i] = row[first - 1]
            if first < len(row):
                failed[i] = row[first]
        gap = failed - met
        wide = np.isfinite(gap) & (gap > np.maximum(resolution * failed, _SMALLEST))
        which = np.flatnonzero(wide)
        if len(which):
            shares = met[which, None] + gap[which, None] * part
            tried = attempt(np.repeat(which, _POINTS), shares.ravel())
            good = np.reshape(tried.excess, shares.shape) <= 1.0
    met, failed, again = (np.resize(x, seeds) for x in (met, failed, again))
    return Brackets(met=met, failed=failed, again=again, grid=grid, excess=excess, alike=alike)


class Margin(NamedTuple):
    """A margin of all seeds, in shares of the way; inf: beyond the high value, -inf: below the low.

    It is the largest that so many of the seeds bear. The ends of its confidence interval are NaN
    where the seeds cannot carry one.
    """

    value: float
    low: float
    high: float


def margin_of(brackets: Brackets, share: float, confidence: float = 0.95) -> Margin:
    """The largest value that a share [1] of the seeds bears, with an interval of order statistics.

    The margin is a quantile of those of the seeds: of n of them, Bin(n, 1 - share) are below it,
    whatever their distribution. So the r-th smallest is above it with P(Bin <= r - 1), the s-th
    below it with P(Bin >= s), and the ends are those two that leave at most half of what is missing
    in the confidence [1] on either side. The interval holds the margin in at least `confidence` of
    all samples. There is no end where `seeds_needed` is larger than the number of seeds, and none
    when all of them are alike. It says nothing of the gap of the search, which `resolution` bounds.
    """
    margins = np.sort(brackets.margins)
    n, tail = len(margins), 0.5 * (1.0 - confidence)
    value = float(margins[n - max(1, math.ceil(share * n - 1e-9))])
    if brackets.alike:
        return Margin(value, math.nan, math.nan)
    ranks = np.arange(1, n + 1)
    allowed = tail * (1.0 + 1e-12)  # up to rounding
    lows = margins[binom.cdf(ranks - 1, n, 1.0 - share) <= allowed]
    highs = margins[binom.sf(ranks - 1, n, 1.0 - share) <= allowed]
    return Margin(value, float(max(lows, default=math.nan)), float(min(highs, default=math.nan)))


def seeds_needed(share: float, confidence: float = 0.95) -> tuple[float, float]:
    """Numbers of seeds from which an interval of `margin_of` has a lower and an upper end [1].

    Infinite where no number is enough.
    """
    tail = 0.5 * (1.0 - confidence)
    low, high = (
        math.inf if part == 1.0 else max(1, math.ceil(math.log(tail) / math.log(part) - 1e-9))
        for part in (share, 1.0 - share or tail)
    )
    return low, high


# Not finite also for an arm that has done nothing wrong but be slow.
_NEVER = ("settling_time", "reaching_time")


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class MarginRuns(Setup):
    """Runs of one controller with other values of what varies, seed by seed; see `Try`.

    The seeds are those of a sweep with the same `seed`, and the same for every controller and
    value. See `octarm.load` for what is not said here.

    Attributes:
        factory: makes the controller from its nominal model.
        bounds: metrics, and what their absolute values may be at most, all of them.
        disturbances: what acts in addition; `engine` is the fastest that is installed if not given.
        mismatch: of the controller's nominal model [1].
        nominal: further factors on parameters of that model, by name, each likewise [1].
        duration: of a run [s].
        settle: when metrics of the steady regime begin [s].
        model: what the controller believes but for errors; the true arm if None.
        progress: called with the seconds that were simulated since the last call, all arms counted.
    """

    factory: ControllerFactory
    varied: Varied
    bounds: Sequence[tuple[str, float]]
    mismatch: float = 0.0
    nominal: Mapping[str, npt.ArrayLike] = dataclasses.field(default_factory=dict[str, float])
    duration: float = 6.0
    settle: float = SETTLED_AFTER
    engine: str = dataclasses.field(default_factory=usual_engine)
    model: ArmParameters | None = None
    seed: int = 0
    threads: int = 1
    catalogue: Catalogue = dataclasses.field(default_factory=lambda: METRICS)
    progress: Callable[[float], object] = lambda seconds: None

    def rehearse(self, seeds: int = 1) -> MarginRuns:
        """The same runs for so many seeds, whose physics step, if `auto`, has become a number.

        Raises OctarmError if a control period at both ends of the range fails.
        """
        ends = np.array([0.0, 1.0])
        modules = self.plant_modules or self.parameters.modules
        check_batch(9 * seeds, modules)  # on the coarse grid
        environment, controller = self._begin(np.repeat(np.arange(seeds), 2), np.tile(ends, seeds))
        period = environment.control_timestep()
        known = measure(environment, controller, period, catalogue=self.catalogue).metrics
        for metric, _ in self.bounds:
            if metric not in known:
                stem = re.sub(r"_(s|theta|tau)\d+$", "", metric)
                alike = [name for name in known if name.startswith(stem)]
                meant = closest(metric, alike or known)
                raise OctarmError(f"there is no measure {quoted(metric)} of such a run{meant}")
        if not isinstance(self.timestep, str):
            return self
        step = environment.physics.timestep()
        return dataclasses.replace(self, timestep=step, control_period=period)

    def __call__(self, seeds: np.ndarray, shares: np.ndarray) -> Attempt:
        """The runs of these seeds at these shares of the way, both of shape (n,).

        Raises OctarmError if there is no number for a metric, although arms bore it all.
        """
        environment, controller = self._begin(seeds, shares)
        with arm_seconds(environment, self.duration, self.progress) as seconds:
            outcome = measure(
                environment,
                controller,
                self.duration,
                seconds,
                catalogue=self.catalogue,
                settle=self.settle,
            )
        excess = np.zeros(len(seeds))
        for metric, limit in self.bounds:
            size = np.abs(outcome.metrics[metric])
            missing = np.isnan(size)
            lost = outcome.diverged.all() or metric.startswith(_NEVER)
            if missing.all() and not lost:
                why = unsettled(self.duration, self.settle)
                raise OctarmError(
                    f"{metric} has no value in a run of {self.duration:g} s{why and f'; {why}'}"
                )
            np.maximum(excess, np.where(missing, np.inf, size / limit), out=excess)
        return Attempt(excess, outcome.digest)

    def _begin(
        self, seeds: np.ndarray, shares: np.ndarray
    ) -> tuple[control.Environment, Controller]:
        values = self.varied.at(shares)
        model = self.parameters if self.model is None else self.model
        environment = self.load(
            model,
            disturbances=[*self.disturbances, *self.varied.of(values)],
            batch=len(seeds),
            seed=[np.random.SeedSequence(self.seed, spawn_key=(i,)) for i in seeds.tolist()],
            threads=self.threads,
        )
        mismatch = values if self.varied.name == NOMINAL else self.mismatch
        believed = model.mismatched(mismatch).scaled(**self.nominal)
        return environment, self.factory(believed)
