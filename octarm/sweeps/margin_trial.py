"""What a robustness margin is sought of, and the runs that it takes."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from dm_control.rl import control

from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import DISTURBANCES, first_field, parse_disturbance
from octarm.errors import OctarmError, closest
from octarm.interfaces import Controller, Instant
from octarm.simulation.environment import load
from octarm.simulation.rollout import simulate
from octarm.sweeps.margin import Outcome
from octarm.sweeps.shards import Observer

NOMINAL = "nominal-mismatch"  # of the controller's model, as --mismatch of octarm run

NOMINAL_RANGE = (0.0, 3.0)  # where its search begins and ends when nothing else is said

# Not finite also for an arm that has done nothing wrong but be slow.
_NEVER = ("settling_time", "reaching_time")


class Bound(NamedTuple):
    """A measure and what its absolute value may be at most."""

    metric: str
    limit: float


def parse_bound(text: str) -> Bound:
    """A bound from METRIC:VALUE.

    Raises:
        ValueError: if it does not read so.
    """
    metric, _, value = text.partition(":")
    try:
        limit = float(value)
    except ValueError:
        raise OctarmError(f"bound is {text!r}; it must read METRIC:VALUE") from None
    if not 0.0 < limit < math.inf:
        raise OctarmError(f"bound of {metric} is {limit:g}; it must be positive and finite")
    return Bound(metric, limit)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Varied:
    """What varies, and between which values.

    Attributes:
        name: of a disturbance, or `nominal-mismatch`.
        low: value at which the bound should be met; need not be the smaller one.
        high: value up to which it is tried.
        unit: of the values.
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
        own = values[:, None] if kind.each else values
        return [dataclasses.replace(self.disturbance, **{field: own})]  # pyright: ignore


def is_varied(text: str) -> bool:
    """Whether a disturbance is spelt without its value, NAME or NAME:KEY=VALUE,.."""
    first = text.partition(":")[2].partition(",")[0]
    return not first or "=" in first


def parse_varied(text: str, low: float | None, high: float | None) -> Varied:
    """What varies, from NAME or NAME:KEY=VALUE,..; `low` and `high` are usual ones when None.

    Raises:
        ValueError: for an unknown name or key, or values that are not allowed.
    """
    name, _, rest = text.partition(":")
    if name not in (NOMINAL, *DISTURBANCES):
        raise OctarmError(f"unknown disturbance {name!r}{closest(name, (NOMINAL, *DISTURBANCES))}")
    usual = NOMINAL_RANGE if name == NOMINAL else first_field(DISTURBANCES[name])[1].usual
    if usual is None and None in (low, high):
        raise OctarmError(f"{name} has no usual range; give --low, a value to bear, and --high")
    low, high = (
        given if given is not None else default
        for given, default in zip((low, high), usual or (math.nan, math.nan), strict=True)
    )
    if not (math.isfinite(low) and math.isfinite(high) and low != high):
        raise OctarmError(f"low is {low:g} and high {high:g}; they must be two finite numbers")
    if name == NOMINAL:
        if rest:
            raise OctarmError(f"{NOMINAL} has no keys; {rest!r} is given")
        for value in (low, high):
            nominal_parameters().mismatched(value)  # raises
        return Varied(name=name, low=low, high=high)
    texts = [f"{name}:{value!r}{',' + rest if rest else ''}" for value in (low, high)]
    at_low, _ = (parse_disturbance(text) for text in texts)
    _, kind = first_field(type(at_low))
    return Varied(name=name, low=low, high=high, unit=kind.unit, disturbance=at_low)


def _ignore(seconds: float) -> None:
    del seconds


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Runs of one controller with other values of what varies, seed by seed; see `Try`.

    The seeds are those of a sweep with the same `seed`, and the same for every controller and
    value.

    Attributes:
        factory: makes the controller from its nominal model.
        varied: what varies.
        bounds: that have to be met, all of them.
        disturbances: what acts beside it.
        mismatch: of the controller's nominal model [1].
        reference: name of the desired motion.
        duration: of a run [s].
        timestep: physics step [s]; that of models/octarm.xml when None.
        control_period: time between control actions [s]; one physics step when None.
        seed: of all that is random.
        threads: that step a batch.
        progress: called with the seconds that were simulated since the last call, all arms counted.
    """

    factory: Callable[[ArmParameters], Controller]
    varied: Varied
    bounds: Sequence[Bound]
    disturbances: Sequence[Disturbance] = ()
    mismatch: float = 0.0
    reference: str = "sine"
    duration: float = 6.0
    timestep: float | None = None
    control_period: float | None = None
    seed: int = 0
    threads: int = 1
    progress: Callable[[float], object] = _ignore

    def rehearse(self) -> None:
        """Tries the ends of the range for one control period.

        Raises:
            ValueError: if something cannot be made, or a measure is unknown.
        """
        environment, controller = self._begin(np.zeros(2, dtype=int), np.array([0.0, 1.0]))
        period = environment.control_timestep()
        observer = Observer(environment, controller, period)
        simulate(environment, controller, period, observer)
        known = observer.metrics(diverged=np.zeros(2, dtype=bool))
        for bound in self.bounds:
            if bound.metric not in known:
                stem = re.sub(r"_(s|theta|tau)\d+$", "", bound.metric)
                alike = [name for name in known if name.startswith(stem)]
                meant = closest(bound.metric, alike or known)
                raise OctarmError(f"there is no measure {bound.metric!r} of such a run{meant}")

    def __call__(self, seeds: np.ndarray, shares: np.ndarray) -> Outcome:
        """The runs of these seeds at these shares of the way, both of shape (n,).

        Raises:
            ValueError: if there is no number for a measure, although arms bore it all.
        """
        environment, controller = self._begin(seeds, shares)
        observer = Observer(environment, controller, self.duration)
        period, arms = environment.control_timestep(), len(seeds)
        left = self.duration

        def observe(instant: Instant) -> None:
            nonlocal left
            observer(instant)
            left -= period
            self.progress(arms * period)

        simulate(environment, controller, self.duration, observe)
        self.progress(arms * left)  # what was not needed as all arms diverged
        diverged = ~np.isnan(environment.physics.diverged_at())
        measures = observer.metrics(diverged)
        excess = np.zeros(arms)
        for bound in self.bounds:
            size = np.abs(measures[bound.metric])
            missing = np.isnan(size)
            if missing.all() and not diverged.all() and not bound.metric.startswith(_NEVER):
                raise OctarmError(f"{bound.metric} has no value in a run of {self.duration:g} s")
            np.maximum(excess, np.where(missing, np.inf, size / bound.limit), out=excess)
        return Outcome(excess, observer.digest.result()[0])

    def _begin(
        self, seeds: np.ndarray, shares: np.ndarray
    ) -> tuple[control.Environment, Controller]:
        values = self.varied.at(shares)
        environment = load(
            self.reference,
            disturbances=[*self.disturbances, *self.varied.of(values)],
            batch=len(seeds),
            seed=[np.random.SeedSequence(self.seed, spawn_key=(i,)) for i in seeds.tolist()],
            timestep=self.timestep,
            control_period=self.control_period,
            threads=self.threads,
        )
        mismatch = values if self.varied.name == NOMINAL else self.mismatch
        return environment, self.factory(nominal_parameters().mismatched(mismatch))
