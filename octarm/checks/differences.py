"""Differences between what was written down and what comes out now."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

_SHOWN = 12  # differences that are listed
_IDLE = ("name", "cores")  # facts of a machine that no result depends on


class Difference(NamedTuple):
    """An entry that is not what it was: its dotted name, and both values."""

    key: str
    was: Any
    now: Any


def compare(was: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Difference]:
    """Entries of `was` that `now` lacks or has with another value, down to single numbers.

    What only `now` has is no difference: later versions write more down. Numbers are the same when
    all their bits are.

    Args:
        was: content of a JSON file.
        now: the same, or what would become of it in JSON.
    """
    return _compare("", dict(was), json.loads(json.dumps(now)))


def told(differences: Sequence[Difference], heading: str) -> list[str]:
    """A line each, and one above them, for the terminal."""
    lines = [f"  {heading:<34}  was -> is"]
    lines += [f"  {key:<34}  {was!r} -> {now!r}" for key, was, now in differences[:_SHOWN]]
    left = len(differences) - _SHOWN
    return [*lines, f"  and {left} more"] if left > 0 else lines


def flat(facts: Mapping[str, Any]) -> dict[str, str]:
    """Facts by name; `facts` holds them in the tables `versions` and `host`."""
    tables: list[Mapping[str, Any]] = [facts.get(key) or {} for key in ("versions", "host")]
    return {key: str(value) for table in tables for key, value in table.items()}


def moved(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Versions and facts of the machine that have changed and may have changed results."""
    return [key for key in then if key in now and then[key] != now[key] and key not in _IDLE]


def despite(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """What has changed although the result has not, a line each."""
    return [f"  although {key} was {then[key]} and is {now[key]}" for key in moved(then, now)]


def beside(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Versions and machines side by side, a line each."""
    width = max([7, *map(len, then.values())]) + 2
    lines = [f"  {'':<12}  {'then':<{width}}now"]
    changed = moved(then, now)
    for key in dict.fromkeys((*then, *now)):
        was, here = then.get(key, "unknown"), now.get(key, "unknown")
        mark = "*" if key in changed else " "
        lines.append(f"{mark} {key:<12}  {was:<{width}}{here}")
    return lines


def _compare(key: str, was: Any, now: Any) -> Iterator[Difference]:
    table, other = _table(was), _table(now)
    if table is not None and other is not None:
        for name, value in table.items():
            yield from _compare(f"{key}.{name}".lstrip("."), value, other.get(name, "absent"))
        return
    old, new = _list(was), _list(now)
    if old is not None and new is not None and len(old) == len(new):
        for i, pair in enumerate(zip(old, new, strict=True)):
            yield from _compare(f"{key}[{i}]", *pair)
    elif repr(was) != repr(now):  # tells 0.0 from -0.0
        yield Difference(key, was, now)


def _table(value: Any) -> dict[str, Any] | None:
    return cast(dict[str, Any], value) if isinstance(value, dict) else None


def _list(value: Any) -> list[Any] | None:
    return cast(list[Any], value) if isinstance(value, list) else None
