"""Tuned gains, from TOML files: those shipped in `controllers/gains/`, and a user's own.

A file holds a controller's name, the number of modules of the arm that it is for, the table
`gains`, and any further tables that say where the gains come from. `octarm tune` writes them.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from octarm.errors import OctarmError

SHIPPED = Path(__file__).resolve().parent / "gains"


@dataclasses.dataclass(frozen=True, kw_only=True)
class GainSet:
    """Gains of one controller for arms of one size, and how they were found.

    Attributes:
        controller: its name.
        modules: number of modules N of the arm.
        gains: by the names under which `make_controller` takes them, as numbers or lists.
        origin: how they were found: words, numbers, dates, lists and tables.
    """

    controller: str
    modules: int
    gains: Mapping[str, Any]
    origin: Mapping[str, Any] = dataclasses.field(default_factory=dict[str, Any])

    def to_toml(self) -> str:
        """The text of a file; `from_toml` is the inverse."""
        lines = [f"controller = {_toml(self.controller)}", f"modules = {self.modules}"]
        for name, table in {"gains": self.gains, **self.origin}.items():
            lines += ["", f"[{name}]", *(f"{key} = {_toml(x)}" for key, x in table.items())]
        return "\n".join(lines) + "\n"

    @classmethod
    def from_toml(cls, text: str, file: str) -> GainSet:
        """Reads the text of a file.

        Args:
            text: what it says.
            file: its name in error messages.

        Raises:
            ValueError: if it is not TOML, or does not hold a set of gains.
        """
        try:
            content = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise OctarmError(f"{file}: {error}") from None
        controller, modules, gains = (
            content.pop(key, None) for key in ("controller", "modules", "gains")
        )
        if not (
            isinstance(controller, str) and isinstance(modules, int) and isinstance(gains, dict)
        ):
            raise OctarmError(
                f"{file} holds no gains; it needs the keys controller and modules, and the table "
                "gains"
            )
        table = cast("dict[str, Any]", gains)
        return cls(controller=controller, modules=modules, gains=table, origin=content)


def read_gain_set(path: str | Path) -> GainSet:
    """A file of gains.

    Raises:
        ValueError: if it does not exist, is not TOML, or does not hold a set of gains.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise OctarmError(f"{path} holds no gains: {reason}") from None
    return GainSet.from_toml(text, str(path))


@functools.cache
def shipped(controller: str) -> GainSet | None:
    """The tuned gains that come with a controller; None when there are none."""
    path = SHIPPED / f"{controller}.toml"
    return read_gain_set(path) if path.is_file() else None


def starting_gains(controller: str, modules: int, choice: str | Path | None) -> Mapping[str, Any]:
    """The gains that take the place of the recommended ones.

    Args:
        controller: its name.
        modules: number of modules of the arm.
        choice: `recommended` for none at all; `tuned` for the shipped ones; a file, whose name
            ends in .toml; None for the shipped ones if there are any for such an arm.

    Raises:
        ValueError: if there are none, or they are for another controller or another arm.
    """
    if choice == "recommended":
        return {}
    if choice is None or choice == "tuned":
        source, found = f"the tuned set of {controller}", shipped(controller)
    elif Path(choice).suffix == ".toml":
        source, found = str(choice), read_gain_set(choice)
    else:
        raise OctarmError(
            f"unknown gains {str(choice)!r}; they are tuned, recommended, or a file NAME.toml"
        )
    if choice is None and (found is None or found.modules != modules):
        return {}
    if found is None:
        raise OctarmError(f"{controller} comes without tuned gains; `octarm tune` finds some")
    if found.controller != controller:
        raise OctarmError(f"{source} holds gains of {found.controller}, not of {controller}")
    if found.modules != modules:
        raise OctarmError(
            f"{source} is for an arm of {found.modules} modules; this one has {modules}"
        )
    return found.gains


def shortest(gain: np.ndarray) -> Any:
    """A gain, of any shape, as a number where all its values are the same, else as a list."""
    values = np.unique(gain)
    return values.item() if values.size == 1 else np.asarray(gain).tolist()


def _toml(value: Any) -> str:
    """A value as TOML spells it, a table on one line."""
    if isinstance(value, Mapping):
        table = cast("Mapping[str, Any]", value)
        return "{ " + ", ".join(f"{key} = {_toml(x)}" for key, x in table.items()) + " }"
    if isinstance(value, list | tuple):
        array = cast("Sequence[Any]", value)
        items = [_toml(item) for item in array]
        if any(isinstance(item, Mapping) for item in array):
            return "[\n" + "".join(f"  {x},\n" for x in items) + "]"
        return f"[{', '.join(items)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return repr(value) if isinstance(value, int | float) else value.isoformat()
