"""Controllers with given fuzzy rules: the pure fuzzy controller, and fuzzy sliding mode."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Annotated, ClassVar

import numpy as np

from controllers.fuzzy.inference import Sugeno, Variable
from controllers.fuzzy.rule_base import RuleBase
from controllers.law import Gain, GainField, Law
from controllers.recommended import LAYER_WIDTH, LINEAR_GAIN, SWITCHING_GAIN, HandSet, by_hand
from controllers.sliding_mode import SlidingLaw
from octarm.interfaces import Command, Knob, Measurement, NominalModel, Reference

LEVELS = {"NB": -1.0, "NM": -2 / 3, "NS": -1 / 3, "ZE": 0.0, "PS": 1 / 3, "PM": 2 / 3, "PB": 1.0}

# Too far and moving away: push back hard. Too far but on its way back fast enough: let it come.
RULES = RuleBase.from_table("""
    e / rate   NB  NM  NS  ZE  PS  PM  PB
    NB         NB  NB  NB  NB  NM  NS  ZE
    NM         NB  NB  NB  NM  NS  ZE  PS
    NS         NB  NB  NM  NS  ZE  PS  PM
    ZE         NB  NM  NS  ZE  PS  PM  PB
    PS         NM  NS  ZE  PS  PM  PB  PB
    PM         NS  ZE  PS  PM  PB  PB  PB
    PB         ZE  PS  PM  PB  PB  PB  PB
""")

SURFACE = Sugeno(
    inputs=(Variable.uniform("e", tuple(LEVELS)), Variable.uniform("rate", tuple(LEVELS))),
    rules=RULES,
    consequents=LEVELS,
)

# Steeper than s / phi near s = 0, where accuracy is decided, and gentler towards the edge.
SWITCHING = Sugeno(
    inputs=(Variable.uniform("s", tuple(LEVELS)),),
    rules=RuleBase.from_sentences("\n".join(f"if s is {label} then {label}" for label in LEVELS)),
    consequents=LEVELS | {"NM": -0.85, "NS": -0.5, "PS": 0.5, "PM": 0.85},
)


# It gives each coordinate alone, the others being free, a bandwidth of about 300 rad/s. Twice the
# highest mode of the springs, it leaves an error of a few per cent of the motion; a sampling rate
# of 2 kHz would bear more.
force_scale = HandSet("N, N m", 80.0, 40.0, 30.0, 12.0, 2.5, 0.9)
error_scale = HandSet("m, rad", 0.003, 0.03)


def rate_scale(nominal: NominalModel) -> np.ndarray:
    """The rate that is big, shape (..., 2N) [m/s], [rad/s]: a damping ratio of 0.75."""
    return by_hand(nominal, "1/s", 200.0) * error_scale(nominal)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FuzzyController(Law):
    """Q_j = -force_scale_j f(e_j / e_scale_j, e_j' / rate_scale_j), f the surface of the rules.

    The same rules serve every coordinate, each in its own scale. While |e / e_scale| +
    |e' / rate_scale| <= 2/3 the recommended surface is e / e_scale + e' / rate_scale: a PD law with
    the gains force_scale / e_scale and force_scale / rate_scale. Further out it bends over, to the
    full force at most. Nothing compensates weight and springs: away from its rest the arm is held
    with an error. No use is made of the nominal model but for the recommended gains.

    Signals: `fuzzy`, the value of f in [-1, 1]; and s = e' + (rate_scale / e_scale) e, which is
    zero on the diagonal of the table.

    A subclass may set another `surface` f, of two arrays of shape (..., 2N), such as a `Mamdani`
    system.
    """

    surface: ClassVar[Callable[[np.ndarray, np.ndarray], np.ndarray]] = SURFACE

    force_scale: Annotated[
        Gain,
        GainField(
            "force of the strongest rule", "N, N m", force_scale, Knob("force_scale", apart=True)
        ),
    ]
    e_scale: Annotated[
        Gain, GainField("error that is big", "m, rad", error_scale, Knob("e_scale", apart=True))
    ]
    rate_scale: Annotated[
        Gain,
        GainField(
            "rate of the error that is big",
            "m/s, rad/s",
            rate_scale,
            Knob("rate_scale", apart=True),
        ),
    ]

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        e, e_dot = self.errors(measurement, reference)
        fuzzy = self.surface(e / self.e_scale, e_dot / self.rate_scale)
        s = e_dot + self.rate_scale / self.e_scale * e
        return Command(-self.force_scale * fuzzy, {"s": s, "fuzzy": fuzzy}), state


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FuzzySlidingMode(SlidingLaw):
    """Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K f(s / phi) - K_v s, with a fuzzy function f.

    f is odd, rises, and is +-1 outside |s| <= phi: there this is `SlidingMode`. Inside, the rules
    say how hard to push back; nothing is adapted. As s f(s / phi) is never negative, V falls
    wherever the model is exact, and outside the layer under eq (40); inside it a model error leaves
    a bounded error, as with `BoundaryLayer`.

    A subclass may set another function `fuzzy`.
    """

    fuzzy: ClassVar[Callable[[np.ndarray], np.ndarray]] = SWITCHING

    K: Annotated[Gain, SWITCHING_GAIN]
    K_v: Annotated[Gain, LINEAR_GAIN]
    phi: Annotated[Gain, dataclasses.replace(LAYER_WIDTH, zero=False)]

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        surface = self.surface(measurement, reference)
        switching = -self.K * self.fuzzy(surface.s / self.phi) - self.K_v * surface.s
        return self.command(measurement, surface, switching, layer=self.phi), state
