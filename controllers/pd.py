"""Proportional-derivative control with compensation of gravity and springs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from controllers.gains import Gain, as_gain, layer_slope
from controllers.shapes import check_shapes
from octarm.arm.lagrange import inverse_dynamics
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Command, Measurement, Reference


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ErrorFeedback:
    """The gains of a linear feedback of e and e', with e = q - q_d.

    Both K_p e and K_d e' enter with a minus sign; together they are -K_d s with
    s = e' + (K_p / K_d) e.

    Attributes:
        nominal: the model that the controller believes.
        K_p: position gain, broadcasts to (..., 2N); its units are the controller's.
        K_d: velocity gain, broadcasts to (..., 2N).

    Raises:
        ValueError: for a gain that is not positive or has a wrong shape.
    """

    nominal: ArmParameters
    K_p: Gain
    K_d: Gain

    def __post_init__(self) -> None:
        for name in ("K_p", "K_d"):
            object.__setattr__(self, name, as_gain(name, getattr(self, name), self.nominal))

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        """There is nothing to remember."""
        del batch_shape


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ProportionalDerivative(ErrorFeedback):
    """Q = G^(q_d) - K_p e - K_d e', with e = q - q_d.

    G of eq (5) holds the arm against its weight and its springs. It is taken where the arm shall
    be: the springs of the arm then go on pulling towards q_d, and add to K_p. Taken where the arm
    is, G^(q) would cancel the springs, and a model that is too stiff would cancel more than there
    is.

    Signals: `equivalent` G^(q_d), and `feedback` -K_p e - K_d e' = -K_d s with
    s = e' + (K_p / K_d) e.

    Attributes:
        nominal: the model that the controller believes.
        K_p: position gain, broadcasts to (..., 2N) [N/m], [N m/rad].
        K_d: velocity gain, broadcasts to (..., 2N) [N s/m], [N m s/rad].

    Raises:
        ValueError: for a gain that is not positive or has a wrong shape.
    """

    recommended: ClassVar[Mapping[str, Callable[[ArmParameters], npt.ArrayLike]]] = {
        "K_p": lambda nominal: 15.0 * layer_slope(nominal),  # lambda times the slope
        "K_d": layer_slope,
    }

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        """The generalised force for this instant, shape (..., 2N) [N], [N m]."""
        check_shapes(self.nominal, measurement, reference)
        e, e_dot = measurement.q - reference.q, measurement.v - reference.v
        rest = np.zeros_like(e)
        equivalent = inverse_dynamics(self.nominal, reference.q, rest, rest)
        feedback = -self.K_p * e - self.K_d * e_dot
        s = e_dot + self.K_p / self.K_d * e
        signals = {"s": s, "equivalent": equivalent, "feedback": feedback}
        return Command(equivalent + feedback, signals), state
