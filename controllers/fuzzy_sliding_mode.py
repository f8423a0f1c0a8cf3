"""Fuzzy sliding mode: sliding-mode control whose switching part is a fuzzy function of s."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from controllers.fuzzy.inference import Sugeno, Variable
from controllers.fuzzy.rule_base import RuleBase
from controllers.gains import Gain, as_gain
from controllers.sliding_mode import equivalent_force
from octarm.arm.lagrange import kinetic_energy
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Command, Measurement, Reference

RULES = RuleBase.from_sentences("""
    if s is NB then NB
    if s is NM then NM
    if s is NS then NS
    if s is ZE then ZE
    if s is PS then PS
    if s is PM then PM
    if s is PB then PB
""")

# Steeper than s / phi near s = 0, where accuracy is decided, and gentler towards the edge.
LEVELS = {"NB": -1.0, "NM": -0.85, "NS": -0.5, "ZE": 0.0, "PS": 0.5, "PM": 0.85, "PB": 1.0}

SWITCHING = Sugeno(inputs=(Variable.uniform("s", tuple(LEVELS)),), rules=RULES, consequents=LEVELS)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FuzzySlidingMode:
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K f(s / phi) - K_v s, with a fuzzy function f.

    f is odd, rises, and is +-1 outside |s| <= phi: there this is `SlidingMode`. Inside, the rules
    say how hard to push back; nothing is adapted. As s f(s / phi) is never negative, V falls
    wherever the model is exact, and outside the layer under eq (40); inside it a model error leaves
    a bounded error, as with `BoundaryLayer`.

    Signals: s, the parts `equivalent` and `switching`, V = 1/2 s^T D^ s [J].

    Attributes:
        nominal: the model that the controller believes.
        lambda_: decay rate of the error on the surface, broadcasts to (..., 2N) [1/s].
        K: switching gain, above the model error by eq (40), broadcasts to (..., 2N) [N], [N m].
        K_v: linear gain, broadcasts to (..., 2N) [N s/m], [N m s/rad].
        phi: where the first and last rule take over, broadcasts to (..., 2N) [m/s], [rad/s].
        fuzzy: the function f; a subclass may set another one.

    Raises:
        ValueError: for a gain that is negative, not finite, or has a wrong shape.
    """

    nominal: ArmParameters
    lambda_: Gain
    K: Gain
    K_v: Gain
    phi: Gain

    fuzzy: ClassVar[Callable[[np.ndarray], np.ndarray]] = SWITCHING

    def __post_init__(self) -> None:
        nominal = self.nominal
        gains = {
            "lambda_": as_gain("lambda", self.lambda_, nominal),
            "K": as_gain("K", self.K, nominal, zero_allowed=True),
            "K_v": as_gain("K_v", self.K_v, nominal, zero_allowed=True),
            "phi": as_gain("phi", self.phi, nominal),
        }
        for name, gain in gains.items():
            object.__setattr__(self, name, gain)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        """There is nothing to remember."""
        del batch_shape

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        nominal = self.nominal
        s, equivalent = equivalent_force(nominal, self.lambda_, measurement, reference)
        switching = -self.K * self.fuzzy(s / self.phi) - self.K_v * s
        V = kinetic_energy(nominal, measurement.q, s)[..., None]
        signals = {"s": s, "equivalent": equivalent, "switching": switching, "V": V}
        return Command(equivalent + switching, signals), state
