"""A sweep's TOML file, checked word by word before anything happens.

What it may hold stands in `octarm.sweeps.spec_content`.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, cast

from octarm.arm.file import arm_of, read_arm
from octarm.arm.groups import grouped, groups_of
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.declared import short_name, word_of
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import FileError, closest, quoted
from octarm.fields import field_defaults, field_keys
from octarm.formats import Array, Document, parse_toml, read_toml, spelt
from octarm.references import REFERENCES
from octarm.sweeps.spec import ARM, PLANT, PLANT_MODULES, SETTINGS, Axis, SweepSpec, keys_of, which
from octarm.sweeps.spec_content import (
    FIXED,
    GAIN_SETS,
    GRID,
    RANDOM,
    Bounds,
    Distinct,
    GainFile,
    Number,
    SpecFile,
    short_names,
    table_at,
)  # fmt: skip
from octarm.units import MISMATCH, PERIOD, Range, is_like_a_number

# The units of what is no field of a disturbance; numbers may be texts with another unit.
_UNITS = {
    ("duration",): Range("s"),
    ("settle",): Range("s"),
    ("timestep",): Range("s"),
    ("control_period",): PERIOD,
    ("start_share",): Range("1"),
    ("mismatch",): MISMATCH,
    ("grid", "mismatch"): MISMATCH,
    ("random", "mismatch"): MISMATCH,
}
_OWN = ("controller", "reference", ARM, *PLANT, "mismatch")  # in their order, slowest first
_USUAL: Mapping[str, Any] = {"reference": ("sine",), "mismatch": (0.0,)}
_VALUES: Any = Annotated[Array[Number] | Array[str], Distinct]
_VALUE: Any = Number | str | list[Number]


def read_spec(path: str | Path) -> SweepSpec:
    """The spec in a TOML file.

    Raises OctarmError with the line where it is not valid, FileError if it cannot be read.
    """
    return _Reader(read_toml(path)).spec()


def parse_spec(text: str, file: str = "spec.toml") -> SweepSpec:
    """The spec in a TOML text; `file` is its name in error messages.

    Names of controllers and their gains are left to whoever makes controllers.
    """
    return _Reader(parse_toml(text, file)).spec()


class _Reader:
    """Reads a spec out of a document, whose content becomes that in SI units."""

    def __init__(self, document: Document) -> None:
        read = copy.deepcopy(dict(document.content))
        self._document = document = dataclasses.replace(document, content=read)
        self._error = document.error
        # Of the spec that a sweep keeps no code is imported, and no number is doubted.
        self._kept = read.get("code", {})
        in_tables = isinstance(read.get("gain_set"), dict)
        self._doubted = not ({"code", "arms"} & read.keys() or in_tables)
        self._names, code = short_names(document)
        for keys, kind in _UNITS.items():
            self._to_si(kind, *keys)
        self._content = document.read(SpecFile)
        self._code = {**self._content.code, **code}
        for place in (FIXED, GRID, RANDOM):
            for field, keys in list(self._fields(*place)):
                if (kind := field.range(self._code)) is not None:
                    self._to_si(kind, *keys)

    def spec(self) -> SweepSpec:
        """The spec, of which nothing is missing or out of range."""
        content = self._content
        axes, drawn = self._axes()
        arms = self._arms(axes)
        model = None if content.model is None else self._arm(content.model, "model")
        self._check_plants(axes, arms, model)
        spec = SweepSpec(
            axes=axes,
            random=drawn,
            **{name: getattr(content, name) for name in SETTINGS},
            fixed=self._fixed([axis.name for axis in (*axes, *drawn)]),
            gain_sets=self._gain_sets([str(value) for value in axes[0].values]),
            gains={self._short("controller", name): x for name, x in content.gains.items()},
            arms={name: arm.to_dict() for name, arm in arms.items()},
            model={} if model is None else model.to_dict(),
            record=content.record.episodes,
            code=self._code,
            text=self._document.text if self._is_in_one_file(arms) else "",
        )
        for name in spec.disturbances:
            if which(name)[0] not in self._kept:
                self._try(spec, name)
        return spec

    def _short(self, kind: str, word: str) -> str:
        return self._names.get((kind, word), word)

    def _is_in_one_file(self, arms: dict[str, ArmParameters]) -> bool:
        content, sets = self._content, self._content.gain_set or {}
        words = [sets] if isinstance(sets, str) else sets.values()
        return (
            all(isinstance(word, GainFile) or word in GAIN_SETS for word in words)
            and not (self._code or isinstance(content.model, str))
            and (isinstance(content.arm, dict) or arms.keys() <= content.arms.keys())
        )

    def _to_si(self, kind: Range, *keys: str) -> None:
        """Puts numbers in the place of texts such as "40%" at a key, if there are some."""

        def converted(value: Any) -> Any:
            if isinstance(value, list):
                return [converted(x) for x in cast(list[Any], value)]
            if isinstance(value, dict):
                between = {"low", "high"}
                items = cast(dict[str, Any], value).items()
                return {key: converted(x) if key in between else x for key, x in items}
            if isinstance(value, str) and is_like_a_number(value):
                return kind.parse(".".join(keys), value)
            if isinstance(value, int | float) and self._doubted:
                kind.check_plausible(".".join(keys), value)
            return value

        *above, key = keys
        table = table_at(self._document.content, *above)
        if key in table:
            with self._document.naming(*keys):
                table[key] = converted(table[key])

    def _fields(self, *place: str) -> Iterator[tuple[Axis, tuple[str, ...]]]:
        """The fields of disturbances in a table: axes without values, and the keys of their values.

        A field is given by `noise = ...`, or by `time = ...` in a table `noise`.
        """
        known = (*DISTURBANCES, *self._code)
        for word, value in table_at(self._document.content, *place).items():
            kind, number = which(word)
            kind = self._short("disturbance", kind)
            name = kind if number == 1 else f"{kind}-{number}"
            if kind not in known:
                hint = closest(name, known)
                raise self._error(f"unknown disturbance {quoted(name)}{hint}", *place, word)
            fields = keys_of(name, self._code)
            first = next(iter(fields))
            inner = cast(dict[str, Any], value) if isinstance(value, dict) else None
            bare = inner is None or (inner and inner.keys() <= Bounds.model_fields.keys())
            for key in [first] if bare or inner is None else inner:
                keys = (*place, word) if bare else (*place, word, key)
                if key not in fields:
                    hint = closest(key, fields)
                    raise self._error(f"{name} has no key {quoted(key)}{hint}", *keys)
                column = name if key == first else f"{name}.{key}"
                column = f"disturbance.{column}" if column in _OWN else column
                yield Axis(name=column, disturbance=name, field=fields[key]), keys

    def _fixed(self, varied: list[str]) -> dict[str, dict[str, Any]]:
        """The fields of disturbances that are the same in all episodes, none of them an axis."""
        fixed: dict[str, dict[str, Any]] = {}
        for field, keys in self._fields(*FIXED):
            if field.name in varied:
                raise self._error(f"{field.name} is an axis, too", *keys)
            value = self._document.read(_VALUE, *keys)
            fixed.setdefault(field.disturbance, {})[field.field] = value
        return fixed

    def _axes(self) -> tuple[tuple[Axis, ...], tuple[Axis, ...]]:
        """The axes of the grid, and those that are drawn.

        They come in the order in which episodes are counted, the slowest first: those whose values
        do not share a batch, beginning with the controller, and then the others.
        """
        document = self._document
        axes = [axis for name in _OWN if (axis := self._own_axis(name)) is not None]
        for field, keys in self._fields(*GRID):
            axes.append(dataclasses.replace(field, values=document.read(_VALUES, *keys)))
        for field, keys in self._fields(*RANDOM):
            if field.range(self._code) is None:
                raise self._error(f"{field.name} is made of words: it cannot be drawn", *keys)
            if field.name in [axis.name for axis in axes]:
                raise self._error(f"{field.name} is an axis of the grid, too", *keys)
            axes.append(_drawn(field, document.read(Bounds, *keys)))
        kinds = [*DISTURBANCES, *sorted(self._code)]

        def rank(axis: Axis) -> tuple[bool, int, int, str]:
            if axis.name in _OWN:
                return not axis.apart, _OWN.index(axis.name) - len(_OWN), 0, ""
            kind, place = which(axis.disturbance)
            return not axis.apart, kinds.index(kind), place, axis.field

        axes.sort(key=rank)
        return tuple(a for a in axes if not a.method), tuple(a for a in axes if a.method)

    def _own_axis(self, name: str) -> Axis | None:
        """Controller, reference and so on: in the grid, one value at the top, or drawn.

        It is None if there is none, and needs to be none.
        """
        content, single = self._content, getattr(self._content, name)
        places: dict[tuple[str, ...], Any] = {
            ("grid", name): getattr(content.grid, name),
            (name,): None if single is None else (ARM if isinstance(single, dict) else single,),
            ("random", name): content.random.mismatch if name == "mismatch" else None,
        }
        given = {keys: value for keys, value in places.items() if value is not None}
        if len(given) > 1:
            raise self._error(f"{name} is given twice, here and elsewhere", *next(iter(given)))
        if not given and name == "controller":
            raise self._error("there is no controller; [grid] needs controller = [...]", "grid")
        if not given:
            return Axis(name=name, values=_USUAL[name]) if name in _USUAL else None
        ((keys, value),) = given.items()
        if isinstance(value, Bounds):
            return _drawn(Axis(name=name), value)
        if name in ("controller", "reference"):
            value = tuple(self._short(name, str(word)) for word in value)
            if len(set(value)) < len(value):
                raise self._error(f"{name} has the same value twice", *keys)
            known = (*REFERENCES, *self._code)
            for word in value if name == "reference" else ():
                if {word, head := word.partition(":")[0]}.isdisjoint(known):
                    hint = closest(head, known)
                    raise self._error(f"unknown reference {spelt(head)}{hint}", *keys)
        return Axis(name=name, values=value)

    def _arms(self, axes: tuple[Axis, ...]) -> dict[str, ArmParameters]:
        """The arms of the axis `arm` by name; none without such an axis."""
        content = self._content
        names = [str(value) for axis in axes if axis.name == ARM for value in axis.values]
        for name in content.arms:
            if name not in names:
                raise self._error(f"{quoted(name)} is no arm of this sweep", "arms", name)
        if isinstance(content.arm, dict) and not content.arms:
            return {name: arm_of(self._document, ARM).parameters for name in names}
        keys = ("grid", ARM) if content.arm is None else (ARM,)
        return {name: self._arm(content.arms.get(name, name), *keys) for name in names}

    def _arm(self, given: str | dict[str, Any], *keys: str) -> ArmParameters:
        """The arm of a file beside the spec, one that comes with octarm, or one of a kept spec."""
        with self._document.naming(*keys):
            if isinstance(given, dict):
                return ArmParameters.from_dict(given)
            beside = Path(self._document.file).parent / given
            return read_arm(beside if given.endswith(".toml") else given)

    def _check_plants(
        self, axes: tuple[Axis, ...], arms: dict[str, ArmParameters], model: ArmParameters | None
    ) -> None:
        given: dict[str, Any] = {axis.name: axis.values for axis in axes if axis.name in PLANT}
        plants = [dict(zip(given, x, strict=True)) for x in itertools.product(*given.values())]
        several = [*arms.values()] or [nominal_parameters()]
        name = PLANT_MODULES if PLANT_MODULES in given else next(iter(given), "model")
        keys = (name,) if name in self._document.content else ("grid", name)
        for arm, plant in itertools.product(several, plants):
            with self._document.naming(*keys):
                groups_of(arm, **plant, groups=grouped(arm, model or arm))

    def _gain_sets(self, controllers: list[str]) -> dict[str, Any]:
        """The gain set of each controller: a word, or what a file holds that the spec names."""
        sets, gains = self._content.gain_set or {}, self._content.gains
        if isinstance(sets, str):
            sets = dict.fromkeys(controllers, sets)
        for table, words in (("gain_set", sets), ("gains", gains)):
            for word in words:
                if (name := self._short("controller", word)) not in controllers:
                    hint = closest(name, controllers)
                    message = f"gains of {quoted(name)}, which is no controller of this sweep{hint}"
                    raise self._error(message, table, word)
        return {
            self._short("controller", x): self._gain_set(x, choice) for x, choice in sets.items()
        }

    def _gain_set(self, word: str, choice: str | GainFile) -> str | dict[str, Any]:
        if isinstance(choice, GainFile):
            return choice.model_dump()
        if choice in GAIN_SETS:
            return choice
        if not choice.endswith(".toml"):
            words = ", ".join(GAIN_SETS)
            message = f"unknown gain_set {spelt(choice)}; known are {words}, or NAME.toml"
            raise self._error(message, "gain_set", word)
        name = self._short("controller", word)
        label = short_name(word_of(name, self._code)) if name in self._code else name
        try:
            document = read_toml(Path(self._document.file).parent / choice)
        except FileError as error:
            raise self._error(str(error), "gain_set", word) from None
        file = document.read(GainFile)
        if file.controller != label:
            message = f"holds gains of {spelt(file.controller)}, not of {label}"
            raise document.error(message, "controller")
        return file.model_dump()

    def _try(self, spec: SweepSpec, name: str) -> None:
        """Makes a disturbance with every value it is to have; none is missing or out of range."""
        axes = [axis for axis in (*spec.axes, *spec.random) if axis.disturbance == name]
        fixed = spec.fixed.get(name, {})
        keys = (*((RANDOM if axes[0].method else GRID) if axes else FIXED), name)
        kind, number = which(name)
        before = kind if number == 2 else f"{kind}-{number - 1}"
        if number > 1 and before not in spec.disturbances:
            raise self._error(f"there is a {name}, but no {before}", *keys)
        cls: Any = spec.class_of(name)
        given = {*field_defaults(cls), *fixed, *(axis.field for axis in axes)}
        for key, field in field_keys(cls).items():
            if field not in given:
                raise self._error(f"{name} needs a value of {key}", *keys)
        # Side by side suffices: what a value may be does not depend on the other fields' values.
        for i in range(max([1, *(len(axis.values) for axis in axes)])):
            with self._document.naming(*keys):
                cls(**fixed, **{axis.field: axis.values[i % len(axis.values)] for axis in axes})


def _drawn(axis: Axis, bounds: Bounds) -> Axis:
    return dataclasses.replace(axis, values=(bounds.low, bounds.high), method=bounds.method)
