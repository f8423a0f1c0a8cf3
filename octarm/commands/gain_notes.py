"""What the commands say of gains that were found for another arm, or another control period."""

from __future__ import annotations

import sys
from typing import Any

from controllers.gain_sets import unsuited
from octarm.arm.mjcf import physics_step
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.errors import printable


def print_unsuited(
    controller: str,
    gain_set: Any,
    nominal: ArmParameters,
    timestep: float | str | None,
    control_period: float | None,
) -> str:
    """Prints a sentence on gains that were found for another arm or control period.

    Args:
        controller: its name.
        gain_set: see `controllers.gain_sets.gain_set_of`.
        nominal: what the controller believes of one arm.
        timestep: physics step [s], `auto`, or None for the usual one.
        control_period: time between control actions [s]; one physics step when None.

    Returns:
        The sentence; empty if they suit.
    """
    step = timestep if isinstance(timestep, float) else physics_step()
    period = step if control_period is None else control_period
    sentence = unsuited(controller, gain_set, LagrangeModel(nominal), period)
    if sentence:
        print(f"octarm: {printable(sentence)}", file=sys.stderr)
    return sentence
