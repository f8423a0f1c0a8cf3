"""Fuzzy sliding mode: sliding-mode control whose switching part is a fuzzy function of s."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Annotated, ClassVar

import numpy as np

from controllers.fuzzy.inference import Sugeno, Variable
from controllers.fuzzy.rule_base import RuleBase
from controllers.gains import Gain
from controllers.recommended import LAYER_WIDTH, LINEAR_GAIN, SWITCHING_GAIN
from controllers.sliding_mode import SlidingLaw
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
class FuzzySlidingMode(SlidingLaw):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K f(s / phi) - K_v s, with a fuzzy function f.

    f is odd, rises, and is +-1 outside |s| <= phi: there this is `SlidingMode`. Inside, the rules
    say how hard to push back; nothing is adapted. As s f(s / phi) is never negative, V falls
    wherever the model is exact, and outside the layer under eq (40); inside it a model error leaves
    a bounded error, as with `BoundaryLayer`.

    A subclass may set another function `fuzzy`.
    """

    K: Annotated[Gain, SWITCHING_GAIN]
    K_v: Annotated[Gain, LINEAR_GAIN]
    phi: Annotated[Gain, dataclasses.replace(LAYER_WIDTH, zero=False)]

    fuzzy: ClassVar[Callable[[np.ndarray], np.ndarray]] = SWITCHING

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        surface = self.surface(measurement, reference)
        switching = -self.K * self.fuzzy(surface.s / self.phi) - self.K_v * surface.s
        return self.command(measurement, surface, switching, layer=self.phi), state
