"""What the TOML file of a sweep may hold; `octarm.sweeps.spec_file` reads it.

At the top stand `seed`, `episodes` (seeds in each cell), `duration`, `settle` (when metrics of the
steady regime begin), `timestep` (or `"auto"`), `control_period` [s], `actuation`, `integrator`,
`engine`, `batch`, `start` and `start_share` (where episodes begin, as in `octarm.load`) and
`gain_set`, and `controller`, `reference`, `mismatch`, `plant_modules`, `layout` and `sensing` (of a
plant of more modules, see `octarm.arm.groups`) where they have one value. The tables are:

- `[grid]`: `controller`, `reference`, `mismatch`, `plant_modules`, `layout`, `sensing` as lists;
- `[grid.disturbance]`: lists of values of disturbances, spelt as on the command line: `noise` for
  the value that goes without a key there, `noise.time` for one with a key;
- `[random]` with `mismatch`, and `[random.disturbance]`: what is drawn for each seed,
  `payload = { low = 0.0, high = 0.2, method = "sobol" }`; `uniform` is the usual method;
- `[disturbance]`: what is the same in all episodes, `noise.time = 0.01`;
- `[gains.NAME]`: gains of a controller in SI, or with a unit, `"15/s"`; also `roll_off`, see
  `octarm.roll_off` [Hz];
- `[arm]`: the arm, as in a file of one (`octarm.arm.file`), instead of `arm = "my-arm.toml"`;
- `[record]`: `episodes`, a list of numbers, `"worst"`, `"median"` and `"diverged"`.

`model`, at the top, is what the controllers believe of every arm before mismatches, if that is not
the arm: a file of an arm, or one that comes with octarm. An arm of more modules is controlled in as
many groups as the model has modules. The spec that the sweep keeps has its numbers in `[model]`.

An arm is a file, beside the spec, or one that comes with octarm; `arm` is a key at the top, or a
list in `[grid]`. Its numbers become part of the spec that the sweep keeps, in a table `[arms.NAME]`
as `run.json` has them.

A number may be a text with a unit, such as `"40%"`, `"100 g"`, `"15deg"` or `"60ms"`.

Controllers, references and disturbances may be `MODULE:NAME` or `FILE.py:NAME`, and so may those of
`metric`, what is measured as well. A file is looked for beside the spec. Such things get short
names; these, and what they stand for, are in the table `[code]` of the spec that the sweep keeps.
Whoever reads that one imports nothing: see `octarm.declared`. A reference may have parameters
behind it, `"sine:amplitude=0.2,frequency=1"`, or be a file of samples, `"file:./motion.csv"`.

A further disturbance of the same class has its number behind its name, from 2 on: `pulse-2`,
`noise-2.time`. It has columns and random numbers of its own.

The gain set is `"tuned"`, `"recommended"` or a file of `octarm tune`, beside the spec, for all
controllers; or there is a table `[gain_set]` with one of these for each. What is in a file becomes
part of the spec that the sweep keeps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, cast

import pydantic
from pydantic import AfterValidator, Field, FiniteFloat

from octarm.arm.actuation import ACTUATIONS
from octarm.arm.groups import SENSINGS
from octarm.arm.modes import INTEGRATORS, LONGEST_STEP, SHORTEST_STEP
from octarm.arm.parameters import MOST_MODULES
from octarm.arm.rod import LAYOUTS
from octarm.declared import Code, Declared, absolute, named
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError
from octarm.formats import Array, Document, Model, one_of, spelt
from octarm.metrics.metric import SETTLED_AFTER
from octarm.metrics.table import ACCUMULATORS
from octarm.references import REFERENCES, parameters_of
from octarm.simulation.engines import ENGINES, MUJOCO
from octarm.simulation.start import REST, SHARE, STARTS
from octarm.simulation.steps import AUTO
from octarm.sweeps.spec import which
from octarm.units import is_like_a_number

RECORDED = ("worst", "median", "diverged")  # episodes that can be recorded without their number
METHODS = ("uniform", "sobol")
GAIN_SETS = ("tuned", "recommended")
FIXED, GRID, RANDOM = ("disturbance",), ("grid", "disturbance"), ("random", "disturbance")

# Whoever makes controllers knows which are built in, and what a controller is.
_CONTROLLERS: Declared[Any] = Declared("controller", {}, lambda thing: "")


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if not values:
        raise ValueError("a list with a value")
    if len(set(values)) < len(values):
        raise ValueError("without the same value twice")
    return values


def _step(value: float | str) -> float | str:
    if value != AUTO and not (isinstance(value, float) and SHORTEST_STEP <= value <= LONGEST_STEP):
        raise ValueError(f"{spelt(AUTO)}, or a number from {SHORTEST_STEP:g} to {LONGEST_STEP:g}")
    return value


def _number_text(text: str) -> str:
    if not is_like_a_number(text):
        raise ValueError("a number")
    return text


Distinct = AfterValidator(_distinct)
Mismatch = Annotated[float, Field(gt=-1.0, le=1e6)]
Layout = Annotated[str, one_of(LAYOUTS)]
Sensing = Annotated[str, one_of(SENSINGS)]
Modules = Annotated[int, Field(ge=1, le=MOST_MODULES)]
Positive = Annotated[FiniteFloat, Field(gt=0.0)]
Step = Annotated[float | str, AfterValidator(_step)]
Number = Annotated[float, pydantic.AllowInfNan(True)]
GainText = Annotated[str, AfterValidator(_number_text)]  # in which unit, its controller knows
Gain = float | GainText | list[float | GainText]


# What users mean by keys that there are not.
_DISTURBANCES = {name: f"'disturbance.{name}'" for name in DISTURBANCES}
_SEEDS = "'episodes' at the top, the number of seeds in each cell"
_IN_A_CELL = dict.fromkeys(("seed", "seeds", "episodes"), _SEEDS)


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

    meant: ClassVar[Mapping[str, str]] = _DISTURBANCES | _IN_A_CELL

    controller: Annotated[Array[str], Distinct] | None = None
    reference: Annotated[Array[str], Distinct] | None = None
    mismatch: Annotated[Array[Mismatch], Distinct] | None = None
    plant_modules: Annotated[Array[Modules], Distinct] | None = None
    layout: Annotated[Array[Layout], Distinct] | None = None
    sensing: Annotated[Array[Sensing], Distinct] | None = None
    arm: Annotated[Array[str], Distinct] | None = None
    disturbance: dict[str, Any] = Field(default_factory=dict)


class Random(Model):
    """The table `[random]`."""

    meant: ClassVar[Mapping[str, str]] = _DISTURBANCES | _IN_A_CELL

    mismatch: MismatchBounds | None = None
    disturbance: dict[str, Any] = Field(default_factory=dict)


class RecordedEpisodes(Model):
    """The table `[record]`."""

    episodes: Array[Annotated[int, Field(ge=0)] | Annotated[str, one_of(RECORDED)]] = ()


class GainFile(Model):
    """What a sweep reads of a file of `octarm tune`."""

    model_config = pydantic.ConfigDict(extra="ignore")

    controller: str
    gains: dict[str, Gain]
    arm: dict[str, float]


class SpecFile(Model):
    """The whole file; fields of disturbances are read in `_fields`."""

    meant: ClassVar[Mapping[str, str]] = _DISTURBANCES | {"seeds": _SEEDS}

    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 0
    episodes: Annotated[int, Field(ge=1)] = 1
    duration: Positive = 10.0
    settle: Annotated[FiniteFloat, Field(ge=0.0)] = SETTLED_AFTER
    timestep: Step | None = None
    control_period: Annotated[FiniteFloat, Field(gt=0.0, le=10.0)] | None = None
    actuation: Annotated[str, one_of(ACTUATIONS)] = "f-coeff"
    engine: Annotated[str, one_of(ENGINES)] = MUJOCO
    batch: Annotated[int, Field(ge=1)] = 1024
    integrator: Annotated[str, one_of(INTEGRATORS)] = "rk4"
    start: Annotated[str, one_of(STARTS)] = REST
    start_share: Annotated[float, Field(gt=0.0, le=1.0)] = SHARE
    controller: str | None = None
    reference: str | None = None
    metric: str | Array[str] = ()  # those that are not built in are in `code`
    mismatch: Mismatch | None = None
    plant_modules: Modules | None = None
    layout: Layout | None = None
    sensing: Sensing | None = None
    gain_set: str | dict[str, str | GainFile] | None = None
    grid: Grid = Grid()
    random: Random = Random()
    disturbance: dict[str, Any] = Field(default_factory=dict)
    gains: dict[str, dict[str, Gain]] = Field(default_factory=dict)
    arm: str | dict[str, Any] | None = None
    arms: dict[str, dict[str, Any]] = Field(default_factory=dict)
    model: str | dict[str, Any] | None = None
    record: RecordedEpisodes = RecordedEpisodes()
    code: dict[str, Code] = Field(default_factory=dict)


def short_names(document: Document) -> tuple[dict[tuple[str, str], str], dict[str, Code]]:
    """Short names by kind and word, and the code that they stand for, by short name.

    Raises:
        OctarmError: for code that is not there or is not of its kind; the sentence names the line.
    """
    known: Mapping[str, Any] = document.content.get("code", {})
    folder = Path(document.file).parent
    words: dict[tuple[str, str], tuple[Declared[Any], str]] = {}
    for table, word, keys in _words(document.content):
        path = absolute(word, folder)
        if {word, table.named_by(word).word} & known.keys():
            continue
        if table is _CONTROLLERS and ":" not in word:
            continue
        try:
            table.code(path)
            if table is REFERENCES:
                parameters_of(path)
        except OctarmError as error:
            if ":" not in word and not word.endswith(".py"):
                continue  # a misspelt name, of which more is said where it is read
            raise document.error(str(error), *keys) from None
        words[table.kind, word] = table, path
    names, code = named(words.values())
    return dict(zip(words, names, strict=True)), code


def _words(content: Mapping[str, Any]) -> Iterator[tuple[Declared[Any], str, tuple[str, ...]]]:
    for place in ((), ("grid",)):
        for table in (_CONTROLLERS, REFERENCES, ACCUMULATORS):
            value = table_at(content, *place).get(table.kind)
            items = cast("list[Any]", value) if isinstance(value, list) else [value]
            for word in items:
                if isinstance(word, str):
                    yield table, word, (*place, table.kind)
    for place in (FIXED, GRID, RANDOM):
        for word in table_at(content, *place):
            yield DISTURBANCES, which(word)[0], (*place, word)


def table_at(content: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """The table at these keys; an empty one if there is none."""
    for key in keys:
        value = content.get(key)
        content = cast("dict[str, Any]", value) if isinstance(value, dict) else {}
    return cast("dict[str, Any]", content)
