"""What a controller's step costs on this machine; timings differ from run to run."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.interfaces import Measurement, Reference
from paper.variants import Cast, Factory, Variant

ARMS = 1024
_TURNS = 60


class Cost(NamedTuple):
    """What a step costs.

    Attributes:
        label: of the variant.
        many: an arm of `ARMS` side by side: the arithmetic [s].
        alone: one arm alone: mostly what Python and NumPy take for each call [s].
    """

    label: str
    many: float
    alone: float


def costs(cast: Cast, factory: Factory) -> list[Cost]:
    """The shortest of many steps of each tuned controller, in turns so that all meet the same."""
    steppers = {
        (label, arms): _Stepper(variant, factory, arms)
        for label, variant in cast.tuned.items()
        for arms in (ARMS, 1)
    }
    best = dict.fromkeys(steppers, np.inf)
    for _ in range(_TURNS):
        for key, stepper in steppers.items():
            begun = time.perf_counter()
            stepper.step()
            best[key] = min(best[key], time.perf_counter() - begun)
    return [Cost(label, best[label, ARMS] / ARMS, best[label, 1]) for label in cast.tuned]


class _Stepper:
    """A controller whose arms are near what is wanted."""

    def __init__(self, variant: Variant, factory: Factory, arms: int) -> None:
        arm = nominal_parameters()
        self._controller = factory(variant.controller, arm.mismatched(-0.3), variant.gains)
        draw, size = np.random.default_rng(0), np.repeat([0.01, 0.3], arm.modules)
        shape = (arms, len(size)) if arms > 1 else (len(size),)

        def near(center: np.ndarray, scale: float) -> np.ndarray:
            return np.asfortranarray(center + scale * size * draw.normal(size=shape))

        self._q = near(equilibrium(arm), 1.0)
        self._v = near(np.zeros(shape), 3.0)
        self._reference = Reference(
            near(self._q, 0.02), near(self._v, 0.5), near(np.zeros(shape), 10.0)
        )
        self._state = self._controller.initial_state(shape[:-1])
        self._steps = 0

    def step(self) -> None:
        """The next control instant, 0.5 ms later."""
        measurement = Measurement(5e-4 * self._steps, self._q, self._v)
        _, self._state = self._controller(self._state, measurement, self._reference)
        self._steps += 1
