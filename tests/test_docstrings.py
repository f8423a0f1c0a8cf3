"""Whoever takes or returns an array says of what shape.

A docstring names a shape by `shape (..)`, `shapes (..)`, `shape of ..`, or by what something
`broadcasts to`. It may leave that to

- the docstring of the class, for `__call__`;
- the method of a base class that it overrides;
- a line `Shapes: ..` of the module's docstring, where one convention holds for the whole module.

Fields of dataclasses and named tuples name theirs in their own entry under `Attributes`, unless a
`Quantity` declares them, which has the unit and says whether coordinates have values of their own.
"""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from types import ModuleType, UnionType
from typing import Any, get_args

import numpy as np

import controllers
import octarm
from controllers.law import Law, gain_fields
from octarm.disturbances.episode import Disturbance
from octarm.fields import field_kinds
from octarm.references import NamedReference

ARRAYS = re.compile(r"np\.ndarray|npt\.ArrayLike|npt\.NDArray")
SHAPE = re.compile(
    r"\bshapes? (of\b|\()|\bany shape\b|\bbroadcasts? (to|against|together)\b|\(\.\.\."
)


def modules() -> Iterator[ModuleType]:
    for package in (octarm, controllers):
        yield package
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            yield importlib.import_module(found.name)


def of_arrays(annotation: object, module: ModuleType) -> bool:
    """Whether it mentions arrays, or a name such as `Gain` for a number or an array."""
    text = str(annotation)
    named = (vars(module).get(name) for name in re.findall(r"\w+", text))
    unions = (get_args(thing) for thing in named if isinstance(thing, UnionType))
    return bool(ARRAYS.search(text)) or any(np.ndarray in union for union in unions)


def is_public(name: str) -> bool:
    return not name.startswith("_") or name == "__call__"


def own(module: ModuleType, kind: Callable[[object], bool]) -> Iterator[tuple[str, Any]]:
    for name, thing in vars(module).items():
        if kind(thing) and is_public(name) and getattr(thing, "__module__", "") == module.__name__:
            yield name, thing


def functions() -> Iterator[tuple[str, list[str]]]:
    """Public functions and methods with arrays, and the docstrings that may speak for each."""
    for module in modules():
        conventions = re.findall(r"^Shapes: .*?(?=\n\n|\Z)", module.__doc__ or "", re.M | re.S)
        for name, docs, function in [*plain(module), *methods(module)]:
            if any(of_arrays(x, module) for x in inspect.get_annotations(function).values()):
                yield f"{module.__name__}.{name}", [*docs, *conventions]


def plain(module: ModuleType) -> Iterator[tuple[str, list[str], Any]]:
    for name, function in own(module, inspect.isfunction):
        yield name, [function.__doc__ or ""], function


def methods(module: ModuleType) -> Iterator[tuple[str, list[str], Any]]:
    for name, cls in own(module, inspect.isclass):
        for method, member in vars(cls).items():
            function = getattr(member, "__func__", getattr(member, "fget", None)) or member
            function = getattr(function, "func", function)  # of a cached property
            if inspect.isfunction(function) and is_public(method):
                family = [getattr(base, method, None) for base in cls.__mro__]
                docs = [getattr(thing, "__doc__", "") or "" for thing in (function, *family)]
                if method == "__call__":
                    docs.append(cls.__doc__ or "")
                yield f"{name}.{method}", docs, function


def test_a_function_names_the_shapes_of_its_arrays():
    all_docs = dict(functions())
    assert len(all_docs) > 300
    assert [name for name, docs in all_docs.items() if not any(map(SHAPE.search, docs))] == []


def test_a_method_says_what_it_does_or_overrides_one_that_does():
    all_docs = {
        f"{module.__name__}.{name}": docs
        for module in modules()
        for name, docs, function in methods(module)
        if function.__name__ != "<lambda>"  # the default of a field
    }
    assert len(all_docs) > 300
    assert [name for name, docs in all_docs.items() if not any(docs)] == []


def fields() -> Iterator[tuple[str, str, str]]:
    """Public fields that are arrays: where, name, and the docstring of the class."""
    for module in modules():
        for name, cls in own(module, inspect.isclass):
            gains = gain_fields(cls) if issubclass(cls, Law) else {}  # which say what they are
            declares = issubclass(cls, (Disturbance, NamedReference)) and is_dataclass(cls)
            declared = field_kinds(cls) if declares else {}
            for field, annotation in vars(cls).get("__annotations__", {}).items():
                constant = not is_public(field) or "ClassVar" in str(annotation)
                constant |= field in gains or field in declared
                if of_arrays(annotation, module) and not constant:
                    yield f"{module.__name__}.{name}.{field}", field, cls.__doc__ or ""


def names_its_shape(field: str, doc: str) -> bool:
    entry = re.search(rf"^    +{field}: (.*?)(?=^    +\w+: |\Z)", doc, re.M | re.S)
    if entry is None:
        return False
    summary = doc.partition("Attributes:")[0]
    return bool(SHAPE.search(entry[1]) or SHAPE.search(summary)) or "likewise" in entry[1].lower()


def test_a_field_names_its_shape():
    all_fields = list(fields())
    assert len(all_fields) > 100
    assert [where for where, field, doc in all_fields if not names_its_shape(field, doc)] == []
