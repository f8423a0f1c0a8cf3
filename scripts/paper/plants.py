"""Laws that believe in three modules, on chains of as many and more modules of the same rod.

The arms of a law on one plant run side by side on the engine `lagrange`: one without noise, in
which nothing is random, and one for each seed of the noise.

The longest control period of a law is predicted by the sampled linear loop about rest, and looked
for in simulation by bisection. A period is too long where a tiny step of the reference makes the
arm ever more restless: the rms of second differences of q, in which slow modes vanish, does not die
out from the second quarter of a run to the last, or the arm is lost. A law with sgn(s) has no
slope, hence no prediction, and is restless at every period: it is asked to track the sine with an
error of at most `TRACKED` instead.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import octarm
from octarm.arm.groups import Groups
from octarm.checks.sampled_loop import LinearPlant, Loop, NoSlopeError
from octarm.interfaces import Instant
from octarm.references import SetPoint
from octarm.simulation.engines import LAGRANGE, usual_engine
from octarm.simulation.rollout import simulate
from paper.runs import noisy_arms
from paper.studies import BENDS, NOISE, SCALE, Effort
from paper.variants import Variant

DURATION, COUNTED = 1.5, 0.5  # of a run, and from when on errors count: half a period [s]
SHORTEST, LONGEST = 1e-5, 0.01  # periods that are looked at [s]
SHORTEST_TRACKED = 5e-5  # of laws that are to track [s]
CLOSE = 1.05  # shortest that fails over longest that does not, where the search ends [1]
FEWEST, MOST, LASTING = 200, 1600, 0.5  # control periods of a run about rest, and its length [s]
STEP = 1e-7  # of the reference about rest, as a share of the motion [1]
CALM, FALLING = 1e-3, 0.7  # what dies out, over the step, and over what it was before [1]
TRACKED = 0.1  # error of tracking, as a share of the motion [1]
TRACKING = 1.5, 0.5  # length of a run that is to track, and from when on its errors count [s]


class Planted(NamedTuple):
    """A law on a plant."""

    variant: Variant
    modules: int  # of the plant
    rate: float  # of control [Hz]
    seeds: int  # number of seeds of the noise

    @property
    def name(self) -> str:
        """Of the file."""
        return f"plant-{self.modules}-{self.rate:g}-Hz-{self.variant.label}"

    @property
    def seconds(self) -> float:
        """What is simulated, weighed by what a period costs for all arms [s]."""
        return DURATION * self.rate / 200.0 * (1.0 + self.modules / 10.0)

    @property
    def noise(self) -> np.ndarray:
        """Rms over the input's amplitude of each arm, shape (1 + seeds,) [1]."""
        return np.array([0.0] + [NOISE] * self.seeds)

    def perform(self) -> dict[str, np.ndarray]:
        """`error`, as a share of the motion, infinite if lost, and `lost`, shapes (1 + seeds,)."""
        arms = noisy_arms(self.noise, [0, *range(self.seeds)])
        times = (1.0 / self.rate, DURATION, COUNTED)
        error, lost = _tracking(self.variant, self.modules, *times, **arms)
        return {"error": error, "lost": lost}


class Search(NamedTuple):
    """The longest control periods of a law."""

    variant: Variant
    plants: tuple[int, ...]  # numbers of modules

    @property
    def name(self) -> str:
        """Of the file."""
        return f"periods-{self.variant.label}"

    @property
    def seconds(self) -> float:
        """What it weighs among other jobs, in seconds that an arm is simulated [s]."""
        return 100.0 * len(self.plants)

    def perform(self) -> dict[str, np.ndarray]:
        """`predicted`, NaN without a slope, and `simulated`, shapes (plants,) [s]."""
        pairs = [longest_two(self.variant, modules) for modules in self.plants]
        return dict(zip(("predicted", "simulated"), np.array(pairs).T, strict=True))


def planted(variants: Mapping[str, Variant], effort: Effort) -> Iterator[Planted]:
    """All laws on all plants, where the engine is installed."""
    places = itertools.product(effort.plant_rates, effort.plants, effort.plant_labels)
    for rate, modules, label in places if usual_engine() == LAGRANGE else ():
        yield Planted(variants[label], modules, rate, effort.seeds)


def searches(variants: Mapping[str, Variant], effort: Effort) -> Iterator[Search]:
    """The searches of all laws, where the engine is installed."""
    for label in effort.plant_labels if usual_engine() == LAGRANGE else ():
        yield Search(variants[label], tuple(effort.plants))


