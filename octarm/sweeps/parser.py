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

import dataclasses
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from octarm.arm.actuation import ACTUATIONS
from octarm.disturbances.fields import Words, field_kinds
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError, closest
from octarm.references import REFERENCES
from octarm.sweeps.gain_sets import parse_gains
from octarm.sweeps.spec import Axis, RandomAxis, SweepSpec, Value, which
from octarm.sweeps.spelling import spoken
from octarm.toml_table import Source, Table, floats, is_number, items, shown

RECORDED = ("worst", "median", "diverged")  # episodes that can be recorded without their number
METHODS = ("uniform", "sobol")

_OWN = ("controller", "reference", "mismatch")  # axes of every sweep
_LARGEST_MISMATCH = 1e6
_BOUNDS = {"low", "high", "method"}


def read_spec(path: str | Path) -> SweepSpec:
    """The spec in a TOML file.

    Raises:
        ValueError: if it is not a valid spec; the sentence names the line.
        OSError: if the file cannot be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise OctarmError(f"{path} is not a text file in UTF-8") from None
    return parse_spec(text, str(path))


def parse_spec(text: str, file: str = "spec.toml") -> SweepSpec:
    """The spec in a TOML text; `file` is its name in error messages.

    Names of controllers and their gains are left to whoever makes controllers.

    Raises:
        ValueError: if it is not a valid spec; the sentence names the line.
    """
    source = Source(text, file)
    top = source.table()
    axes = _axes(top, top.table("grid"), top.table("random"))
    names = [str(v) for a in axes if a.name == "controller" for v in a.probes]
    chosen = parse_gains(top, names, Path(file).parent)
    spec = SweepSpec(
        axes=tuple(axis for axis in axes if isinstance(axis, Axis)),
        random=tuple(axis for axis in axes if isinstance(axis, RandomAxis)),
        seed=top.whole("seed", 0, at_least=0),
        episodes=top.whole("episodes", 1, at_least=1),
        duration=top.positive("duration") or 10.0,
        timestep=top.positive("timestep"),
        control_period=top.positive("control_period"),
        actuation=top.word("actuation", ACTUATIONS, "f-coeff"),
        batch=top.whole("batch", 1024, at_least=1),
        fixed=_fixed(top.table("disturbance"), axes),
        gain_sets=chosen.sets,
        gains=chosen.gains,
        record=_record(top.table("record")),
        text=text,
        alone=chosen.alone,
    )
    top.done()
    for name in spec.disturbances:
        _try(spec, name, source)
    return spec


def _axes(top: Table, grid: Table, drawn: Table) -> list[Axis | RandomAxis]:
    """All axes, in the order in which episodes are counted, the slowest first."""
    found: list[Axis | RandomAxis] = [_own_axis(name, top, grid, drawn) for name in _OWN]
    for entry in _entries(grid.table("disturbance")):
        values = _values(entry.table, entry.keys, entry.value)
        found.append(
            Axis(name=entry.column, values=values, disturbance=entry.name, field=entry.field)
        )
    for entry in _entries(drawn.table("disturbance")):
        if isinstance(field_kinds(DISTURBANCES[which(entry.name).kind])[entry.field], Words):
            raise entry.table.error(f"{entry.column} is made of words: it cannot be drawn")
        if entry.column in [axis.name for axis in found]:
            raise entry.table.error(f"{entry.column} is an axis of the grid, too", *entry.keys)
        axis = _random_axis(entry.table, entry.keys, entry.column)
        found.append(dataclasses.replace(axis, disturbance=entry.name, field=entry.field))
    grid.done()
    drawn.done()
    order = list(DISTURBANCES)

    def rank(axis: Axis | RandomAxis) -> tuple[bool, int, int, str]:
        shared = not (isinstance(axis, Axis) and axis.words)
        if axis.name in _OWN:
            return shared, _OWN.index(axis.name) - len(_OWN), 0, ""
        kind, place = which(axis.disturbance)
        return shared, order.index(kind), place, axis.field

    return sorted(found, key=rank)


def _own_axis(name: str, top: Table, grid: Table, drawn: Table) -> Axis | RandomAxis:
    """Controller, reference or mismatch: in the grid, one value at the top, or drawn."""
    places = [grid, top, *([drawn] if name == "mismatch" else [])]
    given = [table for table in places if table.take(name) is not None]
    if len(given) > 1:
        raise given[0].error(f"{name} is given twice, here and elsewhere", name)
    if name == "controller" and not given:
        raise grid.error("there is no controller; [grid] needs controller = [...]")
    table = given[0] if given else top
    if table is drawn:
        axis = _random_axis(table, (name,), name)
    elif not given:
        axis = Axis(name=name, values=("sine",) if name == "reference" else (0.0,))
    else:
        value = table.data[name]
        axis = Axis(name=name, values=_values(table, (name,), [value] if table is top else value))
    for value in axis.probes:
        if problem := _problem(name, value):
            raise table.error(problem, name)
    return axis


def _problem(name: str, value: Value) -> str:
    """What is wrong with a value of controller, reference or mismatch."""
    if name == "mismatch":
        good = not isinstance(value, str) and -1.0 < value <= _LARGEST_MISMATCH
        allowed = f"above -1 and at most {_LARGEST_MISMATCH:g}"
        return "" if good else f"mismatch is {shown(value)}; it must be {allowed}"
    if not isinstance(value, str):
        return f"{name} is {shown(value)}; it must be a name"
    if name == "reference" and value not in REFERENCES:
        return f"unknown reference {value!r}{closest(value, REFERENCES)}"
    return ""


class _Entry(NamedTuple):
    """A field of a disturbance in the file: `noise = ...`, or `time = ...` in a table `noise`."""

    name: str  # of the disturbance
    field: str  # as the code spells it
    column: str
    value: Any
    table: Table  # that holds the value
    keys: tuple[str, ...]  # of the value in that table


def _entries(table: Table) -> Iterator[_Entry]:
    """The fields of disturbances in a table."""
    for name, value in table.data.items():
        if which(name).kind not in DISTURBANCES:
            raise table.error(f"unknown disturbance {name!r}{closest(name, DISTURBANCES)}", name)
        fields = spoken(name)
        first = next(iter(fields))
        keys: set[str] = set(table.table(name).data) if isinstance(value, dict) else _BOUNDS
        by_key = not keys or not keys <= _BOUNDS
        inner = table.table(name) if by_key else table
        for key, own in dict[str, Any](inner.data if by_key else {first: value}).items():
            if key not in fields:
                raise inner.error(f"{name} has no key {key!r}{closest(key, fields)}", key)
            column = name if key == first else f"{name}.{key}"
            column = f"disturbance.{column}" if column in _OWN else column
            yield _Entry(name, fields[key], column, own, inner, (key if by_key else name,))


def _values(table: Table, keys: tuple[str, ...], values: Any) -> tuple[Value, ...]:
    """The values of an axis of the grid."""
    name = keys[-1]
    listed = items(values)
    if not listed:
        raise table.error(f"{name} is {shown(values)}; it must be a list with a value", *keys)
    for value in listed:
        if not is_number(value) and not isinstance(value, str):
            raise table.error(f"{name} holds {shown(value)}; it must hold numbers or words", *keys)
    if len({isinstance(value, str) for value in listed}) > 1:
        raise table.error(f"{name} holds both numbers and words", *keys)
    if len(set(listed)) < len(listed):
        raise table.error(f"{name} holds the same value twice", *keys)
    return tuple(floats(listed))


def _random_axis(table: Table, keys: tuple[str, ...], column: str) -> RandomAxis:
    """An axis that is drawn, { low = 0.0, high = 1.0, method = "sobol" }."""
    name = keys[-1]
    bounds = table.table(name)
    low, high = bounds.take("low"), bounds.take("high")
    method = bounds.word("method", METHODS, "uniform")
    bounds.done()
    if not all(is_number(x) and math.isfinite(x) for x in (low, high)) or not low < high:
        raise table.error(
            f"{name} has low {shown(low)}, high {shown(high)}; it needs two numbers, low below "
            "high",
            *keys,
        )
    return RandomAxis(name=column, low=float(low), high=float(high), method=method)


def _fixed(table: Table, axes: list[Axis | RandomAxis]) -> dict[str, dict[str, Any]]:
    """Fields of disturbances that are the same in all episodes."""
    taken = {(axis.disturbance, axis.field) for axis in axes}
    found: dict[str, dict[str, Any]] = {}
    for entry in _entries(table):
        if (entry.name, entry.field) in taken:
            raise entry.table.error(f"{entry.column} is an axis, too", *entry.keys)
        found.setdefault(entry.name, {})[entry.field] = floats(entry.value)
    return found


def _record(table: Table) -> tuple[int | str, ...]:
    given = table.take("episodes")
    table.done()
    if given is None:
        return ()
    episodes = items(given)
    if episodes is None:
        raise table.error(f"episodes is {shown(given)}; it must be a list", "episodes")
    for value in episodes:
        number = isinstance(value, int) and not isinstance(value, bool) and value >= 0
        if not number and value not in RECORDED:
            known = closest(str(value), RECORDED)
            raise table.error(
                f"{shown(value)} is neither the number of an episode nor a word{known}", "episodes"
            )
    return tuple(episodes)


def _try(spec: SweepSpec, name: str, source: Source) -> None:
    """Makes a disturbance with every value it is to have.

    Raises:
        ValueError: if one is missing or out of range.
    """
    axes = [axis for axis in (*spec.axes, *spec.random) if axis.disturbance == name]
    fixed = dict(spec.fixed.get(name, {}))
    places = [("grid" if isinstance(axis, Axis) else "random", "disturbance") for axis in axes]
    place = source.where(*(places[0] if places else ("disturbance",)), name)
    kind, number = which(name)
    before = kind if number == 2 else f"{kind}-{number - 1}"
    if number > 1 and before not in spec.disturbances:
        raise OctarmError(f"{place}: there is a {name}, but no {before}")
    cls = DISTURBANCES[kind]
    given = {*fixed, *(axis.field for axis in axes)}
    for key, field in spoken(name).items():
        defaults = {f.name: f.default for f in dataclasses.fields(cls)}  # pyright: ignore
        if defaults[field] is dataclasses.MISSING and field not in given:
            raise OctarmError(f"{place}: {name} needs a value of {key}")
    # Beside one another suffices: what a value may be does not depend on the other fields' values.
    for values in itertools.zip_longest(*(axis.probes for axis in axes)) if axes else [()]:
        chosen = {
            axis.field: axis.probes[0] if value is None else value
            for axis, value in zip(axes, values, strict=True)
        }
        try:
            cls(**fixed, **chosen)
        except ValueError as error:
            raise OctarmError(f"{place}: {error}") from None
