"""TOML and JSON files as typed models, and back: the one reader, the one writer, the one version.

A file is read into a `Document`, and that into a `Model`, which says what its keys are and may be.
What is wrong becomes one sentence with the file, the line where it is known, the key, the value,
and what is allowed or the closest match.

pydantic does the checking. Of the libraries compared on specs of sweeps it alone hands on each
error as data: its place, the value and what is allowed. msgspec names the place but not the value;
cattrs checks no ranges.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import json
import math
import re
import tomllib
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar, cast

import numpy as np
import pydantic
from pydantic_core import ErrorDetails, PydanticCustomError

from octarm.errors import FileError, OctarmError, closest, quoted
from octarm.files import unreadable

FORMAT = 3  # version of the formats of run.json and manifest.json
_LARGEST = 10**300  # whole number; larger ones are no floats
_DEEPEST = 64  # tables and lists within each other
_LONGEST = 10**8  # characters of a file

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

    # What users mean by keys that there are not, where it is not the most similar one.
    meant: ClassVar[Mapping[str, str]] = {}

    model_config = pydantic.ConfigDict(strict=True, extra="forbid", frozen=True)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _known_keys(cls, content: Any) -> Any:
        if isinstance(content, dict) and cls.model_config.get("extra") == "forbid":
            for key in cast(dict[str, Any], content):
                if key not in cls.model_fields:
                    hint = closest(key, cls.model_fields, cls.meant.get(key, ""))
                    raise PydanticCustomError("unknown_key", "{hint}", {"key": key, "hint": hint})
        return cast(Any, content)


@dataclasses.dataclass(frozen=True)
class Document:
    """The content of a file, with its name in error messages."""

    file: str
    content: Mapping[str, Any]
    text: str = ""  # the TOML text, in which lines are looked up

    def read(self, kind: type[T], *keys: str) -> T:
        """The content, or the value at some keys, as a model or another type.

        Anything else is an OctarmError.
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

    def error(self, message: str, *keys: str) -> OctarmError:
        """An error about a key, with its line, or that of its table where it has none."""
        lines = _key_lines(self.text)
        known = [lines[keys[:i]] for i in range(len(keys), 0, -1) if keys[:i] in lines]
        return OctarmError(f"{self.file}{f', line {known[0]}' if known else ''}: {message}")

    @contextlib.contextmanager
    def naming(self, *keys: str) -> Generator[None]:
        """Lets an OctarmError of the block name the file and the line of a key, as `error` does."""
        try:
            yield
        except OctarmError as error:
            raise self.error(str(error), *keys) from None

    def _sentence(self, above: Key, errors: list[ErrorDetails]) -> OctarmError:
        """The first error, unknown keys before others; a value's alternatives have one."""
        first = next((e for e in errors if e["type"] == "unknown_key"), errors[0])
        place = self._place(above, first)
        alike = [e for e in errors if self._place(above, e) == place]
        if isinstance(first["input"], str):
            first = next((e for e in alike if e["type"] == "unknown_word"), first)
        keys = tuple(part for part in place if isinstance(part, str))
        table, key = ".".join(keys[:-1]), keys[-1] if keys else "the file"
        context: dict[str, Any] = first.get("ctx", {})
        match first["type"]:
            case "unknown_key":
                inside = f" in [{'.'.join(keys)}]" if keys else ""
                keys = (*keys, context["key"])
                message = f"unknown key {quoted(context['key'])}{inside}{context['hint']}"
            case "missing":
                message = f"{f'[{table}]' if table else 'it'} needs a value of {key}"
            case "unknown_word":
                message = f"unknown {key} {spelt(first['input'])}{context['hint']}"
            case _:
                value = f"{'is' if place[-1:] == keys[-1:] else 'holds'} {spelt(first['input'])}"
                allowed = " or ".join(dict.fromkeys(map(_allowed, alike)))
                message = f"{key} {value}; it must be {allowed}"
        return self.error(message, *keys)

    def _place(self, above: Key, error: ErrorDetails) -> tuple[str | int, ...]:
        """Where the value of an error is, without the names of the alternatives of a type."""
        place: list[str | int] = []
        value: Any = self.content
        for part in (*above, *error["loc"]):
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                if error["type"] != "missing":
                    continue
            place.append(part)
        return tuple(place)


def read_toml(path: str | Path) -> Document:
    """The content of a TOML file; raises FileError if it cannot be read."""
    return parse_toml(_text(Path(path)), str(path))


def parse_toml(text: str, file: str) -> Document:
    """The content of a TOML text; `file` is its name in error messages."""
    try:
        return Document(file, _checked(tomllib.loads(text)), text)
    except (RecursionError, ValueError) as error:
        raise OctarmError(f"{file}: {error}") from None


def read_json(path: str | Path) -> Document:
    """The table in a JSON file; raises FileError if it cannot be read."""
    text = _text(Path(path))
    try:
        content: Any = _checked(json.loads(text, parse_constant=_finite, parse_float=_finite))
    except (RecursionError, ValueError) as error:
        raise OctarmError(f"{path} is not readable ({error})") from None
    if not isinstance(content, dict):
        raise OctarmError(f"{path} holds no table, but {spelt(content)}")
    return Document(str(path), cast(dict[str, Any], content))


