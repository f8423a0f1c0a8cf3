"""What all laws have in common: a nominal model, gains that are checked, and one way to begin."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from controllers.gains import gain_fields, knobs, spelled
from octarm.errors import OctarmError
from octarm.interfaces import Knob, Measurement, NominalModel, Reference


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """A controller with gains; a law adds its gains as fields, and `__call__`.

    Attributes:
        nominal: the model that the controller believes.

    Raises:
        OctarmError: for a gain that its field does not allow; see `controllers.gains`.
    """

    nominal: NominalModel

    def __post_init__(self) -> None:
        for name, field in gain_fields(type(self)).items():
            value = getattr(self, name)
            if value is not None:
                value = field.checked(spelled(name), value, self.nominal)
                object.__setattr__(self, name, value)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> Any:
        """None: nothing is remembered from before the first call."""
        del batch_shape

    def knobs(self) -> tuple[Knob, ...]:
        """What tuning may turn."""
        return knobs(type(self))

    def check(self, measurement: Measurement, reference: Reference) -> None:
        """Checks that the arrays of one instant fit the arm and each other.

        Raises:
            OctarmError: unless all are of shape (..., 2N) and their batch axes broadcast.
        """
        q, v, (q_d, v_d, a_d) = measurement.q, measurement.v, reference
        shape, size = q.shape, self.nominal.coordinates
        if shape[-1:] == (size,) and v.shape == q_d.shape == v_d.shape == a_d.shape == shape:
            return
        arrays = {"q": q, "v": v, "q_d": q_d, "v_d": v_d, "a_d": a_d}
        for name, array in arrays.items():
            if array.shape[-1:] != (size,):
                raise OctarmError(
                    f"{name} has shape {array.shape}; its last axis must hold {size} coordinates "
                    f"for {self.nominal.modules} modules"
                )
        try:
            np.broadcast_shapes(*(array.shape for array in arrays.values()))
        except ValueError:
            listed = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise OctarmError(f"the batch axes of one instant do not fit: {listed}") from None


def elapsed(before: float, now: float) -> float:
    """Time since the last call [s], for a controller that integrates.

    Raises:
        OctarmError: if time went back.
    """
    if now < before:
        raise OctarmError(
            f"t is {now:g} s after {before:g} s; time must not go back, start from initial_state"
        )
    return now - before