class MeanSquare:
    """The error of arms over all physics steps: of all coordinates, as a share of the motion."""

    def __init__(self, modules: int, counted: float) -> None:
        """For arms of so many modules, from an instant on [s]."""
        self._scale, self._counted = np.repeat(list(SCALE.values()), modules), counted
        self._sum, self._count = np.zeros(()), 0

    def __call__(self, instant: Instant) -> None:
        """Takes a control period."""
        if instant.within and instant.measurement.t >= self._counted - 1e-9:
            q, q_d = instant.within.q, instant.within.q_d
            wanted = q_d[:, None] if q_d.ndim < q.ndim else q_d  # the same for all arms
            with np.errstate(all="ignore"):  # a diverged arm may hold anything
                shares = (q - wanted) / self._scale
                self._sum = self._sum + np.sum(np.mean(np.square(shares), axis=-1), axis=0)
            self._count += len(shares)

    def root(self) -> np.ndarray:
        """Root of the mean square [1]; infinite if no period counts."""
        return np.sqrt(self._sum / self._count) if self._count else np.full((), np.inf)


def longest(bears: Callable[[float], bool], start: float, shortest: float = SHORTEST) -> float:
    """The longest period that is borne, by a bracket that widens and then bisection [s].

    It is 0 if the shortest one is not borne, infinite if `LONGEST` is.
    """
    good, bad, factor = 0.0, math.inf, 1.2
    period = min(max(start, shortest), LONGEST)
    while not (good and bad / good <= CLOSE):
        if bears(period):
            good = period
        else:
            bad = period
        if good >= LONGEST or bad <= shortest:
            return math.inf if good else 0.0
        if good and math.isfinite(bad):
            period = math.sqrt(good * bad)
        else:
            period = min(good * factor, LONGEST) if good else max(bad / factor, shortest)
            factor *= factor
    return good


def longest_two(variant: Variant, modules: int) -> tuple[float, float]:
    """By the spectral radius, infinite where all periods are stable, and in simulation [s]."""
    arm = octarm.nominal_parameters()
    groups = Groups.of(arm, modules)
    plant = LinearPlant.of(groups.plant, groups.matrix)
    try:
        predicted = Loop(plant, variant.controls(arm)).longest_period()
    except NoSlopeError:
        return math.nan, longest(partial(tracks, variant, modules), 1e-3, SHORTEST_TRACKED)
    return predicted, longest(partial(rests, variant, modules, plant.rest), 0.9 * predicted)


def rests(variant: Variant, modules: int, rest: np.ndarray, period: float) -> bool:
    """Whether the arm comes to rest at `rest`, shape (2N,), after a tiny step of the reference."""
    scale = np.repeat(list(SCALE.values()), octarm.nominal_parameters().modules)
    q: list[np.ndarray] = []
    duration = min(max(round(LASTING / period), FEWEST), MOST) * period
    target = SetPoint(q=rest + STEP * scale)
    if not _run(variant, modules, target, period, duration, lambda now: q.append(now.q)):
        return False
    restless = np.linalg.norm(np.diff(q, 2, axis=0) / scale, axis=1)
    _, early, _, late = (np.sqrt(np.mean(np.square(x))) for x in np.array_split(restless, 4))
    return bool(late <= max(FALLING * early, CALM * STEP))


def tracks(variant: Variant, modules: int, period: float) -> bool:
    """Whether the error of the arm under the sine stays small."""
    return bool(_tracking(variant, modules, period, *TRACKING)[0] <= TRACKED)


def _tracking(
    variant: Variant, modules: int, period: float, duration: float, counted: float, **arms: Any
) -> tuple[np.ndarray, np.ndarray]:
    """The error of each arm under the sine, infinite if it is lost, and whether it is."""
    error = MeanSquare(octarm.nominal_parameters().modules, counted)
    lost = ~_run(variant, modules, BENDS, period, duration, error, **arms)
    return np.where(lost, np.inf, error.root()), lost


def _run(
    variant: Variant, modules: int, reference: Any, period: float, duration: float,
    observe: Callable[[Instant], None], **arms: Any,
) -> np.ndarray:  # fmt: skip
    """Simulates arms of so many modules under a law; whether each stayed within its limits."""
    environment = octarm.load(
        reference, control_period=period, timestep="auto", engine=LAGRANGE, plant_modules=modules,
        **arms,
    )  # fmt: skip
    simulate(environment, variant.controls(octarm.nominal_parameters()), duration, observe)
    return np.asarray(environment.physics.intact())