def check_format(document: Document) -> None:
    """Raises OctarmError for a file whose key `format` is not `FORMAT`."""
    version = document.content.get("format", 1)  # the first one was not written down
    if version != FORMAT:
        raise OctarmError(
            f"{document.file} has format {spelt(version)}; this version of octarm reads format "
            f"{FORMAT}, so read it with the version that wrote it"
        )


def to_toml(content: Mapping[str, Any]) -> str:
    """A TOML text of words, numbers, dates, lists and tables, with a line for a table in a list.

    None values are left out.
    """
    import tomlkit

    def lined_up(value: Any) -> Any:
        if isinstance(value, Mapping):
            table = cast(Mapping[str, Any], value)
            return {key: lined_up(item) for key, item in table.items()}
        rows = cast(list[Any], value) if isinstance(value, list) else []
        if not rows or not all(isinstance(row, Mapping) for row in rows):
            return cast(Any, value)
        lines: Any = tomlkit.array().multiline(True)
        for row in rows:
            line: Any = tomlkit.inline_table()
            line.update(row)
            lines.append(line)
        return lines

    return tomlkit.dumps(lined_up({k: v for k, v in content.items() if v is not None}))


def to_json(content: Mapping[str, Any]) -> str:
    """A JSON text with a line for each key, and for each table in a list.

    Arrays become lists, infinity the word that `octarm.arrays.read_only` understands, NaN null.
    """
    return _json(content, "") + "\n"


def spelt(value: Any) -> str:
    """A value as a file spells it, for error messages."""
    return quoted(value, functools.partial(json.dumps, default=str, ensure_ascii=False))


_WORDS = {
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid string": "a word",
    "a valid tuple": "a list",
    "a valid list": "a list",
    "a valid dictionary": "a table",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "greater than": "above",
    "less than": "below",
}


def _allowed(error: ErrorDetails) -> str:
    if error["type"] == "value_error":
        return str(error.get("ctx", {})["error"])
    words = error["msg"].removeprefix("Input should be ").partition(" or instance of ")[0]
    for pydantic_says, word in _WORDS.items():
        words = words.replace(pydantic_says, word)
    return words


def _text(path: Path) -> str:
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read(_LONGEST + 1)  # a device may have no end
    except OSError as error:
        raise unreadable(path, error) from None
    except UnicodeDecodeError:
        raise FileError(f"{path} is not a text file in UTF-8") from None
    except ValueError:  # a zero byte
        raise FileError(f"{path} cannot be the name of a file") from None
    if len(text) > _LONGEST:
        raise FileError(f"{path} has more than {_LONGEST} characters")
    return text


def _finite(word: str) -> float:
    """A number of a JSON text; ValueError for what JSON does not know."""
    number = float(word)
    if not math.isfinite(number):
        raise ValueError(f"{word} is no number of such a file")
    return number


def _checked(content: Any) -> Any:
    """What was read, as it is; ValueError for what nobody who works on with it can take."""
    level: list[Any] = [content]
    for _ in range(_DEEPEST):
        if not level:
            return content
        below: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                table = cast(dict[str, Any], value)
                below += [*table, *table.values()]
            elif isinstance(value, list):
                below += cast(list[Any], value)
            elif isinstance(value, str) and not value.isascii():
                value.encode()  # half of a surrogate pair is a ValueError
            elif isinstance(value, int) and abs(value) > _LARGEST:
                raise ValueError(f"{quoted(value)} is too large a number")
        level = below
    raise ValueError(f"it is nested more than {_DEEPEST} levels deep")


def _json(value: Any, indent: str | None) -> str:
    """A JSON text that is indented so far, or on one line."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        inner, ends = None if indent is None else indent + " ", "{}"
        table = cast(Mapping[str, Any], value)
        rows = [f"{json.dumps(key)}: {_json(item, inner)}" for key, item in table.items()]
    elif isinstance(value, list | tuple):
        items, ends = cast(list[Any], value), "[]"
        rows = [_json(item, None) for item in items]
        indent = indent if any(isinstance(item, Mapping) for item in items) else None
    elif isinstance(value, float) and not math.isfinite(value):
        return json.dumps(None if math.isnan(value) else str(value))
    else:
        return json.dumps(value)
    if indent is None or not rows:
        return ends[0] + ", ".join(rows) + ends[1]
    lines = ",\n".join(f"{indent} {row}" for row in rows)
    return f"{ends[0]}\n{lines}\n{indent}{ends[1]}"


_WORD = r"(?:[A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')"
_LINE = re.compile(rf"\s*(\[)?\s*({_WORD}(?:\s*\.\s*{_WORD})*)\s*(?(1)\]|=)")  # [a.b] or a.b =


def _key_lines(text: str) -> dict[Key, int]:
    """The line on which each key of a TOML text stands first; keys within braces have none."""
    lines: dict[Key, int] = {}
    table: Key = ()
    for number, line in enumerate(text.splitlines(), 1):
        if match := _LINE.match(line):
            path = tuple(part.strip("\"'") for part in re.findall(_WORD, match[2]))
            if match[1]:
                table = path
            else:
                path = (*table, *path)
            for depth in range(1, len(path) + 1):
                lines.setdefault(path[:depth], number)
    return lines
