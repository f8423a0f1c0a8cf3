"""What the commands say of gains that were found for another arm, or another control period."""

from __future__ import annotations

import sys

from controllers.gain_sets import unsuited
from octarm.arm.mjcf import physics_step
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.errors import printable


def print_unsuited(
    controller: str,
    gain_set: str | None,
    nominal: ArmParameters,
    timestep: float | str | None,
    control_period: float | None,
) -> str:
    """Prints on stderr, and returns, a sentence on gains that do not suit; it is empty if they do.

    The physics step [s] may also be `auto`, or None for the usual one; the control period is one
    physics step when None.
    """
    step = timestep if isinstance(timestep, float) else physics_step()
    period = step if control_period is None else control_period
    sentence = unsuited(controller, gain_set, LagrangeModel(nominal), period)
    if sentence:
        print(f"octarm: {printable(sentence)}", file=sys.stderr)
    return sentence
