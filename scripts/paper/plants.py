"""Laws that believe in three modules, on chains of as many and more modules of the same rod.

The arms of a law on one plant run side by side: one without noise, in which nothing is random, and
one for each seed of the noise.

The longest control period of a law is predicted by the sampled linear loop about rest, and looked
for in simulation by bisection. A period is too long where a tiny step of the reference makes the
arm ever more restless: the rms of second differences of q, in which slow modes vanish, does not die
out from the second quarter of a run to the last, or the arm is lost. A law with sgn(s) has no
slope, hence no prediction, and is restless at every period: it is asked to track the sine with an
error of at most `TRACKED` instead.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

import octarm
from octarm.arm.groups import Groups
from octarm.checks.sampled_loop import LinearPlant, Loop, NoSlopeError
from octarm.interfaces import Instant
from octarm.metrics.rows import Size
from octarm.references import SetPoint
from octarm.simulation.rollout import simulate
from octarm.sweeps.tune_cost import root_mean_square
from paper.runs import noisy_arms
from paper.studies import BENDS, NOISE, SCALE
from paper.variants import ARM, Variant

DURATION, COUNTED = 1.5, 0.5  # of a run, and from when on errors count: half a period [s]
SHORTEST, LONGEST = 1e-5, 0.01  # periods that are looked at [s]
SHORTEST_TRACKED = 5e-5  # of laws that are to track [s]
CLOSE = 1.05  # shortest that fails over longest that does not, where the search ends [1]
FIRST = 1.045  # between the first two periods, where one is predicted: they may be the last [1]
FEWEST, MOST, LASTING = 200, 1600, 0.5  # control periods of a run about rest, and its length [s]
STEP = 1e-7  # of the reference about rest, as a share of the motion [1]
CALM, FALLING = 1e-3, 0.7  # what dies out, over the step, and over what it was before [1]
TRACKED = 0.1  # error of tracking, as a share of the motion [1]


def planted(
    variant: Variant, modules: int, rate: float, seeds: int, engine: str
) -> dict[str, np.ndarray]:
    """`tracking` of arms without noise and with so many seeds of it at a rate [Hz]."""
    arms = noisy_arms([0.0] + [NOISE] * seeds, [0, *range(seeds)])
    return tracking(variant, modules, 1.0 / rate, engine, **arms)


def searched(variant: Variant, plants: Sequence[int], engine: str) -> dict[str, np.ndarray]:
    """The longest periods `predicted`, NaN without a slope, and `simulated`, shapes (plants,) [s].

    The plants are numbers of modules.
    """
    pairs: list[tuple[float, float]] = []
    guess = 0.003  # [s]; of one module: what is borne is inverse to their number, about
    for modules in plants:
        pairs.append(longest_two(variant, modules, guess / modules, engine))
        if 0.0 < pairs[-1][1] < math.inf:
            guess = pairs[-1][1] * modules
    return dict(zip(("predicted", "simulated"), np.array(pairs).T, strict=True))


def longest(
    bears: Callable[[float], bool], start: float, shortest: float = SHORTEST, factor: float = 1.2
) -> float:
    """The longest period that is borne, by a bracket that widens and then bisection [s].

    It is 0 if the shortest one is not borne, infinite if `LONGEST` is. The factor is that between
    the first two periods.
    """
    good, bad, period = 0.0, math.inf, min(max(start, shortest), LONGEST)
    while not (good and bad / good <= CLOSE):
        good, bad = (period, bad) if bears(period) else (good, period)
        if good >= LONGEST or bad <= shortest:
            return math.inf if good else 0.0
        if good and math.isfinite(bad):
            period = math.sqrt(good * bad)
        else:
            period = min(good * factor, LONGEST) if good else max(bad / factor, shortest)
            factor *= factor
    return good


def longest_two(variant: Variant, modules: int, guess: float, engine: str) -> tuple[float, float]:
    """By the spectral radius, infinite where all periods are stable, and in simulation [s].

    The guess is where the search begins if nothing is predicted.
    """
    groups = Groups.of(ARM, modules)
    plant = LinearPlant.of(groups.plant, groups.matrix)
    try:
        predicted = Loop(plant, variant.controls(ARM)).longest_period()
    except NoSlopeError:
        return math.nan, longest(
            lambda period: bool(tracking(variant, modules, period, engine)["error"] <= TRACKED),
            guess, SHORTEST_TRACKED,
        )  # fmt: skip
    bears = partial(rests, variant, modules, engine, plant.rest)
    return predicted, longest(bears, 0.98 * predicted, factor=FIRST)


def rests(variant: Variant, modules: int, engine: str, rest: np.ndarray, period: float) -> bool:
    """Whether the arm comes to rest at `rest`, shape (2N,), after a tiny step of the reference."""
    environment = _load(SetPoint(q=rest + STEP * SCALE), modules, period, engine)
    duration = min(max(round(LASTING / period), FEWEST), MOST) * period
    q: list[np.ndarray] = []
    simulate(environment, variant.controls(ARM), duration, lambda now: q.append(now.q))
    if not environment.physics.intact():
        return False
    restless = np.linalg.norm(np.diff(q, 2, axis=0) / SCALE, axis=1)
    _, early, _, late = (np.sqrt(np.mean(np.square(x))) for x in np.array_split(restless, 4))
    return bool(late <= max(FALLING * early, CALM * STEP))


def tracking(
    variant: Variant, modules: int, period: float, engine: str,
    duration: float = DURATION, counted: float = COUNTED, **arms: Any,
) -> dict[str, np.ndarray]:  # fmt: skip
    """`error`, a share of the motion over all physics steps from an instant on [s], and `lost`.

    The arms are under the sine, n of them or one, shapes (n,) or (); the error of a lost one is
    infinite.
    """
    environment = _load(BENDS, modules, period, engine, **arms)
    environment.physics.plant_tips = False
    size = Size(environment.physics.q())

    def observe(instant: Instant) -> None:
        if instant.within and instant.measurement.t >= counted - 1e-9:
            q, q_d = instant.within.q, instant.within.q_d
            wanted = q_d if q_d.ndim == q.ndim else q_d[:, None]  # the same for all arms
            with np.errstate(all="ignore"):  # a diverged arm may hold anything
                size.update(np.square(q - wanted))

    simulate(environment, variant.controls(ARM), duration, observe)
    lost = ~np.asarray(environment.physics.intact())
    error = root_mean_square(size.root() / SCALE)
    return {"error": np.where(lost, np.inf, error), "lost": lost}


def _load(reference: Any, modules: int, period: float, engine: str, **arms: Any) -> Any:
    """The environment of arms of so many modules with a control period [s]."""
    return octarm.load(
        reference, control_period=period, timestep="auto", engine=engine, plant_modules=modules,
        **arms,
    )  # fmt: skip
