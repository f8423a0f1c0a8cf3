"""TOML and JSON files as typed models, and back: the one reader, the one writer, the one version.

A file is read into a `Document`, and that into a `Model`, which says what its keys are and may be.
What is wrong becomes one sentence with the file, the line where it is known, the key, the value,
and what is allowed or the closest match.

pydantic does the checking. Of the libraries compared on specs of sweeps it alone hands on each
error as data: its place, the value and what is allowed. msgspec names the place but not the value;
cattrs checks no ranges.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import numpy as np
import pydantic
from pydantic_core import ErrorDetails, PydanticCustomError

from octarm.errors import FileError, OctarmError, closest

FORMAT = 2  # version of the formats of run.json and manifest.json

Key = tuple[str, ...]
T = TypeVar("T")

# A TOML or JSON array, as a tuple.
Array = Annotated[tuple[T, ...], pydantic.Strict(False)]


def one_of(words: Iterable[str]) -> pydantic.AfterValidator:
    """An annotation of `str`: one of these words, which may become more until one is read."""

    def check(word: str) -> str:
        if word not in words:
            raise PydanticCustomError("unknown_word", "{hint}", {"hint": closest(word, words)})
        return word

    return pydantic.AfterValidator(check)


class Model(pydantic.BaseModel):
    """A table of a file: its keys are the fields, and no others are allowed.

    Nothing is converted but whole numbers to floats: a word or a truth value is not a number. A
    validator of a field says in a ValueError what the value must be, such as "positive".
    """

    model_config = pydantic.ConfigDict(strict=True, extra="forbid", frozen=True)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _known_keys(cls, content: Any) -> Any:
        if isinstance(content, dict) and cls.model_config.get("extra") == "forbid":
            for key in cast(dict[str, Any], content):
                if key not in cls.model_fields:
                    hint = closest(key, cls.model_fields)
                    raise PydanticCustomError("unknown_key", "{hint}", {"key": key, "hint": hint})
        return cast(Any, content)


@dataclasses.dataclass(frozen=True)
class Document:
    """The content of a file.

    Attributes:
        file: its name in error messages.
        content: its keys and values.
        text: the TOML text, in which lines are looked up; empty for JSON.
    """

    file: str
    content: Mapping[str, Any]
    text: str = ""

    def read(self, kind: type[T], *keys: str) -> T:
        """The content, or the value of a key, as a model or another type.

        Args:
            kind: what it shall be.
            keys: of the value, that of its table first.

        Raises:
            OctarmError: if it is not what the type allows.
        """
        value: Any = self.content
        for key in keys:
            value = value[key]
        model = inspect.isclass(kind) and issubclass(kind, Model)  # which says itself it is strict
        try:
            return pydantic.TypeAdapter(
                kind, config=None if model else {"strict": True}
            ).validate_python(value)
        except pydantic.ValidationError as error:
            raise self._sentence(keys, error.errors(include_url=False)) from None

    def where(self, *keys: str) -> str:
        """File and line of a key, in words; the line of its table where the key has none."""
        lines = _key_lines(self.text)
        for depth in range(len(keys), 0, -1):
            if keys[:depth] in lines:
                return f"{self.file}, line {lines[keys[:depth]]}"
        return self.file

    def error(self, message: str, *keys: str) -> OctarmError:
        """An error about a key."""
        return OctarmError(f"{self.where(*keys)}: {message}")

    def _sentence(self, above: Key, errors: list[ErrorDetails]) -> OctarmError:
        """The first error; those of the alternatives for the same value are one.

        Unknown keys come first, since a misspelt key is a missing one as well.
        """
        for error in errors:
            error["loc"] = (*above, *error["loc"])
        first = next((e for e in errors if e["type"] == "unknown_key"), errors[0])
        place = self._place(first)
        alike = [e for e in errors if self._place(e) == place]
        if isinstance(first["input"], str):
            first = next((e for e in alike if e["type"] == "unknown_word"), first)
        keys = tuple(part for part in place if isinstance(part, str))
        key, table = (keys[-1], ".".join(keys[:-1])) if keys else ("the file", "")
        value = f"{key} {'is' if place[-1:] == keys[-1:] else 'holds'} {spelt(first['input'])}"
        context: dict[str, Any] = first.get("ctx", {})
        match first["type"]:
            case "unknown_key":
                inside = f" in [{'.'.join(keys)}]" if keys else ""
                key = context["key"]
                message, keys = f"unknown key {key!r}{inside}{context['hint']}", (*keys, key)
            case "missing":
                message = f"{f'[{table}]' if table else 'it'} needs a value of {key}"
            case "unknown_word":
                message = f"unknown {key} {spelt(first['input'])}{context['hint']}"
            case _:
                message = f"{value}; it must be {' or '.join(dict.fromkeys(map(_allowed, alike)))}"
        return self.error(message, *keys)

    def _place(self, error: ErrorDetails) -> tuple[str | int, ...]:
        """Where the value of an error is, without the names of the alternatives of a type."""
        place: list[str | int] = []
        value: Any = self.content
        for part in error["loc"]:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                if error["type"] != "missing":
                    continue
            place.append(part)
        return tuple(place)


def read_toml(path: str | Path) -> Document:
    """The content of a TOML file.

    Raises:
        FileError: if it cannot be read.
        OctarmError: if it is not TOML; the sentence names the line.
    """
    return parse_toml(_text(Path(path)), str(path))


def parse_toml(text: str, file: str) -> Document:
    """The content of a TOML text; `file` is its name in error messages.

    Raises:
        OctarmError: if it is not TOML; the sentence names the line.
    """
    try:
        return Document(file, tomllib.loads(text), text)
    except tomllib.TOMLDecodeError as error:
        raise OctarmError(f"{file}: {error}") from None


def read_json(path: str | Path) -> Document:
    """The content of a JSON file.

    Raises:
        FileError: if it cannot be read.
        OctarmError: if it is not JSON, or holds no table.
    """
    try:
        content: Any = json.loads(_text(Path(path)))
    except json.JSONDecodeError as error:
        raise OctarmError(f"{path} is not readable ({error})") from None
    if not isinstance(content, dict):
        raise OctarmError(f"{path} holds no table, but {spelt(content)}")
    return Document(str(path), cast(dict[str, Any], content))


def check_format(document: Document) -> None:
    """Refuses a file of another version of the format.

    Raises:
        OctarmError: if its key `format` is not `FORMAT`.
    """
    version = document.content.get("format", 1)  # the first one was not written down
    if version != FORMAT:
        raise OctarmError(
            f"{document.file} has format {spelt(version)}; this version of octarm reads format "
            f"{FORMAT}, so read it with the version that wrote it"
        )


def to_toml(content: Mapping[str, Any]) -> str:
    """A TOML text of words, numbers, dates, lists and tables; None values are left out."""
    import tomlkit

    return tomlkit.dumps(_given(content))


def to_json(content: Mapping[str, Any]) -> str:
    """A JSON text with a line for each key, and for each table in a list.

    Arrays become lists, infinity the word that `octarm.arrays.read_only` understands, NaN null.
    """
    return _json(_ready(content), "") + "\n"


def spelt(value: Any) -> str:
    """A value as a file spells it, for error messages."""
    return json.dumps(value, default=str, ensure_ascii=False)


def _allowed(error: ErrorDetails) -> str:
    """What is allowed, in words."""
    if error["type"] == "value_error":
        return str(error.get("ctx", {})["error"])
    words = _TYPES.get(error["type"]) or error["msg"].removeprefix("Input should be ")
    for long, short in _RANGES.items():
        words = words.replace(long, short)
    return words


_TYPES = {
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "a word",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
}
_RANGES = {
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "greater than": "above",
    "less than": "below",
}


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FileError(f"{path} is not a text file in UTF-8") from None


def _given(value: Any) -> Any:
    """A table without the keys whose value is None."""
    if isinstance(value, Mapping):
        table = cast(Mapping[str, Any], value)
        return {key: _given(item) for key, item in table.items() if item is not None}
    if isinstance(value, list | tuple):
        return [_given(item) for item in cast(list[Any], value)]
    return value


def _ready(value: Any) -> Any:
    """A value in the types that JSON has."""
    if isinstance(value, Mapping):
        return {key: _ready(item) for key, item in cast(Mapping[str, Any], value).items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_ready(item) for item in cast(list[Any], value)]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def _json(value: Any, indent: str) -> str:
    inner = indent + " "
    rows: list[str] = []
    if isinstance(value, Mapping):
        table = cast(Mapping[str, Any], value)
        rows = [f"{json.dumps(key)}: {_json(item, inner)}" for key, item in table.items()]
        ends = "{}"
    elif isinstance(value, list) and any(isinstance(x, Mapping) for x in cast(list[Any], value)):
        rows = [json.dumps(item) for item in cast(list[Any], value)]
        ends = "[]"
    else:
        return json.dumps(value)
    lines = ",\n".join(inner + row for row in rows)
    return f"{ends[0]}\n{lines}\n{indent}{ends[1]}" if rows else ends


_WORD = r"(?:[A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')"
_DOTTED = rf"({_WORD}(?:\s*\.\s*{_WORD})*)"
_HEADING = re.compile(rf"\s*\[\s*{_DOTTED}\s*\]")
_ENTRY = re.compile(rf"\s*{_DOTTED}\s*=")


def _key_lines(text: str) -> dict[Key, int]:
    """The line on which each key of a TOML text stands first; keys within braces have none."""
    lines: dict[Key, int] = {}
    table: Key = ()
    for number, line in enumerate(text.splitlines(), 1):
        if match := _HEADING.match(line):
            path = table = _parts(match[1])
        elif match := _ENTRY.match(line):
            path = (*table, *_parts(match[1]))
        else:
            continue
        for depth in range(1, len(path) + 1):
            lines.setdefault(path[:depth], number)
    return lines


def _parts(dotted: str) -> Key:
    return tuple(part.strip("\"'") for part in re.findall(_WORD, dotted))
