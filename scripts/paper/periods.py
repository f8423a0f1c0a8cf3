"""The longest control period of each law on plants of more and more modules.

It is predicted by the sampled linear loop about rest, and looked for in simulation by bisection. A
period is too long where a tiny step of the reference makes the arm ever more restless: the rms of
second differences of q, in which slow modes vanish, does not die out from the second quarter of a
run to the last, or the arm is lost. A law with sgn(s) has no slope, hence no prediction, and is
restless at every period: it is asked to track the sine with an error of at most `TRACKED` instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

import octarm
from octarm.arm.groups import Groups
from octarm.checks.sampled_loop import LinearPlant, Loop, NoSlopeError
from octarm.references import SetPoint
from octarm.simulation.engines import LAGRANGE, usual_engine
from octarm.simulation.rollout import simulate
from paper.plants import MeanSquare
from paper.studies import BENDS, SCALE, Effort
from paper.variants import Variant

SHORTEST, LONGEST = 1e-5, 0.01  # periods that are looked at [s]
SHORTEST_TRACKED = 5e-5  # of laws that are to track [s]
CLOSE = 1.05  # shortest that fails over longest that does not, where the search ends [1]
FEWEST, MOST, LASTING = 200, 1600, 0.5  # control periods of a run about rest, and its length [s]
STEP = 1e-7  # of the reference about rest, as a share of the motion [1]
CALM, FALLING = 1e-3, 0.7  # what dies out, over the step, and over what it was before [1]
TRACKED = 0.1  # error of tracking, as a share of the motion [1]
DURATION, COUNTED = 1.5, 0.5  # of tracking, and from when on its errors count [s]


class Search(NamedTuple):
    """The longest periods of a law."""

    variant: Variant  # the law
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
        predicted, simulated = np.array(pairs).T
        return {"predicted": predicted, "simulated": simulated}


def searches(variants: Mapping[str, Variant], effort: Effort) -> Iterator[Search]:
    """All of them, where the engine is installed."""
    for label in effort.plant_labels if usual_engine() == LAGRANGE else ():
        yield Search(variants[label], tuple(effort.plants))


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
    """Whether the arm comes to rest after a tiny step of the reference."""
    arm = octarm.nominal_parameters()
    scale = np.repeat(list(SCALE.values()), arm.modules)
    environment = octarm.load(
        SetPoint(q=rest + STEP * scale), control_period=period, timestep="auto", engine=LAGRANGE,
        plant_modules=modules,
    )  # fmt: skip
    q: list[np.ndarray] = []
    instants = min(max(round(LASTING / period), FEWEST), MOST)
    lost = simulate(
        environment, variant.controls(arm), instants * period, lambda now: q.append(now.q)
    )
    if lost:
        return False
    restless = np.linalg.norm(np.diff(q, 2, axis=0) / scale, axis=1)
    _, early, _, late = (np.sqrt(np.mean(np.square(x))) for x in np.array_split(restless, 4))
    return bool(late <= max(FALLING * early, CALM * STEP))


def tracks(variant: Variant, modules: int, period: float) -> bool:
    """Whether the error of the arm under the sine stays small."""
    arm = octarm.nominal_parameters()
    environment = octarm.load(
        BENDS, control_period=period, timestep="auto", engine=LAGRANGE, plant_modules=modules
    )
    error = MeanSquare(arm.modules, COUNTED)
    lost = simulate(environment, variant.controls(arm), DURATION, error)
    return bool(not lost and error.root() <= TRACKED)
