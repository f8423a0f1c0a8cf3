"""How a disturbance is drawn that is not built in, as `run.json` remembers it.

Whoever looks at a run need not have, nor import, what a user wrote.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Strict

from octarm.arrays import plain
from octarm.disturbances.episode import Disturbance, Event
from octarm.disturbances.fields import Amount
from octarm.formats import Array, Model

Number = Annotated[float, Strict(False)]  # infinity is a word in JSON
Moment = Annotated[tuple[Number, str], Strict(False)]
Load = Annotated[tuple[Number, Number], Strict(False)]


class Drawn(Model):
    """What the methods of `Disturbance` of the same names answer.

    Attributes:
        moments: times [s] and texts of its events.
        load: mass that the tip carries, and from when on [kg], [s].
        bound: on |tau| [N].
        tilt: of gravity [rad].
    """

    moments: Array[Moment] = ()
    load: Load | None = None
    bound: Number | Array[Number] | None = None
    tilt: Number = 0.0

    @classmethod
    def of(cls, disturbance: Disturbance) -> Drawn:
        """What a disturbance of one arm answers."""
        return cls(
            moments=tuple((float(at), text) for at, text in disturbance.events()),
            load=disturbance.carried(),
            bound=plain(disturbance.input_bound()),
            tilt=float(disturbance.gravity_angle()),
        )

    def events(self) -> Sequence[Event]:
        """The moments at which it begins and ends."""
        return [Event(float(at), str(text)) for at, text in self.moments]

    def carried(self) -> tuple[float, float] | None:
        """The mass that the tip carries and from when on [kg], [s]; None if none."""
        return None if self.load is None else (self.load[0], self.load[1])

    def input_bound(self) -> Amount | None:
        """Bound on |tau| to be drawn, shape () or (2N,) [N]; None if it sets none."""
        return self.bound if isinstance(self.bound, float | None) else np.array(self.bound)

    def gravity_angle(self) -> float:
        """By how much it turns gravity [rad]."""
        return self.tilt
