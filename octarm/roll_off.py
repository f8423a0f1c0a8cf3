"""A first-order roll-off of the force that a law asks for.

It takes off what makes modes grow that the law's model lacks, at half the sampling rate in the end:

    f_k = a f_(k-1) + (1 - a) Q_k,    a = exp(-omega T)

exact of f' = omega (Q - f) for a Q that is held. At half the sampling rate its gain is
(1 - a) / (1 + a); far below the corner omega it is late by 1 / omega.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from octarm.interfaces import Command, Controller, Knob, Measurement, Reference, Tunable

# Time of the last call [s], None before the first one, the force then, and the state of the law.
State = tuple[float | None, np.ndarray, Any]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class RolledOff:
    """A law and the roll-off of its force; signals are those of the law.

    Attributes:
        law: whose force it is.
        roll_off: corner omega / (2 pi) of each coordinate, broadcasts to (..., 2N) [Hz].
        scale: what it is divided by to suit similar arms, shape () or (..., 1) [Hz].
    """

    law: Tunable
    roll_off: np.ndarray
    scale: np.ndarray

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> State:
        """The state before the first call, at which the force is that of the law."""
        return None, np.zeros(()), self.law.initial_state(batch_shape)

    def __call__(
        self, state: State, measurement: Measurement, reference: Reference
    ) -> tuple[Command, State]:
        """The command for this instant, whose force is f, and the next state."""
        before, held, law = state
        command, law = self.law(law, measurement, reference)
        force = np.array(command.force)
        if before is not None:
            force += self.decay(measurement.t - before) * (held - force)
        return command._replace(force=force), (measurement.t, force, law)

    def decay(self, period: float) -> np.ndarray:
        """What is left of an old force after a period [s], a, broadcasts to (..., 2N) [1]."""
        return np.exp(-2.0 * np.pi * period * self.roll_off)

    def knobs(self) -> tuple[Knob, ...]:
        """What tuning may turn: the knobs of the law."""
        return self.law.knobs()

    def scales(self) -> Mapping[str, np.ndarray]:
        """What gains of the law and `roll_off` are divided by, shape () or (..., 2N) [SI]."""
        return {**self.law.scales(), "roll_off": self.scale}


def fields_of(controller: Controller) -> dict[str, Any]:
    """The fields of a controller by name; of a `RolledOff` those of its law, and `roll_off`."""
    if isinstance(controller, RolledOff):
        return {**fields_of(controller.law), "roll_off": controller.roll_off}
    if not dataclasses.is_dataclass(controller):
        return {}
    return {field.name: getattr(controller, field.name) for field in dataclasses.fields(controller)}
