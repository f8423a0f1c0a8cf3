"""What a sweep is to run, independent of how a file says it; see `octarm.sweeps.spec_file`."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from octarm.arm.groups import PAPER, Groups, grouped, groups_of
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.arrays import plain
from octarm.declared import Code, word_of
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import DISTURBANCES
from octarm.fields import field_keys, field_kinds
from octarm.formats import to_toml
from octarm.interfaces import Controller, ControllerFactory
from octarm.metrics.metric import SETTLED_AFTER, Metric
from octarm.metrics.table import Catalogue, declared_metrics, measured
from octarm.runs.description import USUAL, unusual
from octarm.runs.folder import gains_of
from octarm.simulation.engines import MUJOCO
from octarm.simulation.start import REST, SHARE
from octarm.units import MISMATCH, Range

ARM, PLANT_MODULES, LAYOUT, SENSING = "arm", "plant_modules", "layout", "sensing"
PLANT = (LAYOUT, PLANT_MODULES, SENSING)


def which(disturbance: str) -> tuple[str, int]:
    """The class of a disturbance of a spec, and which one of that class it is.

    `noise-2` is the second noise, as in `run.json`.
    """
    match = re.fullmatch(r"(.+)-([2-9]|[1-9]\d+)", disturbance)
    return (match[1], int(match[2])) if match else (disturbance, 1)


def keys_of(disturbance: str, code: Mapping[str, Code]) -> dict[str, str]:
    """The fields of a disturbance of a spec by how files spell them; no code is imported."""
    kind = which(disturbance)[0]
    if kind in code:
        return {key: str(said["field"]) for key, said in code[kind].declares.items()}
    return field_keys(DISTURBANCES[kind])


@dataclasses.dataclass(frozen=True, kw_only=True)
class Axis:
    """Something that varies in a sweep.

    Attributes:
        name: of its column: controller, reference, arm, mismatch, plant_modules, layout, sensing,
            or a disturbance such as `noise`, with the key, `noise.time`, when it is not the
            disturbance's first one.
        values: all of them, numbers or words; the smallest and the largest one when it is drawn.
        method: how it is drawn for each seed, the same for every controller and grid cell:
            `uniform` for independent draws, `sobol` for evenly spread ones; empty in the grid.
        disturbance: whose field it is, see `which`; empty for the others.
        field: of the disturbance, as the code spells it.
    """

    name: str
    values: tuple[float | str, ...] = ()
    method: str = ""
    disturbance: str = ""
    field: str = ""

    @property
    def words(self) -> bool:
        """Whether its values are words."""
        return isinstance(self.values[0], str)

    @property
    def apart(self) -> bool:
        """Whether arms that differ in it do not share a batch: words, and sizes of the plant."""
        return self.words or self.name == PLANT_MODULES

    def range(self, code: Mapping[str, Code]) -> Range | None:
        """What its numbers may be, as far as it is known; None for words and counts.

        No code is imported.
        """
        if not self.disturbance:
            return MISMATCH if self.name == "mismatch" else None
        kind = which(self.disturbance)[0]
        if kind in code:
            said = next(x for x in code[kind].declares.values() if x["field"] == self.field)
            return Range(str(said["unit"])) if said["number"] else None
        declared = field_kinds(DISTURBANCES[kind])[self.field]
        return declared if isinstance(declared, Range) else None


SETTINGS = (
    "seed", "episodes", "duration", "settle", "timestep", "control_period", "actuation",
    "integrator", "engine", "batch", "start", "start_share",
)  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepSpec:
    """A sweep: every controller in every cell of a grid, each with the same seeds.

    See `octarm.sweeps.spec_content` for what is not said here.

    Attributes:
        axes: the grid: controller and reference, then what keeps batches apart, then the others.
        random: axes that are drawn.
        duration: of an episode [s].
        settle: when metrics of the steady regime begin [s].
        batch: largest number of arms that are stepped together.
        fixed: fields of disturbances that are the same in all episodes, by disturbance.
        gain_sets: `tuned`, `recommended` or the content of a file of gains, by controller; tuned
            gains where there are any, else recommended ones, for the others.
        gains: where they are not those of the set, by controller [SI].
        arms: their parameters, as `ArmParameters.to_dict` has them, by the values of the axis
            `arm`; the nominal arm has no such axis.
        model: what the controllers believe of every arm before mismatches, likewise; empty where
            that is the arm itself.
        record: episodes to record, by number or by a word.
        code: what is not built in by name, and metrics that are measured as well.
        text: the file that says all of it; empty where it names other files.
    """

    axes: tuple[Axis, ...]
    random: tuple[Axis, ...] = ()
    seed: int = 0
    episodes: int = 1
    duration: float = 10.0
    settle: float = SETTLED_AFTER
    timestep: float | str | None = None
    control_period: float | None = None
    actuation: str = "f-coeff"
    engine: str = MUJOCO
    batch: int = 1024
    integrator: str = "rk4"
    start: str = REST
    start_share: float = SHARE
    fixed: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict[str, Any])
    gain_sets: Mapping[str, Any] = dataclasses.field(default_factory=dict[str, Any])
    gains: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict[str, Any])
    arms: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict[str, Any])
    model: Mapping[str, Any] = dataclasses.field(default_factory=dict[str, Any])
    record: tuple[int | str, ...] = ()
    code: Mapping[str, Code] = dataclasses.field(default_factory=dict[str, Code])
    text: str = dataclasses.field(default="", compare=False)

    @property
    def controllers(self) -> tuple[str, ...]:
        """Names of the controllers."""
        return tuple(str(v) for a in self.axes if a.name == "controller" for v in a.values)

    @property
    def references(self) -> tuple[str, ...]:
        """Names of the desired motions."""
        return tuple(str(v) for a in self.axes if a.name == "reference" for v in a.values)

    @property
    def disturbances(self) -> tuple[str, ...]:
        """Those that act in all episodes, if only with a neutral value; first ones come first."""
        varied = (axis.disturbance for axis in (*self.axes, *self.random) if axis.disturbance)
        return tuple(sorted(dict.fromkeys((*varied, *self.fixed)), key=lambda n: which(n)[1]))

    def arm(self, name: str) -> ArmParameters:
        """The arm of this name; the nominal one for an empty name."""
        return ArmParameters.from_dict(self.arms[name]) if name else nominal_parameters()

    def believed(self, name: str) -> ArmParameters:
        """What controllers believe of the arm of this name, but for mismatches."""
        return ArmParameters.from_dict(self.model) if self.model else self.arm(name)

    def all_believed(self) -> list[ArmParameters]:
        """The same of the arms of the axis `arm`, in its order, or of the nominal one."""
        return [*map(self.believed, self.arms or [""])]

    def groups(self, arm: str, modules: int | None, layout: str = PAPER) -> Groups | None:
        """The groups of the plant for an arm of this name, see `groups_of`."""
        p = self.arm(arm)
        return groups_of(p, modules, layout, groups=grouped(p, self.believed(arm)))

    @property
    def most_modules(self) -> int:
        """The number of modules of the largest arm."""
        return max(self.arm(name).modules for name in self.arms or [""])

    def controller(self, name: str, nominal: Any, factory: ControllerFactory) -> Controller:
        """The controller of this name for a nominal model, with the gains of the spec.

        The factory takes a keyword `gain_set` where the spec has one for the controller.
        """
        gains, word = self.gains.get(name, {}), word_of(name, self.code)
        if name not in self.gain_sets:
            return factory(word, nominal, gains)
        return factory(word, nominal, gains, gain_set=self.gain_sets[name])

    def stated_gains(self, name: str, factory: ControllerFactory) -> dict[str, Any]:
        """The gains of the controller of this name for the first arm, ready for JSON."""
        return gains_of(self.controller(name, self.all_believed()[0], factory))

    def class_of(self, disturbance: str) -> type[Disturbance]:
        """The class of a disturbance of the spec; raises `CodeChanged` as `word_of` does."""
        return DISTURBANCES[word_of(which(disturbance)[0], self.code)]

    def catalogue(self) -> Catalogue:
        """The metrics that are measured; raises `CodeChanged` as `word_of` does."""
        return measured(self.code)

    def metrics(self) -> Mapping[str, Metric]:
        """The same by name; no code is imported."""
        return declared_metrics(self.code)

    def content(self) -> dict[str, Any]:
        """All that the rows depend on, by dotted key, ready for JSON."""
        content = self._settings()
        content |= {f"grid.{axis.name}": axis.values for axis in self.axes}
        content |= {f"random.{a.name}": (*a.values, a.method) for a in self.random}
        content |= {f"gain_set.{name}": choice for name, choice in self.gain_sets.items()}
        content |= {f"arms.{name}": arm for name, arm in self.arms.items()}
        content |= {"model": self.model} if self.model else {}
        for heading, tables in (("disturbance", self.fixed), ("gains", self.gains)):
            content |= {f"{heading}.{n}.{k}": v for n, t in tables.items() for k, v in t.items()}
        content |= {f"code.{name}": each.model_dump() for name, each in self.code.items()}
        return {key: plain(value) for key, value in content.items()}

    def _settings(self) -> dict[str, Any]:
        """The settings by name, those of `USUAL` where they are other ones."""
        return {name: getattr(self, name) for name in SETTINGS if name not in USUAL} | unusual(self)

    def hash(self) -> str:
        """SHA-256 of `content`: files that ask for the same rows have the same."""
        return hashlib.sha256(json.dumps(self.content(), sort_keys=True).encode()).hexdigest()

    def to_toml(self) -> str:
        """A file that `octarm.sweeps.spec_file.parse_spec` makes this spec of."""
        grid, drawn, fixed = dict[str, Any](), dict[str, Any](), dict[str, Any]()
        for axis in self.axes:
            self._put(grid, axis, axis.values)
        for axis in self.random:
            low, high = axis.values
            self._put(drawn, axis, {"low": low, "high": high, "method": axis.method})
        for name, fields in self.fixed.items():
            keys = keys_of(name, self.code).items()
            fixed[name] = {key: fields[field] for key, field in keys if field in fields}
        content = self._settings()
        content |= {"grid": grid, "random": drawn, "disturbance": fixed}
        content |= {"gain_set": self.gain_sets, "gains": self.gains}
        content |= {"arms": self.arms, "model": self.model}
        content |= {"record": {"episodes": self.record}}
        content |= {"code": {name: each.model_dump() for name, each in self.code.items()}}
        return to_toml({key: value for key, value in content.items() if value != {}})

    def _put(self, table: dict[str, Any], axis: Axis, value: Any) -> None:
        """Enters an axis into `[grid]` or `[random]`, that of a disturbance into its own table."""
        key = axis.name
        if axis.disturbance:
            table = table.setdefault("disturbance", {}).setdefault(axis.disturbance, {})
            keys = keys_of(axis.disturbance, self.code).items()
            key = next(key for key, field in keys if field == axis.field)
        table[key] = value
