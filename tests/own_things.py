"""A controller, a reference, a disturbance and a metric of a user's own, a file each."""

from pathlib import Path

LAW = '''
"""A law that is no Law: any frozen dataclass will do that does what a controller does."""

import dataclasses
from typing import Annotated

from controllers.law import GainField
from controllers.scaling import unit
from octarm.interfaces import Command, Knob, NominalModel

UNITS = "N s/m, N m s/rad"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Damper:
    """Q = G^(q_d) - K_v e' - pull e."""

    nominal: NominalModel
    K_v: Annotated[object, GainField("damping", UNITS, lambda model: 4.0, Knob("K_v"))]
    pull: float = 200.0

    def initial_state(self, batch_shape=()):
        return None

    def knobs(self):
        return (Knob("K_v", gains=("K_v",)),)

    def scales(self):
        return {"K_v": unit(UNITS, self.nominal), "pull": 1.0}

    def __call__(self, state, measurement, reference):
        weight = self.nominal.potential_force(reference.q)
        damping = self.K_v * (measurement.v - reference.v)
        return Command(weight - damping - self.pull * (measurement.q - reference.q)), state
'''

MOTION = '''
"""All bends swing in phase."""

import dataclasses
from typing import Annotated

import numpy as np

from octarm.fields import Quantity
from octarm.interfaces import Reference


@dataclasses.dataclass(frozen=True, eq=False)
class Swing:
    rest: np.ndarray
    amplitude: Annotated[float, Quantity("rad", at_least=0.0)] = 0.1

    def __call__(self, t):
        size = np.zeros_like(self.rest)
        size[..., self.rest.shape[-1] // 2 :] = self.amplitude
        w = 2.0 * np.pi * 0.5
        sine = size * np.sin(w * t)
        return Reference(self.rest + sine, size * w * np.cos(w * t), -w * w * sine)
'''

GUST = '''
"""A wind."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from octarm.disturbances.episode import Force
from octarm.fields import Amount, Quantity


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Gust(Force):
    """A wind that bends the last module, from the time `at` on."""

    name: ClassVar[str] = "gust"
    speed: Annotated[Amount, Quantity("m/s", at_least=0.0, at_most=40.0, usual=(0.0, 8.0))]
    drag: Annotated[Amount, Quantity("N m s^2/m^2", key="c")] = 0.01
    at: Annotated[Amount, Quantity("s", at_least=0.0)] = 0.0

    def start(self, episode):
        def force(step, q):
            out = np.zeros_like(q)
            out[..., -1] = self.drag * self.speed**2 * (step * episode.timestep >= self.at)
            return out

        return force

    def events(self):
        return self.span(self.at)
'''

REACH = '''
"""How far the arm is bent."""

import numpy as np

from octarm.metrics.metric import Accumulator, Metric


class Reach(Accumulator):
    """The largest sum of all bends."""

    metrics = {"largest_bend": Metric("arm", ("rad",), "largest sum of all bends", "more")}

    def __init__(self, first, settings):
        self._largest = np.zeros(first["q"].shape[:-1])

    def update(self, rows, steady):
        bends = rows["q"][..., rows["q"].shape[-1] // 2 :]
        self._largest = np.maximum(self._largest, np.abs(bends.sum(axis=-1)).max(axis=0))

    def result(self):
        return {"largest_bend": self._largest.copy()}
'''

SPEC = """settle = 0.1
seed = 3
episodes = 2
duration = 0.3
batch = 4
timestep = 0.001
metric = "./reach.py:Reach"

[grid]
controller = ["./damper.py:Damper", "pd"]
reference = ["./swing.py:Swing:amplitude=4deg", "sine"]

[grid.disturbance]
"./gust.py:Gust" = [0.0, 3.0]

[disturbance]
"./gust.py:Gust".c = 0.02
noise = 0.1

[gains."./damper.py:Damper"]
K_v = 3.0

[record]
episodes = ["worst"]
"""


def write_things(folder: Path) -> Path:
    """Writes `damper.py`, `swing.py`, `gust.py`, `reach.py` and `spec.toml`; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {"damper.py": LAW, "swing.py": MOTION, "gust.py": GUST, "reach.py": REACH}
    for name, text in {**files, "spec.toml": SPEC}.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder
