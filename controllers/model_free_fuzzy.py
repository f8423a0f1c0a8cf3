"""The pure fuzzy controller: rules on the error and its rate, and no model of the arm."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from controllers.fuzzy.inference import Sugeno, Variable
from controllers.fuzzy.rule_base import RuleBase
from controllers.gains import Gain, apparent_mass, as_gain
from controllers.shapes import check_shapes
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Command, Measurement, Reference

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

LEVELS = {"NB": -1.0, "NM": -2 / 3, "NS": -1 / 3, "ZE": 0.0, "PS": 1 / 3, "PM": 2 / 3, "PB": 1.0}

SURFACE = Sugeno(
    inputs=(Variable.uniform("e", tuple(LEVELS)), Variable.uniform("rate", tuple(LEVELS))),
    rules=RULES,
    consequents=LEVELS,
)


def force_scale(nominal: ArmParameters) -> np.ndarray:
    """The force of the strongest rule, shape (..., 2N) [N], [N m].

    For three modules hand-set values. For other arms what gives each coordinate alone, the others
    being free, a bandwidth of 300 rad/s; the hand-set values are within 10 % of that. Twice the
    highest mode of the springs, it leaves an error of a few per cent of the motion; a sampling rate
    of 2 kHz would bear more.
    """
    hand_set = np.array([80.0, 40.0, 30.0, 12.0, 2.5, 0.9])
    if hand_set.size == nominal.coordinates:
        return hand_set
    return 300.0**2 * apparent_mass(nominal) * error_scale(nominal)


def error_scale(nominal: ArmParameters) -> np.ndarray:
    """The error that is big, 3 mm on slides and 0.03 rad on bends, shape (2N,)."""
    return np.repeat([0.003, 0.03], nominal.modules)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FuzzyController:
    """Q_j = -force_scale_j f(e_j / e_scale_j, e_j' / rate_scale_j), f the surface of the rules.

    The same rules serve every coordinate, each in its own scale. While |e / e_scale| +
    |e' / rate_scale| <= 2/3 the recommended surface is e / e_scale + e' / rate_scale: a PD law with
    the gains force_scale / e_scale and force_scale / rate_scale. Further out it bends over, to the
    full force at most. Nothing compensates weight and springs: away from its rest the arm is held
    with an error.

    Signals: `fuzzy`, the value of f in [-1, 1]; and s = e' + (rate_scale / e_scale) e, which is
    zero on the diagonal of the table.

    Attributes:
        nominal: the arm whose coordinates are controlled; no other use is made of the model.
        force_scale: force of the strongest rule, broadcasts to (..., 2N) [N], [N m].
        e_scale: error that is big, broadcasts to (..., 2N) [m], [rad].
        rate_scale: rate of the error that is big, broadcasts to (..., 2N) [m/s], [rad/s].
        surface: f, of two arrays of shape (..., 2N); a subclass may set another one, such as a
            `Mamdani` system.

    Raises:
        ValueError: for a scale that is not positive or has a wrong shape.
    """

    recommended: ClassVar[Mapping[str, Callable[[ArmParameters], npt.ArrayLike]]] = {
        "force_scale": force_scale,
        "e_scale": error_scale,
        "rate_scale": lambda nominal: 200.0 * error_scale(nominal),  # damping ratio 0.75
    }
    surface: ClassVar[Callable[[np.ndarray, np.ndarray], np.ndarray]] = SURFACE

    nominal: ArmParameters
    force_scale: Gain
    e_scale: Gain
    rate_scale: Gain

    def __post_init__(self) -> None:
        for name in ("force_scale", "e_scale", "rate_scale"):
            object.__setattr__(self, name, as_gain(name, getattr(self, name), self.nominal))

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        """There is nothing to remember."""
        del batch_shape

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m].

        Raises:
            ValueError: if the measurement or the reference has a wrong shape.
        """
        check_shapes(self.nominal, measurement, reference)
        e, e_dot = measurement.q - reference.q, measurement.v - reference.v
        fuzzy = self.surface(e / self.e_scale, e_dot / self.rate_scale)
        s = e_dot + self.rate_scale / self.e_scale * e
        return Command(-self.force_scale * fuzzy, {"s": s, "fuzzy": fuzzy}), state
