"""Checking what a controller is called with."""

from __future__ import annotations

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.interfaces import Measurement, Reference


def check_shapes(nominal: ArmParameters, measurement: Measurement, reference: Reference) -> None:
    """Sees to it that the arrays of one instant fit the arm and each other.

    Raises:
        ValueError: unless all are of shape (..., 2N) and their batch axes broadcast.
    """
    q, v, wanted = measurement.q, measurement.v, reference
    shape = q.shape
    if (
        shape[-1:] == (nominal.coordinates,)
        and v.shape == shape
        and wanted.q.shape == wanted.v.shape == wanted.a.shape == shape
    ):
        return
    arrays = {"q": q, "v": v, "q_d": wanted.q, "v_d": wanted.v, "a_d": wanted.a}
    for name, array in arrays.items():
        if array.shape[-1:] != (nominal.coordinates,):
            raise OctarmError(
                f"{name} has shape {array.shape}; its last axis must hold "
                f"{nominal.coordinates} coordinates for {nominal.modules} modules"
            )
    try:
        np.broadcast_shapes(*(array.shape for array in arrays.values()))
    except ValueError:
        listed = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise OctarmError(f"the batch axes of one instant do not fit: {listed}") from None


def elapsed(before: float, now: float) -> float:
    """Time since the last call [s], for a controller that integrates.

    Raises:
        ValueError: if time went back.
    """
    if now < before:
        raise OctarmError(
            f"t is {now:g} s after {before:g} s; time must not go back, start from initial_state"
        )
    return now - before
