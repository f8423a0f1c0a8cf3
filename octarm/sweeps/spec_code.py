"""What a spec names that is not built in, `MODULE:NAME` or `FILE.py:NAME`, gets a short name.

A file is looked for beside the spec. The names, and what they stand for, are in the table `[code]`
of the spec that the sweep keeps. Whoever reads that one imports nothing: see `octarm.declared`.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from octarm.declared import Declared, absolute, named
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError
from octarm.formats import Document
from octarm.metrics.declared import ACCUMULATORS
from octarm.references import REFERENCES, parameters_of
from octarm.sweeps.spec import which

# Whoever makes controllers knows which are built in, and what a controller is.
_CONTROLLERS: Declared[Any] = Declared("controller", {}, lambda thing: "")
_TABLES: Mapping[str, Declared[Any]] = {
    "controller": _CONTROLLERS, "reference": REFERENCES, "metric": ACCUMULATORS,
}  # fmt: skip
_OF_DISTURBANCES = (("grid", "disturbance"), ("random", "disturbance"), ("disturbance",))
_OF_CONTROLLERS = (("gains",), ("gain_set",))


def with_names(document: Document) -> Document:
    """The spec with short names, and with its table `code`; the same if all of it is built in.

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
    if not code:
        return document
    short = dict(zip(words, names, strict=True))
    content = _renamed(document.content, lambda kind, word: short.get((kind, word), word))
    content["code"] = {**known, **{name: each.model_dump() for name, each in code.items()}}
    return dataclasses.replace(document, content=content)


def _words(content: Mapping[str, Any]) -> Iterator[tuple[Declared[Any], str, tuple[str, ...]]]:
    for place in ((), ("grid",)):
        for kind, table in _TABLES.items():
            value = _at(content, *place).get(kind)
            items = cast("list[Any]", value) if isinstance(value, list) else [value]
            for word in items:
                if isinstance(word, str):
                    yield table, word, (*place, kind)
    for place in _OF_DISTURBANCES:
        for word in _at(content, *place):
            yield DISTURBANCES, which(word)[0], (*place, word)


def _renamed(content: Mapping[str, Any], name: Callable[[str, str], str]) -> dict[str, Any]:
    def value(kind: str, old: Any) -> Any:
        if isinstance(old, list):
            return [value(kind, item) for item in cast("list[Any]", old)]
        return name(kind, old) if isinstance(old, str) else old

    def disturbance(word: str) -> str:
        kind, number = which(word)
        new = name("disturbance", kind)
        return new if number == 1 else f"{new}-{number}"

    def controller(word: str) -> str:
        return name("controller", word)

    new = copy.deepcopy(dict(content))
    for place in ((), ("grid",)):
        table = _at(new, *place)
        table |= {kind: value(kind, table[kind]) for kind in _TABLES if kind in table}
    for places, rename in ((_OF_DISTURBANCES, disturbance), (_OF_CONTROLLERS, controller)):
        for place in places:
            table = _at(new, *place)
            items = {rename(word): item for word, item in table.items()}
            table.clear()
            table |= items
    return new


def _at(content: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """The table at these keys; an empty one if there is none."""
    for key in keys:
        value = content.get(key)
        content = cast("dict[str, Any]", value) if isinstance(value, dict) else {}
    return cast("dict[str, Any]", content)
