"""Laws that believe in three modules, on chains of as many and more modules of the same rod.

The arms of a law on one plant run side by side on the engine `lagrange`: one without noise, in
which nothing is random, and one for each seed of the noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

import octarm
from octarm.disturbances.forces import BandLimitedNoise
from octarm.interfaces import Instant
from octarm.simulation.engines import LAGRANGE, usual_engine
from octarm.simulation.rollout import simulate
from paper.studies import BENDS, NOISE, SCALE, SEED, TIME, Effort
from paper.variants import Variant

DURATION, COUNTED = 2.0, 1.0  # of a run, and from when on errors count: half a period [s]


class Planted(NamedTuple):
    """A law on a plant."""

    variant: Variant  # the law
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
        environment = octarm.load(
            BENDS,
            disturbances=[BandLimitedNoise(ratio=self.noise[:, None], correlation_time=TIME)],
            batch=1 + self.seeds,
            control_period=1.0 / self.rate,
            timestep="auto",
            seed=[np.random.SeedSequence(SEED, spawn_key=(i,)) for i in (0, *range(self.seeds))],
            engine=LAGRANGE,
            plant_modules=self.modules,
        )
        arm = octarm.nominal_parameters()
        error = MeanSquare(arm.modules, COUNTED)
        simulate(environment, self.variant.controls(arm), DURATION, error)
        lost = ~environment.physics.intact()
        return {"error": np.where(lost, np.inf, error.root()), "lost": lost}


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


def planted(variants: Mapping[str, Variant], effort: Effort) -> Iterator[Planted]:
    """All of them, where the engine is installed."""
    if usual_engine() == LAGRANGE:
        for rate in effort.plant_rates:
            for modules in effort.plants:
                for label in effort.plant_labels:
                    yield Planted(variants[label], modules, rate, effort.seeds)
