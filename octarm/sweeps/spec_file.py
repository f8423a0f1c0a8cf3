"""A sweep's TOML file, checked word by word before anything happens.

What it may hold stands in `octarm.sweeps.spec_content`.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

from octarm.arm.file import arm_of, read_arm
from octarm.arm.groups import grouped, groups_of
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.declared import Code, short_name, word_of
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import FileError, OctarmError, closest, quoted
from octarm.fields import field_defaults, field_keys, field_kinds
from octarm.formats import Array, Document, parse_toml, read_toml, spelt
from octarm.references import REFERENCES
from octarm.sweeps.spec import ARM, PLANT, PLANT_MODULES, SETTINGS, Axis, SweepSpec, keys_of, which
from octarm.sweeps.spec_code import with_names
from octarm.sweeps.spec_content import GAIN_SETS, Bounds, Distinct, GainFile, Number, SpecFile
from octarm.units import MISMATCH, PERIOD, Range

_LIKE_A_NUMBER = re.compile(r"\s*[-+.]{0,2}\d")  # how a number begins, with a unit or not
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
_MORE = (ARM, *PLANT)  # axes that only some sweeps have
_OWN = ("controller", "reference", *_MORE, "mismatch")  # in their order, slowest first


def read_spec(path: str | Path) -> SweepSpec:
    """The spec in a TOML file.

    Raises OctarmError with the line where it is not valid, FileError if it cannot be read.
    """
    return _spec(read_toml(path))


def parse_spec(text: str, file: str = "spec.toml") -> SweepSpec:
    """The spec in a TOML text; `file` is its name in error messages.

    Names of controllers and their gains are left to whoever makes controllers.
    """
    return _spec(parse_toml(text, file))


def _spec(document: Document) -> SweepSpec:
    kept = document.content.get("code", {})  # of which no code is imported
    document = with_names(document)
    for keys, kind in _UNITS.items():
        document = _in_si(document, kind, *keys)
    content = document.read(SpecFile)
    for place in (("disturbance",), ("grid", "disturbance"), ("random", "disturbance")):
        for field, keys in list(_fields(document, content.code, *place)):
            kind = range_of(field, content.code)
            if kind is not None:
                document = _in_si(document, kind, *keys)
    axes, drawn = _axes(document, content)
    arms = _arms(document, content, axes)
    model = _model(document, content)
    _check_plants(document, content, axes, arms, model)
    sets = _gain_sets(document, content, [str(value) for value in axes[0].values])
    fixed: dict[str, dict[str, Any]] = {}
    for field, keys in _fields(document, content.code, "disturbance"):
        if field.name in [axis.name for axis in (*axes, *drawn)]:
            raise document.error(f"{field.name} is an axis, too", *keys)
        value = document.read(cast(Any, Number | str | list[Number]), *keys)
        fixed.setdefault(field.disturbance, {})[field.field] = value
    asked = content.gain_set or {}
    words = [asked] if isinstance(asked, str) else asked.values()
    in_one_file = (
        all(isinstance(word, GainFile) or word in GAIN_SETS for word in words)
        and not (content.code or isinstance(content.model, str))
        and (isinstance(content.arm, dict) or arms.keys() <= content.arms.keys())
    )
    spec = SweepSpec(
        axes=axes,
        random=drawn,
        **{name: getattr(content, name) for name in SETTINGS},
        fixed=fixed,
        gain_sets=sets,
        gains=content.gains,
        arms={name: arm.to_dict() for name, arm in arms.items()},
        model={} if model is None else model.to_dict(),
        record=content.record.episodes,
        code=content.code,
        text=document.text if in_one_file else "",
    )
    for name in spec.disturbances:
        if which(name)[0] not in kept:
            _try(spec, name, document)
    return spec


def _in_si(document: Document, kind: Range, *keys: str) -> Document:
    """The document with numbers in place of texts such as "40%" at a key, if there are some.

    The spec that a sweep keeps of several files, which has tables of them, is not doubted.
    """
    kept = {"code", "arms"} & document.content.keys() or isinstance(
        document.content.get("gain_set"), dict
    )

    def converted(value: Any) -> Any:
        if isinstance(value, list):
            return [converted(x) for x in cast(list[Any], value)]
        if isinstance(value, dict):
            between = {"low", "high"}
            items = cast(dict[str, Any], value).items()
            return {key: converted(x) if key in between else x for key, x in items}
        try:
            if isinstance(value, str) and _LIKE_A_NUMBER.match(value):
                return kind.parse(".".join(keys), value)
            if isinstance(value, int | float) and not kept:
                kind.check_plausible(".".join(keys), value)
            return value
        except OctarmError as error:
            raise document.error(str(error), *keys) from None

    def replaced(content: Any, keys: tuple[str, ...]) -> Any:
        if not keys:
            return converted(content)
        if not isinstance(content, dict) or keys[0] not in content:
            return cast(Any, content)
        table = cast(dict[str, Any], content)
        return {**table, keys[0]: replaced(table[keys[0]], keys[1:])}

    return dataclasses.replace(document, content=replaced(document.content, keys))


def _axes(document: Document, content: SpecFile) -> tuple[tuple[Axis, ...], tuple[Axis, ...]]:
    """The axes of the grid, and those that are drawn.

    They come in the order in which episodes are counted, the slowest first: those whose values do
    not share a batch, beginning with the controller, and then the others.
    """
    axes = [axis for name in _OWN if (axis := _own_axis(name, document, content)) is not None]
    code, kinds = content.code, [*DISTURBANCES, *sorted(content.code)]
    for field, keys in _fields(document, code, "grid", "disturbance"):
        values = document.read(cast(Any, Annotated[Array[Number] | Array[str], Distinct]), *keys)
        axes.append(dataclasses.replace(field, values=values))
    for field, keys in _fields(document, code, "random", "disturbance"):
        if range_of(field, code) is None:
            raise document.error(f"{field.name} is made of words: it cannot be drawn", *keys)
        if field.name in [axis.name for axis in axes]:
            raise document.error(f"{field.name} is an axis of the grid, too", *keys)
        axes.append(_drawn(field, document.read(Bounds, *keys)))

    def rank(axis: Axis) -> tuple[bool, int, int, str]:
        if axis.name in _OWN:
            return not axis.apart, _OWN.index(axis.name) - len(_OWN), 0, ""
        kind, place = which(axis.disturbance)
        return not axis.apart, kinds.index(kind), place, axis.field

    axes.sort(key=rank)
    return tuple(a for a in axes if not a.method), tuple(a for a in axes if a.method)


def _drawn(axis: Axis, bounds: Bounds) -> Axis:
    return dataclasses.replace(axis, values=(bounds.low, bounds.high), method=bounds.method)


def _arms(document: Document, content: SpecFile, axes: Sequence[Axis]) -> dict[str, ArmParameters]:
    """The arms of the axis `arm` by name; none without such an axis."""
    names = [str(value) for axis in axes if axis.name == ARM for value in axis.values]
    keys = ("grid", ARM) if content.arm is None else (ARM,)
    for name in content.arms:
        if name not in names:
            raise document.error(f"{quoted(name)} is no arm of this sweep", "arms", name)
    arms: dict[str, ArmParameters] = {}
    for name in names:
        try:
            if name in content.arms:
                arms[name] = ArmParameters.from_dict(content.arms[name])
            elif isinstance(content.arm, dict):
                arms[name] = arm_of(document, ARM).parameters
            else:
                arms[name] = _read_arm(document, name)
        except OctarmError as error:
            if isinstance(content.arm, dict):
                raise  # it names its line
            raise document.error(str(error), *keys) from None
    return arms


def _read_arm(document: Document, name: str) -> ArmParameters:
    return read_arm(Path(document.file).parent / name if name.endswith(".toml") else name)


def _model(document: Document, content: SpecFile) -> ArmParameters | None:
    """What the controllers believe of all arms; None if that is what they are."""
    try:
        if isinstance(content.model, str):
            return _read_arm(document, content.model)
        return None if content.model is None else ArmParameters.from_dict(content.model)
    except OctarmError as error:
        raise document.error(str(error), "model") from None


def _check_plants(
    document: Document,
    content: SpecFile,
    axes: Sequence[Axis],
    arms: Mapping[str, ArmParameters],
    model: ArmParameters | None,
) -> None:
    given: dict[str, Any] = {axis.name: axis.values for axis in axes if axis.name in PLANT}
    plants = [dict(zip(given, plant, strict=True)) for plant in itertools.product(*given.values())]
    several = [*arms.values()] or [nominal_parameters()]
    for arm, plant in itertools.product(several, plants):
        try:
            groups_of(arm, **plant, groups=grouped(arm, model or arm))
        except OctarmError as error:
            if not given:
                raise document.error(str(error), "model") from None
            name = PLANT_MODULES if PLANT_MODULES in given else next(iter(given))
            keys = (name,) if name in document.content else ("grid", name)
            raise document.error(str(error), *keys) from None


def _own_axis(name: str, document: Document, content: SpecFile) -> Axis | None:
    """Controller, reference and so on: in the grid, one value at the top, or drawn.

    It is None if there is none, and needs to be none.
    """
    single = getattr(content, name)
    places = {
        ("grid", name): getattr(content.grid, name),
        (name,): None if single is None else (ARM if isinstance(single, dict) else single,),
        ("random", name): content.random.mismatch if name == "mismatch" else None,
    }
    given = {keys: value for keys, value in places.items() if value is not None}
    if len(given) > 1:
        raise document.error(f"{name} is given twice, here and elsewhere", *next(iter(given)))
    if not given and name == "controller":
        raise document.error("there is no controller; [grid] needs controller = [...]", "grid")
    if not given and name in _MORE:
        return None
    value = next(iter(given.values()), ("sine",) if name == "reference" else (0.0,))
    if name == "reference":
        known = (*REFERENCES, *content.code)
        for word in cast("tuple[str, ...]", value):
            if {word, head := word.partition(":")[0]}.isdisjoint(known):
                hint = closest(head, known)
                raise document.error(f"unknown reference {spelt(head)}{hint}", *next(iter(given)))
    axis = Axis(name=name)
    if isinstance(value, Bounds):
        return _drawn(axis, value)
    return dataclasses.replace(axis, values=value)


def range_of(axis: Axis, code: Mapping[str, Code]) -> Range | None:
    """What the numbers of an axis may be, as far as it is known; None if they are words or count.

    No code is imported.
    """
    if not axis.disturbance:
        return MISMATCH if axis.name == "mismatch" else None
    kind = which(axis.disturbance)[0]
    if kind in code:
        said = {field["field"]: field for field in code[kind].declares.values()}[axis.field]
        return Range(str(said["unit"])) if said["number"] else None
    declared = field_kinds(DISTURBANCES[kind])[axis.field]
    return declared if isinstance(declared, Range) else None


def _fields(
    document: Document, code: Mapping[str, Code], *place: str
) -> Iterator[tuple[Axis, tuple[str, ...]]]:
    """The fields of disturbances in a table: axes without values, and the keys of their values.

    A field is given by `noise = ...`, or by `time = ...` in a table `noise`.
    """
    table: Any = document.content
    for key in place:
        table = table.get(key, {})
    for name, value in dict[str, Any](table).items():
        if which(name)[0] not in (*DISTURBANCES, *code):
            hint = closest(name, (*DISTURBANCES, *code))
            raise document.error(f"unknown disturbance {quoted(name)}{hint}", *place, name)
        fields = keys_of(name, code)
        first = next(iter(fields))
        inner = cast(dict[str, Any], value) if isinstance(value, dict) else None
        bare = inner is None or (inner and inner.keys() <= Bounds.model_fields.keys())
        for key in [first] if bare or inner is None else inner:
            keys = (*place, name) if bare else (*place, name, key)
            if key not in fields:
                raise document.error(
                    f"{name} has no key {quoted(key)}{closest(key, fields)}", *keys
                )
            column = name if key == first else f"{name}.{key}"
            column = f"disturbance.{column}" if column in _OWN else column
            yield Axis(name=column, disturbance=name, field=fields[key]), keys


def _gain_sets(
    document: Document, content: SpecFile, controllers: list[str]
) -> dict[str, str | dict[str, Any]]:
    """The gain set of each controller: a word, or what a file holds that the spec names."""
    sets = content.gain_set or {}
    if isinstance(sets, str):
        sets = dict.fromkeys(controllers, sets)
    for table, names in (("gain_set", sets), ("gains", content.gains)):
        for name in [name for name in names if name not in controllers]:
            hint = closest(name, controllers)
            message = f"gains of {quoted(name)}, which is no controller of this sweep{hint}"
            raise document.error(message, table, name)
    known: dict[str, str | dict[str, Any]] = {}
    for name, choice in sets.items():
        if isinstance(choice, GainFile):
            known[name] = choice.model_dump()
        elif choice in GAIN_SETS:
            known[name] = choice
        elif choice.endswith(".toml"):
            try:
                label = short_name(word_of(name, content.code)) if name in content.code else name
                known[name] = _content_of(Path(document.file).parent / choice, label)
            except FileError as error:
                raise document.error(str(error), "gain_set", name) from None
        else:
            words = ", ".join(GAIN_SETS)
            message = f"unknown gain_set {spelt(choice)}; known are {words}, or NAME.toml"
            raise document.error(message, "gain_set", name)
    return known


def _content_of(path: Path, controller: str) -> dict[str, Any]:
    document = read_toml(path)
    file = document.read(GainFile)
    if file.controller != controller:
        message = f"holds gains of {spelt(file.controller)}, not of {controller}"
        raise document.error(message, "controller")
    return file.model_dump()


def _try(spec: SweepSpec, name: str, document: Document) -> None:
    """Makes a disturbance with every value it is to have; none is missing or out of range."""
    axes = [axis for axis in (*spec.axes, *spec.random) if axis.disturbance == name]
    fixed = spec.fixed.get(name, {})
    table = ("random" if axes[0].method else "grid", "disturbance") if axes else ("disturbance",)
    kind, number = which(name)
    before = kind if number == 2 else f"{kind}-{number - 1}"
    if number > 1 and before not in spec.disturbances:
        raise document.error(f"there is a {name}, but no {before}", *table, name)
    cls: Any = spec.class_of(name)
    given = {*field_defaults(cls), *fixed, *(axis.field for axis in axes)}
    for key, field in field_keys(cls).items():
        if field not in given:
            raise document.error(f"{name} needs a value of {key}", *table, name)
    # Side by side suffices: what a value may be does not depend on the other fields' values.
    for i in range(max([1, *(len(axis.values) for axis in axes)])):
        tried = {axis.field: axis.values[i % len(axis.values)] for axis in axes}
        try:
            cls(**fixed, **tried)
        except OctarmError as error:
            raise document.error(str(error), *table, name) from None
