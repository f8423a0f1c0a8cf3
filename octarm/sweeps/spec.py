"""What a sweep is to run."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

Value = float | str


class Which(NamedTuple):
    """A disturbance of a spec: the name of its class, and which one of that class it is."""

    kind: str
    place: int


def which(disturbance: str) -> Which:
    """What a name in a spec means: `noise-2` is the second noise, as in `run.json`."""
    found = re.fullmatch(r"(.+)-([2-9]|[1-9]\d+)", disturbance)
    return Which(found[1], int(found[2])) if found else Which(disturbance, 1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Axis:
    """Something that takes each value of a list.

    Attributes:
        name: of its column: controller, reference, mismatch, or a disturbance such as `noise`,
            with the key, `noise.time`, when it is not the disturbance's first one.
        values: numbers, or words.
        disturbance: whose field it is, see `which`; empty for controller, reference and mismatch.
        field: of the disturbance, as the code spells it.
    """

    name: str
    values: tuple[Value, ...]
    disturbance: str = ""
    field: str = ""

    @property
    def words(self) -> bool:
        """Whether its values are words: arms that differ in them do not share a batch."""
        return isinstance(self.values[0], str)

    @property
    def probes(self) -> tuple[Value, ...]:
        """Values to try the axis with."""
        return self.values


@dataclasses.dataclass(frozen=True, kw_only=True)
class RandomAxis:
    """Something that is drawn for each seed, the same for every controller and grid cell.

    Attributes:
        name: as in `Axis`.
        low: smallest value.
        high: largest value.
        method: `uniform` for independent draws, `sobol` for evenly spread ones.
        disturbance: as in `Axis`.
        field: as in `Axis`.
    """

    name: str
    low: float
    high: float
    method: str = "uniform"
    disturbance: str = ""
    field: str = ""

    @property
    def probes(self) -> tuple[Value, ...]:
        """Values to try the axis with."""
        return (self.low, self.high)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepSpec:
    """A sweep: every controller in every cell of a grid, each with the same seeds.

    Attributes:
        axes: the grid: controller and reference, then axes of words, then the others.
        random: axes that are drawn.
        seed: of all that is random.
        episodes: seeds in each cell of the grid.
        duration: of an episode [s].
        timestep: physics step [s]; that of models/octarm.xml when None.
        control_period: time between control actions [s]; one physics step when None.
        actuation: see `octarm.arm.actuation`.
        batch: largest number of arms that are stepped together.
        fixed: fields of disturbances that are the same in all episodes, by disturbance.
        gain_sets: `tuned` or `recommended`, by controller; tuned gains where there are any, else
            recommended ones, for the others.
        gains: where they are not those of the set, by controller.
        record: episodes to record, by number or by a word.
        text: the file it came from.
        alone: whether the text says it all: it names no other file.
    """

    axes: tuple[Axis, ...]
    random: tuple[RandomAxis, ...] = ()
    seed: int = 0
    episodes: int = 1
    duration: float = 10.0
    timestep: float | None = None
    control_period: float | None = None
    actuation: str = "f-coeff"
    batch: int = 1024
    fixed: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict[str, Any])
    gain_sets: Mapping[str, str] = dataclasses.field(default_factory=dict[str, str])
    gains: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict[str, Any])
    record: tuple[int | str, ...] = ()
    text: str = ""
    alone: bool = True

    @property
    def controllers(self) -> tuple[str, ...]:
        """Names of the controllers."""
        return tuple(str(v) for a in self.axes if a.name == "controller" for v in a.values)

    @property
    def disturbances(self) -> tuple[str, ...]:
        """Those that act in all episodes, if only with a neutral value; first ones come first."""
        varied = (axis.disturbance for axis in (*self.axes, *self.random) if axis.disturbance)
        return tuple(sorted(dict.fromkeys((*varied, *self.fixed)), key=lambda n: which(n).place))

    def content(self) -> dict[str, Any]:
        """All that the rows depend on, by dotted key, ready for JSON."""
        plain = ("seed", "episodes", "duration", "timestep", "control_period", "actuation", "batch")
        content: dict[str, Any] = {name: getattr(self, name) for name in plain}
        content |= {f"grid.{axis.name}": list(axis.values) for axis in self.axes}
        content |= {f"random.{a.name}": [a.low, a.high, a.method] for a in self.random}
        content |= {f"gain_set.{name}": choice for name, choice in self.gain_sets.items()}
        for heading, tables in (("disturbance", self.fixed), ("gains", self.gains)):
            content |= {f"{heading}.{n}.{k}": v for n, t in tables.items() for k, v in t.items()}
        return {key: _plain(value) for key, value in content.items()}

    def hash(self) -> str:
        """SHA-256 of `content`: files that ask for the same rows have the same."""
        return hashlib.sha256(json.dumps(self.content(), sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Infinity as a word: JSON has no number for it."""
    if isinstance(value, list):
        return [_plain(item) for item in cast(list[Any], value)]
    return str(value) if isinstance(value, float) and math.isinf(value) else value
