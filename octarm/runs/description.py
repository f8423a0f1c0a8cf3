"""What `run.json` holds, key by key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat

from octarm.arm.groups import SUMS
from octarm.declared import Code
from octarm.disturbances.ledger import Drawn
from octarm.formats import Array, Model
from octarm.metrics.metric import SETTLED_AFTER
from octarm.simulation.start import REST, SHARE

Positive = Annotated[FiniteFloat, Field(gt=0.0)]
_Numbers = float | None | Array[float | None]  # what is not finite is null


class _Table(Model, extra="ignore"):
    """A table of `run.json` of which more may be there than is read."""


class _Named(_Table):
    name: str


class _Controller(_Named):
    gains: dict[str, Any]


class _Disturbance(_Named):
    asked: dict[str, Any]
    delivered: dict[str, Any] | None = None
    drawn: Drawn | None = None


class FinerPlant(_Table):
    """Which plant of more modules it was, see `octarm.arm.groups`."""

    modules: Annotated[int, Field(ge=1)]
    layout: str
    sensing: str = SUMS
    parameters: dict[str, Any] | None = None  # of an arm that is the plant itself


class _Coordinate(_Table):
    name: str
    unit: str


class Description(_Table):
    """All that is read of `run.json`; of a run that is run again `REPEATED` must be there."""

    controller: _Controller
    parameters: dict[str, Any]
    reference: _Named
    code: dict[str, Code] = Field(default_factory=dict)
    plant: FinerPlant | None = None
    settle: Annotated[FiniteFloat, Field(ge=0.0)] = SETTLED_AFTER
    start: str = REST
    start_share: FiniteFloat = SHARE
    spawn_key: Array[Annotated[int, Field(ge=0, lt=2**32)]] = ()
    status: Literal["running", "ok", "diverged", "interrupted"]
    coordinates: Array[_Coordinate] = ()
    nominal: dict[str, Any] = Field(default_factory=dict)
    disturbances: Array[_Disturbance] = ()
    seed: Annotated[int, Field(ge=0)] = 0
    duration: Positive | None = None
    timestep: Positive | None = None
    control_period: Positive | None = None
    actuation: str | None = None
    integrator: str | None = None
    engine: str | None = None
    metrics: dict[str, _Numbers] = Field(default_factory=dict)
    message: str = ""
    versions: dict[str, str] = Field(default_factory=dict)
    host: dict[str, str | int | None] = Field(default_factory=dict)
    digest: str = ""
    command: str = ""


REPEATED = (
    "nominal", "disturbances", "seed", "duration", "timestep", "control_period", "actuation",
    "integrator", "engine",
)  # fmt: skip

# Settings that `run.json` and the manifest of a sweep have only where they are other ones.
USUAL: Mapping[str, Any] = {"settle": SETTLED_AFTER, "start": REST, "start_share": SHARE}


def unusual(thing: Any) -> dict[str, Any]:
    """The settings of an experiment or a sweep that are not the `USUAL` ones, by name."""
    values = {name: getattr(thing, name) for name in USUAL}
    return {name: value for name, value in values.items() if value != USUAL[name]}
