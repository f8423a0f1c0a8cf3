"""What a file of an arm may hold, and the parameters that its numbers mean."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, cast

import numpy as np
from pydantic import AfterValidator, Field, TypeAdapter, create_model

from octarm.arm.parameters import MOST_MODULES, ArmParameters
from octarm.arm.rod import LAYOUTS, Rod, arm_from_rod
from octarm.errors import OctarmError
from octarm.formats import Array, Model, one_of, spelt
from octarm.units import NUMBER, UNITS, closed_up

_NUMBERS = TypeAdapter[Any](float | list[float] | list[list[float]])


def quantity(kind: str, given: Any) -> np.ndarray:
    """The numbers of a quantity of a kind of `UNITS`, of any shape, in SI units.

    A file has it as a word, `"120 mm"`, a list of words, or a table `{ value = [1200, 1000], unit =
    "N/m" }`. A ValueError says what it must be.
    """
    si = next(iter(UNITS[kind]))
    match given:
        case str():
            number = NUMBER.match(given)
            if number is None or number.end() == len(given):
                raise ValueError(f'a number with a unit, such as "1 {si}"')
            return np.array(float(number[0])) * _unit_size(given[number.end() :], kind)
        case {"value": value, "unit": str() as unit, **rest} if not rest:
            return _numbers(value) * _unit_size(unit, kind)
        case dict():
            raise ValueError(f'a table such as {{ value = [1, 2], unit = "{si}" }}')
        case list() | tuple() if given:
            parts = [quantity(kind, part) for part in cast(Sequence[Any], given)]
            if len({part.shape for part in parts}) > 1:
                raise ValueError("a list of as many values in each row")
            return np.stack(parts)
        case bool() | int() | float():
            raise ValueError(f'given with a unit, such as "{spelt(given)} {si}"')
        case _:
            raise ValueError(f'a number with a unit, such as "1 {si}"')


def _numbers(value: Any) -> np.ndarray:
    try:
        numbers = np.array(_NUMBERS.validate_python(value, strict=True), dtype=np.float64)
    except (ValueError, OverflowError):
        numbers = np.empty(0)
    if not numbers.size or np.isnan(numbers).any():
        raise ValueError("a table whose value is a number, or a list of as many in each row")
    return numbers


def _unit_size(unit: str, kind: str) -> float:
    units = UNITS[kind]
    known = {closed_up(name): size for name, size in units.items()}
    if closed_up(unit) not in known:
        *most, last = units
        raise ValueError(f"in {', '.join(most)} or {last}, which are the units of {kind}")
    return known[closed_up(unit)]


def _quantities(kinds: Mapping[str, str], default: Any = None) -> dict[str, Any]:
    """Fields of a table for quantities of these kinds, which become arrays in SI units."""
    return {
        name: (Annotated[Any, AfterValidator(functools.partial(quantity, kind))], default)
        for name, kind in kinds.items()
    }


# The quantities that a file of an arm and its table [rod] may hold, with their kinds in `UNITS`.
KINDS = {
    "mass": "mass",
    "inertia": "inertia",
    "width": "length",
    "rest_length": "length",
    "rest_angle": "angle",
    "stiffness": "stiffness",
    "axial_stiffness": "stiffness",
    "bending_stiffness": "bending stiffness",
    "damping": "damping",
    "axial_damping": "damping",
    "bending_damping": "bending damping",
    "damping_time": "time",
    "gravity": "acceleration",
    "tip_length": "length",
    "input_range": "force",
}
_ROD_KINDS = {
    "length": "length",
    "EA": "force",
    "EI": "flexural rigidity",
    "density": "mass per length",
    "rotary_inertia": "inertia per length",
    "damping_time": "time",
}
_GRAVITY = np.array(9.81)
_OF_MODULES = (
    "mass", "inertia", "width", "rest_length", "rest_angle", "axial_stiffness",
    "bending_stiffness", "axial_damping", "bending_damping", "stiffness", "damping",
)  # fmt: skip

Modules = Annotated[int, Field(ge=1, le=MOST_MODULES)]


class _Cut(Model):
    """Into how many modules a rod is cut, and in what layout."""

    modules: Modules
    layout: Annotated[str, one_of(LAYOUTS)] = "paper"


RodTable = create_model("RodTable", __base__=_Cut, **_quantities(_ROD_KINDS, ...))


class _Words(Model):
    """What a file holds besides its quantities."""

    name: str = ""
    source: str | Array[str] = ""
    converted: Array[str] = ()
    assumed: Array[str] = ()
    modules: Modules | None = None
    rod: _Cut | None = None


_FIELDS: dict[str, Any] = {"rod": (RodTable | None, None)} | _quantities(KINDS)
ArmFile = create_model("ArmFile", __base__=_Words, **_FIELDS)


def parameters_of(content: _Words) -> ArmParameters:
    """The parameters of one arm; numbers are broadcast, and what is not given is completed.

    Raises OctarmError if something is missing or does not fit; the sentence begins with its key.
    """
    given = {n: x for n in KINDS if (x := getattr(content, n)) is not None}
    with np.errstate(all="ignore"):  # a width of 0 is refused in the end
        if content.rod is None:
            return _Reader(given, content.modules).parameters()
        return _rod(given, content, content.rod)


def _rod(given: dict[str, np.ndarray], content: _Words, rod: _Cut) -> ArmParameters:
    wrong = sorted(
        given.keys() - {"gravity", "input_range"} | content.model_fields_set & {"modules"}
    )
    if wrong:
        raise OctarmError(f"{wrong[0]} is given beside [rod], which says it already")
    profiles = {name: getattr(rod, name).tolist() for name in _ROD_KINDS}
    gravity = _single("gravity", given.get("gravity", _GRAVITY))
    p = arm_from_rod(Rod(**profiles, gravity=gravity), rod.modules, rod.layout)
    if "input_range" not in given:
        return p
    return dataclasses.replace(p, input_range=_range(given["input_range"], p.modules))


class _Reader:
    """Makes parameters of a file: broadcasts numbers, and completes what is not given."""

    def __init__(self, given: dict[str, np.ndarray], modules: int | None) -> None:
        self._given = given
        self._modules = modules or self._counted()

    def parameters(self) -> ArmParameters:
        given, width = self._given, self._value("width")
        stiffness, springs = self._shares("stiffness", width)
        damping, dampers = self._damping(width, stiffness, springs)
        length, angle = self._shape(width)
        others: dict[str, Any] = {"gravity": _single("gravity", given.get("gravity", _GRAVITY))}
        if "tip_length" in given:
            others["tip_length"] = _single("tip_length", given["tip_length"])
        if "input_range" in given:
            others["input_range"] = _range(given["input_range"], self._modules)
        return ArmParameters(
            mass=self._value("mass"),
            inertia=self._value("inertia"),
            width=width[:1] if np.all(width == width[0]) else width,
            stiffness=stiffness,
            damping=damping,
            rest_length=length,
            rest_angle=angle,
            backbone_stiffness=springs,
            backbone_damping=dampers,
            **others,
        )

    def _counted(self) -> int:
        for value in (self._given[key] for key in _OF_MODULES if key in self._given):
            if value.ndim == 1 or value.shape[-1:] > (1,):
                return value.shape[-1]
        raise OctarmError("it needs a value of modules, since no list says how many there are")

    def _value(self, key: str, *rows: int) -> np.ndarray:
        """A quantity of all modules, shape (N,), or of all columns, shape (2, N) with rows 2."""
        n = self._modules
        if key not in self._given:
            raise OctarmError(f"it needs a value of {key}")
        try:
            return np.broadcast_to(self._given[key], (*rows, n))
        except ValueError:
            allowed = f"1 or {n}, one for each module" if n > 1 else "1"
            allowed += ", or a row of them for each of the two columns" if rows else ""
            raise OctarmError(f"{key} has {_size(self._given[key])}; it needs {allowed}") from None

    def _whole(self, key: str) -> np.ndarray | None:
        """What a whole module has, shape (N,), where it is given."""
        if key not in self._given:
            return None
        value = self._value(key)
        if np.any(value < 0.0):
            raise OctarmError(f"{key} holds {np.min(value):g}; it must be at least 0")
        return value

    def _damping(
        self, width: np.ndarray, stiffness: np.ndarray, springs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        if "damping_time" not in self._given:
            return self._shares("damping", width)
        if self._given.keys() & {"damping", "axial_damping", "bending_damping"}:
            raise OctarmError("damping_time is given beside damping, which says it already")
        time = _single("damping_time", self._given["damping_time"])
        return time * stiffness, time * springs

    def _shares(self, what: str, width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the columns have of stiffness or damping, and the backbone, shapes (2, N).

        The backbone has what a whole module has beyond its columns. Where columns would have more
        than the whole module, that is taken off both of them alike. Where only the whole module is
        given they have as much as they can; what is not given of it is what the columns give.
        """
        axial, bending = self._whole(f"axial_{what}"), self._whole(f"bending_{what}")
        lever = 0.25 * width * width
        if what in self._given or axial is None or bending is None:
            columns = self._value(what, 2)
            if axial is None and bending is None:
                return columns, np.zeros_like(columns)
            both = columns[0] + columns[1]
            axial = both if axial is None else axial
            bending = lever * both if bending is None else bending
        else:
            both = np.minimum(axial, bending / lever)
            columns = np.stack([0.5 * both] * 2)
        excess = np.maximum(both - np.minimum(axial, bending / lever), 0.0)
        left = columns - 0.5 * excess
        if np.any(left < 0.0):
            module = int(np.argmax(np.any(left < 0.0, axis=0)))
            raise OctarmError(
                f"{what} of the columns of module {module + 1} differs by more than its axial and "
                f"bending {what} allow"
            )
        total = left[0] + left[1]
        return left, np.maximum([axial - total, bending - lever * total], 0.0)

    def _shape(self, width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first, second = self._value("rest_length", 2)
        if not np.array_equal(first, second):
            if "rest_angle" in self._given:
                raise OctarmError(
                    "rest_angle is given beside two rows of rest_length, which say it"
                )
            return 0.5 * (first + second), (first - second) / width
        bent = "rest_angle" in self._given
        return first, self._value("rest_angle") if bent else np.zeros(self._modules)


def _range(value: np.ndarray, modules: int) -> np.ndarray:
    """An input range as parameters have it: a pair, or of shape (2, 2N) [N]."""
    if value.shape == (2,):
        return value
    if value.ndim == 2 and len(value) == 2 and value.shape[1] in (1, modules, 2 * modules):
        each = 1 if value.shape[1] == 2 * modules else 2 * modules // value.shape[1]
        return np.repeat(value, each, axis=1)
    raise OctarmError(
        f"input_range has {_size(value)}; it needs a pair (low, high), or a row of lowest and a "
        f"row of highest forces with one number for each of {modules} modules or {2 * modules} "
        "columns"
    )


def _single(key: str, value: np.ndarray) -> float:
    if value.size != 1:
        raise OctarmError(f"{key} has {_size(value)}; it is one number")
    return value.item()


def _size(value: np.ndarray) -> str:
    if value.ndim < 2:
        return f"{value.size} values"
    return " x ".join(map(str, value.shape)) + " values"
