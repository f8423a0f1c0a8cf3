"""A sweep's TOML file, checked word by word before anything happens.

At the top stand `seed`, `episodes` (seeds in each cell), `duration`, `timestep`, `control_period`
[s], `actuation`, `batch` and `gain_set`, and `controller`, `reference` and `mismatch` where they
have one value. The tables are:

- `[grid]`: `controller`, `reference` and `mismatch` as lists;
- `[grid.disturbance]`: lists of values of disturbances, spelt as on the command line: `noise` for
  the value that goes without a key there, `noise.time` for one with a key;
- `[random]` with `mismatch`, and `[random.disturbance]`: what is drawn for each seed,
  `payload = { low = 0.0, high = 0.2, method = "sobol" }`; `uniform` is the usual method;
- `[disturbance]`: what is the same in all episodes, `noise.time = 0.01`;
- `[gains.NAME]`: gains of a controller;
- `[record]`: `episodes`, a list of numbers, `"worst"`, `"median"` and `"diverged"`.

A further disturbance of the same class has its number behind its name, from 2 on: `pulse-2`,
`noise-2.time`. It has columns and random numbers of its own.

The gain set is `"tuned"`, `"recommended"` or a file of `octarm tune`, beside the spec, for all
controllers; or there is a table `[gain_set]` with one of these for each. Gains of a file become
part of the spec that the sweep keeps.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple, cast

import pydantic
from pydantic import AfterValidator, Field, FiniteFloat

from octarm.arm.actuation import ACTUATIONS
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.fields import Words, field_defaults, field_keys, field_kinds
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import FileError, OctarmError, closest
from octarm.formats import Array, Document, Model, one_of, parse_toml, read_toml, spelt
from octarm.references import REFERENCES
from octarm.sweeps.spec import Axis, GridAxis, RandomAxis, SweepSpec, class_of, which

RECORDED = ("worst", "median", "diverged")  # episodes that can be recorded without their number
METHODS = ("uniform", "sobol")
GAIN_SETS = ("tuned", "recommended")

_OWN = ("controller", "reference", "mismatch")  # axes of every sweep


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if not values:
        raise ValueError("a list with a value")
    if len(set(values)) < len(values):
        raise ValueError("without the same value twice")
    return values


Reference = Annotated[str, one_of(REFERENCES)]
Mismatch = Annotated[float, Field(gt=-1.0, le=1e6)]
Positive = Annotated[FiniteFloat, Field(gt=0.0)]
Number = Annotated[float, pydantic.AllowInfNan(True)]
Values = Annotated[Array[Number] | Array[str], AfterValidator(_distinct)]
Gain = float | list[float]


class Bounds(Model):
    """Between which values an axis is drawn."""

    low: FiniteFloat
    high: FiniteFloat
    method: Annotated[str, one_of(METHODS)] = "uniform"

    @pydantic.model_validator(mode="after")
    def _ordered(self) -> Bounds:
        if not self.low < self.high:
            raise ValueError("such that low is below high")
        return self


class MismatchBounds(Bounds):
    """Bounds of the mismatch of the nominal model."""

    low: Mismatch
    high: Mismatch


class Grid(Model):
    """The table `[grid]`."""

    controller: Annotated[Array[str], AfterValidator(_distinct)] | None = None
    reference: Annotated[Array[Reference], AfterValidator(_distinct)] | None = None
    mismatch: Annotated[Array[Mismatch], AfterValidator(_distinct)] | None = None
    disturbance: dict[str, Any] = Field(default_factory=dict)


class Random(Model):
    """The table `[random]`."""

    mismatch: MismatchBounds | None = None
    disturbance: dict[str, Any] = Field(default_factory=dict)


class Record(Model):
    """The table `[record]`."""

    episodes: Array[Annotated[int, Field(ge=0)] | Annotated[str, one_of(RECORDED)]] = ()


class SpecFile(Model):
    """The whole file; fields of disturbances are read in `_fields`."""

    seed: Annotated[int, Field(ge=0)] = 0
    episodes: Annotated[int, Field(ge=1)] = 1
    duration: Positive = 10.0
    timestep: Positive | None = None
    control_period: Positive | None = None
    actuation: Annotated[str, one_of(ACTUATIONS)] = "f-coeff"
    batch: Annotated[int, Field(ge=1)] = 1024
    controller: str | None = None
    reference: Reference | None = None
    mismatch: Mismatch | None = None
    gain_set: str | dict[str, str] | None = None
    grid: Grid = Field(default_factory=Grid)
    random: Random = Field(default_factory=Random)
    disturbance: dict[str, Any] = Field(default_factory=dict)
    gains: dict[str, dict[str, Gain]] = Field(default_factory=dict)
    record: Record = Field(default_factory=Record)


class GainFile(Model):
    """What a sweep reads of a file of `octarm tune`."""

    model_config = pydantic.ConfigDict(extra="ignore")

    controller: str
    modules: int
    gains: dict[str, Gain]


def read_spec(path: str | Path) -> SweepSpec:
    """The spec in a TOML file.

    Raises:
        OctarmError: if it is not a valid spec; the sentence names the line.
        FileError: if the file cannot be read.
    """
    return _spec(read_toml(path))


def parse_spec(text: str, file: str = "spec.toml") -> SweepSpec:
    """The spec in a TOML text; `file` is its name in error messages.

    Names of controllers and their gains are left to whoever makes controllers.

    Raises:
        OctarmError: if it is not a valid spec; the sentence names the line.
    """
    return _spec(parse_toml(text, file))


def _spec(document: Document) -> SweepSpec:
    content = document.read(SpecFile)
    grid, drawn = _axes(document, content)
    controllers = [str(v) for axis in grid if axis.name == "controller" for v in axis.values]
    sets, gains = _gains(document, content, controllers)
    fixed: dict[str, dict[str, Any]] = {}
    for field in _fields(document, "disturbance"):
        if (field.disturbance, field.name) in {(a.disturbance, a.field) for a in (*grid, *drawn)}:
            raise document.error(f"{field.column} is an axis, too", *field.keys)
        value = document.read(cast(Any, Number | str | list[Number]), *field.keys)
        fixed.setdefault(field.disturbance, {})[field.name] = value
    files = [choice for choice in sets.values() if choice not in GAIN_SETS]
    spec = SweepSpec(
        axes=grid,
        random=drawn,
        **content.model_dump(include={"seed", "episodes", "duration", "timestep", "control_period",
                                      "actuation", "batch"}),
        fixed=fixed,
        gain_sets={name: "recommended" if c in files else c for name, c in sets.items()},
        gains=gains,
        record=content.record.episodes,
        text="" if files else document.text,
    )  # fmt: skip
    for name in spec.disturbances:
        _try(spec, name, document)
    return spec


def _axes(
    document: Document, content: SpecFile
) -> tuple[tuple[GridAxis, ...], tuple[RandomAxis, ...]]:
    """All axes, in the order in which episodes are counted, the slowest first."""
    axes: list[Axis] = [_own_axis(name, document, content) for name in _OWN]
    for field in _fields(document, "grid", "disturbance"):
        values = document.read(cast(Any, Values), *field.keys)
        axes.append(field.axis(GridAxis, values=values))
    for field in _fields(document, "random", "disturbance"):
        if isinstance(field_kinds(class_of(field.disturbance))[field.name], Words):
            raise document.error(
                f"{field.column} is made of words: it cannot be drawn", *field.keys
            )
        if field.column in [axis.name for axis in axes]:
            raise document.error(f"{field.column} is an axis of the grid, too", *field.keys)
        bounds = document.read(Bounds, *field.keys)
        axes.append(field.axis(RandomAxis, **bounds.model_dump()))
    order = list(DISTURBANCES)

    def rank(axis: Axis) -> tuple[bool, int, int, str]:
        if axis.name in _OWN:
            return not axis.words, _OWN.index(axis.name) - len(_OWN), 0, ""
        kind, place = which(axis.disturbance)
        return not axis.words, order.index(kind), place, axis.field

    axes.sort(key=rank)
    return (
        tuple(axis for axis in axes if isinstance(axis, GridAxis)),
        tuple(axis for axis in axes if isinstance(axis, RandomAxis)),
    )


def _own_axis(name: str, document: Document, content: SpecFile) -> Axis:
    """Controller, reference or mismatch: in the grid, one value at the top, or drawn."""
    single = getattr(content, name)
    places = {
        ("grid", name): getattr(content.grid, name),
        (name,): None if single is None else (single,),
        ("random", name): content.random.mismatch if name == "mismatch" else None,
    }
    given = {keys: value for keys, value in places.items() if value is not None}
    if len(given) > 1:
        raise document.error(f"{name} is given twice, here and elsewhere", *next(iter(given)))
    if not given and name == "controller":
        raise document.error("there is no controller; [grid] needs controller = [...]", "grid")
    value = next(iter(given.values()), ("sine",) if name == "reference" else (0.0,))
    if isinstance(value, Bounds):
        return RandomAxis(name=name, **value.model_dump())
    return GridAxis(name=name, values=value)


class _Field(NamedTuple):
    """A field of a disturbance in the file: `noise = ...`, or `time = ...` in a table `noise`.

    Attributes:
        disturbance: see `which`.
        name: of the field, as the code spells it.
        column: its name as an axis.
        keys: of its value in the file.
    """

    disturbance: str
    name: str
    column: str
    keys: tuple[str, ...]

    def axis(self, kind: Any, **values: Any) -> Axis:
        """An axis of this field."""
        return kind(name=self.column, disturbance=self.disturbance, field=self.name, **values)


def _fields(document: Document, *place: str) -> Iterator[_Field]:
    """The fields of disturbances in a table."""
    table: Any = document.content
    for key in place:
        table = table.get(key, {})
    for name, value in dict[str, Any](table).items():
        if which(name).kind not in DISTURBANCES:
            hint = closest(name, DISTURBANCES)
            raise document.error(f"unknown disturbance {name!r}{hint}", *place, name)
        fields = field_keys(class_of(name))
        first = next(iter(fields))
        inner = cast(dict[str, Any], value) if isinstance(value, dict) else None
        bare = inner is None or (inner and inner.keys() <= Bounds.model_fields.keys())
        for key in [first] if bare or inner is None else inner:
            keys = (*place, name) if bare else (*place, name, key)
            if key not in fields:
                raise document.error(f"{name} has no key {key!r}{closest(key, fields)}", *keys)
            column = name if key == first else f"{name}.{key}"
            column = f"disturbance.{column}" if column in _OWN else column
            yield _Field(name, fields[key], column, keys)


def _gains(
    document: Document, content: SpecFile, controllers: list[str]
) -> tuple[dict[str, str], dict[str, dict[str, Any]]]:
    """The gain set of each controller, and the gains that differ from it, those of files included.

    Raises:
        OctarmError: for what is no set of gains, or is of another controller.
    """
    sets = content.gain_set or {}
    if isinstance(sets, str):
        sets = dict.fromkeys(controllers, sets)
    for table, names in (("gain_set", sets), ("gains", content.gains)):
        for name in names:
            if name not in controllers:
                hint = closest(name, controllers)
                message = f"gains of {name!r}, which is no controller of this sweep{hint}"
                raise document.error(message, table, name)
    gains: dict[str, dict[str, Any]] = {}
    for name, choice in sets.items():
        if choice.endswith(".toml"):
            try:
                gains[name] = _gains_of_file(Path(document.file).parent / choice, name)
            except FileError as error:
                raise document.error(str(error), "gain_set", name) from None
        elif choice not in GAIN_SETS:
            known = ", ".join(GAIN_SETS)
            message = f"unknown gain_set {spelt(choice)}; known are {known}, or NAME.toml"
            raise document.error(message, "gain_set", name)
    for name, own in content.gains.items():
        gains[name] = gains.get(name, {}) | own
    return sets, gains


def _gains_of_file(path: Path, controller: str) -> dict[str, Any]:
    """The gains in a file of `octarm tune`."""
    document, modules = read_toml(path), nominal_parameters().modules
    file = document.read(GainFile)
    if file.controller != controller:
        message = f"holds gains of {spelt(file.controller)}, not of {controller}"
        raise document.error(message, "controller")
    if file.modules != modules:
        message = f"is for an arm of {file.modules} modules; this one has {modules}"
        raise document.error(message, "modules")
    return file.gains


def _try(spec: SweepSpec, name: str, document: Document) -> None:
    """Makes a disturbance with every value it is to have.

    Raises:
        OctarmError: if one is missing or out of range.
    """
    axes = [axis for axis in (*spec.axes, *spec.random) if axis.disturbance == name]
    fixed = spec.fixed.get(name, {})
    tables = [
        ("random" if isinstance(axis, RandomAxis) else "grid", "disturbance") for axis in axes
    ]
    place = (*(tables[0] if tables else ("disturbance",)), name)
    kind, number = which(name)
    before = kind if number == 2 else f"{kind}-{number - 1}"
    if number > 1 and before not in spec.disturbances:
        raise document.error(f"there is a {name}, but no {before}", *place)
    cls: Any = DISTURBANCES[kind]
    given = {*field_defaults(cls), *fixed, *(axis.field for axis in axes)}
    for key, field in field_keys(class_of(name)).items():
        if field not in given:
            raise document.error(f"{name} needs a value of {key}", *place)
    # Side by side suffices: what a value may be does not depend on the other fields' values.
    for values in itertools.zip_longest(*(axis.probes for axis in axes)) if axes else [()]:
        tried = {
            axis.field: axis.probes[0] if value is None else value
            for axis, value in zip(axes, values, strict=True)
        }
        try:
            cls(**fixed, **tried)
        except OctarmError as error:
            raise document.error(str(error), *place) from None
