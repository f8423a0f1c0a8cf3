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

from octarm.arm.groups import PAPER, SUMS, grouped
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import DISTURBANCES, first_field, parse_disturbance
from octarm.errors import OctarmError, closest, quoted
from octarm.interfaces import Controller, ControllerFactory
from octarm.memory import check_batch
from octarm.metrics.metric import SETTLED_AFTER, unsettled
from octarm.metrics.table import METRICS, Catalogue
from octarm.simulation.engines import usual_engine
from octarm.simulation.environment import load
from octarm.sweeps.progress import arm_seconds
from octarm.sweeps.shards import measure
from octarm.units import ANY, number

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
    low, high = (float(x[i]) if len(x) else math.nan for x, i in ((lows, -1), (highs, 0)))
    return Margin(value, low, high)


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


NOMINAL = "nominal-mismatch"  # of the controller's model, as --mismatch of octarm run
_NOMINAL_RANGE = (0.0, 3.0)

# Not finite also for an arm that has done nothing wrong but be slow.
_NEVER = ("settling_time", "reaching_time")


def parse_bound(text: str) -> tuple[str, float]:
    """A metric and what its absolute value may be at most, from METRIC:VALUE."""
    metric, _, value = text.partition(":")
    if not value:
        raise OctarmError(f"bound is {quoted(text)}; it must read METRIC:VALUE")
    declared = [m for name, m in METRICS.items() if f"{metric}_".startswith(f"{name}_")]
    unit = " or ".join(declared[-1].units) if declared else ANY  # a user's own may have any
    limit = number(f"bound of {metric}", value, unit)
    if not 0.0 < limit < math.inf:
        raise OctarmError(f"bound of {metric} is {limit:g}; it must be positive and finite")
    return metric, limit


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Varied:
    """What varies: a disturbance by its first field, or `nominal-mismatch`.

    Attributes:
        low: value at which the bound should be met; need not be the smaller one.
        high: value up to which it is tried.
        disturbance: the one whose first field varies; None for `nominal-mismatch`.
    """

    name: str
    low: float
    high: float
    unit: str = "1"
    disturbance: Disturbance | None = None

    def at(self, share: np.ndarray | float) -> np.ndarray:
        """The values at shares of the way from low to high, shape (...); infinity stays so."""
        way = np.asarray(share)
        return np.where(np.isfinite(way), self.low + way * (self.high - self.low), way)

    def of(self, values: np.ndarray) -> list[Disturbance]:
        """The disturbance with a value an arm, shape (n,), if it is one."""
        if self.disturbance is None:
            return []
        field, kind = first_field(type(self.disturbance))
        each = values[:, None] if kind.each else values
        return [dataclasses.replace(self.disturbance, **{field: each})]  # pyright: ignore


def is_varied(text: str) -> bool:
    """Whether a disturbance is spelt without its value, NAME or NAME:KEY=VALUE,.."""
    first = DISTURBANCES.split(text).rest.partition(",")[0]
    return not first or "=" in first


def parse_varied(text: str, low: float | str | None, high: float | str | None) -> Varied:
    """What varies, from NAME or NAME:KEY=VALUE,..; `low` and `high` are usual ones when None.

    Texts are numbers with a unit, such as "60ms". Raises OctarmError for what is unknown or not
    allowed.
    """
    name, _, rest = text.partition(":")
    if name != NOMINAL:
        name, rest = DISTURBANCES.split(text)
    if ":" not in name and name not in (NOMINAL, *(known := DISTURBANCES.names())):
        raise OctarmError(f"unknown disturbance {quoted(name)}{closest(name, (NOMINAL, *known))}")
    usual = usual_range(name)
    if usual is None and None in (low, high):
        raise OctarmError(f"{name} has no usual range; give --low, a value to bear, and --high")
    of_value = "1" if name == NOMINAL else first_field(DISTURBANCES[name])[1].unit
    low, high = (
        number(end, given, of_value)
        if isinstance(given, str)
        else default
        if given is None
        else given
        for end, given, default in zip(
            ("low", "high"), (low, high), usual or (math.nan, math.nan), strict=True
        )
    )
    if not (math.isfinite(low) and math.isfinite(high) and low != high):
        raise OctarmError(f"low is {low:g} and high {high:g}; they must be two finite numbers")
    if name == NOMINAL:
        if rest:
            raise OctarmError(f"{NOMINAL} has no keys; {quoted(rest)} is given")
        for value in (low, high):
            nominal_parameters().mismatched(value)  # raises
        return Varied(name=name, low=low, high=high)
    texts = [f"{name}:{value!r}{',' + rest if rest else ''}" for value in (low, high)]
    at_low, _ = (parse_disturbance(text) for text in texts)
    return Varied(name=at_low.name, low=low, high=high, unit=of_value, disturbance=at_low)


def usual_range(name: str) -> tuple[float, float] | None:
    """Where the search begins and ends when it is not said, in the unit of the values."""
    return _NOMINAL_RANGE if name == NOMINAL else first_field(DISTURBANCES[name])[1].usual


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class MarginRuns:
    """Runs of one controller with other values of what varies, seed by seed; see `Try`.

    The seeds are those of a sweep with the same `seed`, and the same for every controller and
    value. See `octarm.load` for what is not said here.

    Attributes:
        factory: makes the controller from its nominal model.
        bounds: metrics, and what their absolute values may be at most, all of them.
        disturbances: what acts in addition.
        mismatch: of the controller's nominal model [1].
        nominal: further factors on parameters of that model, by name, each likewise [1].
        duration: of a run [s].
        settle: when metrics of the steady regime begin [s].
        parameters: the true arm, and the controller's model of it but for its errors.
        progress: called with the seconds that were simulated since the last call, all arms counted.
    """

    factory: ControllerFactory
    varied: Varied
    bounds: Sequence[tuple[str, float]]
    disturbances: Sequence[Disturbance] = ()
    mismatch: float = 0.0
    nominal: Mapping[str, npt.ArrayLike] = dataclasses.field(default_factory=dict[str, float])
    reference: str = "sine"
    duration: float = 6.0
    settle: float = SETTLED_AFTER
    timestep: float | str | None = None
    control_period: float | None = None
    engine: str = dataclasses.field(default_factory=usual_engine)
    parameters: ArmParameters = dataclasses.field(default_factory=nominal_parameters)
    model: ArmParameters | None = None
    plant_modules: int | None = None
    layout: str = PAPER
    sensing: str = SUMS
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
        environment = load(
            self.reference,
            disturbances=[*self.disturbances, *self.varied.of(values)],
            batch=len(seeds),
            seed=[np.random.SeedSequence(self.seed, spawn_key=(i,)) for i in seeds.tolist()],
            timestep=self.timestep,
            control_period=self.control_period,
            threads=self.threads,
            engine=self.engine,
            parameters=self.parameters,
            plant_modules=self.plant_modules,
            layout=self.layout,
            sensing=self.sensing,
            groups=grouped(self.parameters, model),
        )
        mismatch = values if self.varied.name == NOMINAL else self.mismatch
        believed = model.mismatched(mismatch).scaled(**self.nominal)
        return environment, self.factory(believed)
