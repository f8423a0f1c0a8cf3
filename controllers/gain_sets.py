"""Tuned gains, from TOML files: those shipped in `controllers/gains/`, and a user's own.

A file holds a controller's name, the number of modules of the arm that it is for, the table
`gains`, and any further tables that say where the gains come from. `octarm tune` writes them.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from octarm.errors import OctarmError, quoted
from octarm.formats import Model, read_toml, to_toml

SHIPPED = Path(__file__).resolve().parent / "gains"


class GainSet(Model):
    """Gains of one controller for arms of one size, and how they were found.

    Attributes:
        controller: its name.
        modules: number of modules N of the arm.
        gains: by the names under which `make_controller` takes them, as numbers or lists.
    """

    model_config = pydantic.ConfigDict(extra="allow")

    controller: str
    modules: int
    gains: dict[str, Any]

    @property
    def origin(self) -> Mapping[str, Any]:
        """How they were found, all other keys: words, numbers, dates, lists and tables."""
        return self.model_extra or {}

    def to_toml(self) -> str:
        """The text of a file; `read_gain_set` is the inverse."""
        return to_toml(self.model_dump())


def read_gain_set(path: str | Path) -> GainSet:
    """A file of gains.

    Raises:
        FileError: if it cannot be read.
        OctarmError: if it is not TOML, or does not hold a set of gains.
    """
    return read_toml(path).read(GainSet)


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
        OctarmError: if there are none, or they are for another controller or another arm.
    """
    if choice == "recommended":
        return {}
    if choice is None or choice == "tuned":
        source, tuned = f"the tuned set of {controller}", shipped(controller)
    elif Path(choice).suffix == ".toml":
        source, tuned = str(choice), read_gain_set(choice)
    else:
        raise OctarmError(
            f"unknown gains {quoted(str(choice))}; they are tuned, recommended, or a file NAME.toml"
        )
    if choice is None and (tuned is None or tuned.modules != modules):
        return {}
    if tuned is None:
        raise OctarmError(f"{controller} comes without tuned gains; `octarm tune` finds some")
    if tuned.controller != controller:
        raise OctarmError(f"{source} holds gains of {tuned.controller}, not of {controller}")
    if tuned.modules != modules:
        raise OctarmError(
            f"{source} is for an arm of {tuned.modules} modules; this one has {modules}"
        )
    return tuned.gains


def shortest(gain: np.ndarray) -> Any:
    """A gain, of any shape, as a number where all its values are the same, else as a list."""
    values = np.unique(gain)
    return values.item() if values.size == 1 else np.asarray(gain).tolist()
