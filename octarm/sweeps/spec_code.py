"""What a spec names that is not built in, `MODULE:NAME` or `FILE.py:NAME`, gets a short name.

A file is looked for beside the spec. The names, and what they stand for, are in the table `[code]`
of the spec that the sweep keeps. Whoever reads that one imports nothing: see `octarm.declared`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from octarm.declared import Code, Declared, absolute, named
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError
from octarm.formats import Document
from octarm.metrics.declared import ACCUMULATORS
from octarm.references import REFERENCES, parameters_of
from octarm.sweeps.spec import which

FIXED, GRID, RANDOM = ("disturbance",), ("grid", "disturbance"), ("random", "disturbance")

# Whoever makes controllers knows which are built in, and what a controller is.
_CONTROLLERS: Declared[Any] = Declared("controller", {}, lambda thing: "")


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
