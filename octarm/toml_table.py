"""Reading TOML with errors that name the line."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any, cast

from octarm.errors import OctarmError, closest

Key = tuple[str, ...]

_WORD = r"(?:[A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')"
_DOTTED = rf"({_WORD}(?:\s*\.\s*{_WORD})*)"
_HEADING = re.compile(rf"\s*\[\s*{_DOTTED}\s*\]")
_ENTRY = re.compile(rf"\s*{_DOTTED}\s*=")


class Source:
    """A TOML text, and where its keys stand.

    Attributes:
        file: its name in error messages.
        text: what it says.
    """

    def __init__(self, text: str, file: str) -> None:
        """A text; `file` is its name."""
        self.text, self.file = text, file
        self._lines = _key_lines(text)

    def table(self) -> Table:
        """The whole of it.

        Raises:
            ValueError: if it is not TOML.
        """
        try:
            return Table(tomllib.loads(self.text), (), self)
        except tomllib.TOMLDecodeError as error:
            raise OctarmError(f"{self.file}: {error}") from None

    def where(self, *keys: str) -> str:
        """File and line of a key, in words; those of its table when it stands nowhere."""
        for depth in range(len(keys), 0, -1):
            if keys[:depth] in self._lines:
                return f"{self.file}, line {self._lines[keys[:depth]]}"
        return self.file


class Table:
    """A table, whose keys are asked for one by one; `done` complains about the others.

    Attributes:
        data: keys and values.
    """

    def __init__(self, data: Mapping[str, Any], path: Key, source: Source) -> None:
        """The table at a path of a text."""
        self.data = data
        self._path, self._source = path, source
        self._known: list[str] = []

    def take(self, key: str) -> Any:
        """The value of a key; None when it is not there."""
        self._known.append(key)
        return self.data.get(key)

    def table(self, key: str) -> Table:
        """The table under a key; an empty one when it is not there."""
        value = self.take(key)
        if value is not None and not isinstance(value, dict):
            raise self.error(f"{key} is {shown(value)}; it must be a table", key)
        return Table(cast(dict[str, Any], value or {}), (*self._path, key), self._source)

    def whole(self, key: str, default: int, *, at_least: int) -> int:
        """An integer."""
        value = self.take(key)
        if value is None:
            return default
        if not isinstance(value, int) or isinstance(value, bool) or value < at_least:
            raise self.error(
                f"{key} is {shown(value)}; it must be a whole number, at least {at_least}", key
            )
        return value

    def positive(self, key: str) -> float | None:
        """A positive number; None when it is not there."""
        value = self.take(key)
        if value is None:
            return None
        if not is_number(value) or not 0.0 < value < math.inf:
            raise self.error(f"{key} is {shown(value)}; it must be a positive number", key)
        return float(value)

    def word(self, key: str, known: Iterable[str], default: str) -> str:
        """One of the known words."""
        value = self.take(key)
        if value is None:
            return default
        if value not in list(known):
            raise self.error(f"unknown {key} {shown(value)}{closest(str(value), known)}", key)
        return value

    def done(self) -> None:
        """Raises ValueError if there is a key that nobody asked for."""
        for key in self.data:
            if key not in self._known:
                inside = f" in [{'.'.join(self._path)}]" if self._path else ""
                raise self.error(f"unknown key {key!r}{inside}{closest(key, self._known)}", key)

    def error(self, message: str, *keys: str) -> ValueError:
        """An error about a key of this table."""
        return ValueError(f"{self._source.where(*self._path, *keys)}: {message}")


def is_number(value: Any) -> bool:
    """Whether a TOML value is a number, and not NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def items(value: Any) -> list[Any] | None:
    """Those of a list; None for anything else."""
    return cast(list[Any], value) if isinstance(value, list) else None


def floats(value: Any) -> Any:
    """The value with its numbers as floats, so that 1 and 1.0 are the same."""
    if (listed := items(value)) is not None:
        return [floats(item) for item in listed]
    return float(value) if is_number(value) else value


def shown(value: Any) -> str:
    """A value as the file spells it."""
    return "not given" if value is None else json.dumps(value, default=str)


def _key_lines(text: str) -> dict[Key, int]:
    """The line on which each key stands first; keys within braces have none."""
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
    found = re.findall(r"\"([^\"]*)\"|'([^']*)'|([A-Za-z0-9_-]+)", dotted)
    return tuple("".join(parts) for parts in found)
