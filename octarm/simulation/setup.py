"""What arms are loaded with, declared once for single runs, margins and episodes of sweeps."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from dm_control.rl import control

from octarm.arm.groups import PAPER, SUMS, grouped
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance
from octarm.simulation.engines import MUJOCO
from octarm.simulation.environment import load
from octarm.simulation.start import REST, SHARE


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """Arguments of `octarm.load`, which says what they mean; `parameters` are of the true arm."""

    parameters: ArmParameters = dataclasses.field(default_factory=nominal_parameters)
    reference: str = "sine"
    disturbances: Sequence[Disturbance] = ()
    timestep: float | str | None = None
    control_period: float | None = None
    actuation: str = "f-coeff"
    integrator: str = "rk4"
    engine: str = MUJOCO
    plant_modules: int | None = None
    layout: str = PAPER
    sensing: str = SUMS
    start: str = REST
    start_share: float = SHARE

    def load(self, model: ArmParameters, **more: Any) -> control.Environment:
        """The environment for controllers that believe a model, given further arguments.

        An arm of more modules than the model is controlled in groups. Raises what `load` does.
        """
        given: dict[str, Any] = {f.name: getattr(self, f.name) for f in dataclasses.fields(Setup)}
        given["groups"] = grouped(self.parameters, model)
        return load(**given | more)
