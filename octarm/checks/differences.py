"""Comparison of what was written down with what comes out now, and how it is printed."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

from octarm.errors import printable, quoted

_LISTED = 12  # differences that are printed
ABSENT = "absent"  # instead of a value that is missing


class Difference(NamedTuple):
    """An entry that is not what it was: its dotted name, and both values."""

    key: str
    was: Any
    now: Any


def compare(
    was: Mapping[str, Any], now: Mapping[str, Any], may_differ: Collection[str] = ()
) -> Iterator[Difference]:
    """Entries that only one of them has, or that have another value, down to single numbers.

    Numbers are the same when all their bits are. What is missing on one side is `absent` there.
    Both are contents of JSON files, or what would become one; below the keys of `may_differ`
    numbers and words may differ, what there is may not.
    """
    yield from _compare_tables("", was, json.loads(json.dumps(now)), may_differ)


def _compare_tables(
    key: str, was: Mapping[str, Any], now: Mapping[str, Any], may_differ: Collection[str]
) -> Iterator[Difference]:
    for name in dict.fromkeys((*was, *now)):
        place = f"{key}.{name}".lstrip(".")
        if name in was and name in now:
            yield from _compare(place, was[name], now[name], name in may_differ)
        else:
            yield Difference(place, was.get(name, ABSENT), now.get(name, ABSENT))


def _compare(key: str, was: Any, now: Any, free: bool) -> Iterator[Difference]:
    kinds: set[object] = {type(was), type(now)}
    if kinds == {dict}:
        yield from _compare_tables(key, was, now, was if free else ())
    elif kinds == {list} and len(was) == len(now):
        for i, pair in enumerate(zip(was, now, strict=True)):
            yield from _compare(f"{key}[{i}]", *pair, free)
    elif kinds & {dict, list} or not (free or repr(was) == repr(now)):  # tells 0.0 from -0.0
        yield Difference(key, was, now)


def origin(description: Mapping[str, Any]) -> dict[str, str]:
    """Versions and properties of the machine by name, from the tables `versions` and `host`."""
    given = (description.get(key) for key in ("versions", "host"))
    tables = [cast(dict[str, Any], table) for table in given if isinstance(table, dict)]
    return {key: str(value) for table in tables for key, value in table.items()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """A result that was written down beside that of a re-run, and the origins of both."""

    differences: tuple[Difference, ...]
    then: Mapping[str, str]
    now: Mapping[str, str]

    def origins(self) -> list[str]:
        """Versions and machines side by side, a line each; a star marks what has changed."""
        width = max([7, *map(len, self.then.values())]) + 2
        lines = [f"  {'':<12}  {'then':<{width}}now"]
        for key in dict.fromkeys((*self.then, *self.now)):
            was, now = self.then.get(key, "unknown"), self.now.get(key, "unknown")
            lines.append(f"{' ' if was == now else '*'} {key:<12}  {was:<{width}}{now}")
        return lines


def listed(differences: Sequence[Difference], heading: str) -> list[str]:
    """A heading, and a line for each of the first differences; no line when there are none."""
    if not differences:
        return []
    lines = [f"  {heading:<34}  was -> is"]
    lines += [
        f"  {printable(key, 80):<34}  {quoted(was)} -> {quoted(now)}"
        for key, was, now in differences[:_LISTED]
    ]
    left = len(differences) - _LISTED
    return [*lines, f"  and {left} more"] if left > 0 else lines
