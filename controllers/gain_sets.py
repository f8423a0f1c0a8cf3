"""Tuned gains, from TOML files: those shipped in `controllers/gains/`, and a user's own.

A file holds a controller's name, the table `gains` of numbers in the scales of the nominal model,
see `controllers.scaling`, the table `arm` of what the gains were tuned for, and any further tables
that say where they come from. `octarm tune` writes them.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from octarm.errors import OctarmError, quoted
from octarm.formats import Document, Model, read_toml, to_toml
from octarm.interfaces import NominalModel

CHOICES = ("tuned", "recommended")  # beside the names of files
SHIPPED = Path(__file__).resolve().parent / "gains"

_FAR = 2.0  # a ratio of the descriptors of two arms beyond which they are not alike
_WORDS = {
    "modules": "number of modules",
    "mode_ratio": "ratio of the fastest to the slowest mode",
    "damping_ratio": "damping ratio of the slowest mode",
    "weight_ratio": "ratio of weight to stiffness",
    "mass_ratio": "ratio of the last to the first mass",
    "control_period": "control period times the fastest mode",
}


class GainSet(Model):
    """Gains of one controller for arms that are similar, and how they were found.

    Attributes:
        controller: its name.
        gains: by the names under which `make_controller` takes them, as numbers or lists, in the
            scales of the nominal model. Lists are in the order of q, of any number of modules.
            Texts with a unit, such as "15/s" or a list of them, are in SI for any arm.
        arm: the `descriptors` of the arm that they were tuned for, and the longest
            `control_period`, in multiples of its time scale [1].
    """

    model_config = pydantic.ConfigDict(extra="allow")

    controller: str
    gains: dict[str, Any]
    arm: dict[str, float]

    @property
    def origin(self) -> Mapping[str, Any]:
        """How they were found, all other keys: words, numbers, dates, lists and tables."""
        return self.model_extra or {}

    def to_toml(self) -> str:
        """The text of a file; `read_gain_set` is the inverse."""
        return to_toml(self.model_dump())


def _far(name: str, here: float, there: float) -> bool:
    """Whether a descriptor of two arms differs so much that gains may not suit."""
    if name == "modules":
        return here != there
    if name == "control_period":  # more often is no trouble
        return here > 1.5 * there
    return not there / _FAR <= here <= there * _FAR


def read_gain_set(path: str | Path) -> GainSet:
    """A file of gains.

    Raises FileError if it cannot be read, OctarmError if it does not hold a set of gains.
    """
    return read_toml(path).read(GainSet)


@functools.cache
def shipped(controller: str) -> GainSet | None:
    """The tuned gains that come with a controller; None when there are none."""
    path = SHIPPED / f"{controller}.toml"
    return read_gain_set(path) if path.is_file() else None


def gain_set_of(
    controller: str, choice: str | Path | Mapping[str, Any] | None
) -> tuple[str, GainSet | None]:
    """The set of gains that takes the place of the recommended ones, and what to call it.

    The choice is `recommended` for none at all; `tuned` for the shipped ones; a file, whose name
    ends in .toml; the content of one; None for the shipped ones if there are any. Raises
    OctarmError if there are none, or they are for another controller.
    """
    if choice == "recommended":
        return "the recommended gains", None
    if choice is None or choice == "tuned":
        source, given = f"the tuned gains of {controller}", shipped(controller)
        if given is None and choice is not None:
            raise OctarmError(f"{controller} comes without tuned gains; `octarm tune` finds some")
        return source, given
    if isinstance(choice, Mapping):
        source, given = "the gain set", Document("the gain set", choice).read(GainSet)
    elif Path(choice).suffix == ".toml":
        source, given = f"the gains of {choice}", read_gain_set(choice)
    else:
        raise OctarmError(
            f"unknown gains {quoted(str(choice))}; they are tuned, recommended, or a file NAME.toml"
        )
    if given.controller != controller:
        raise OctarmError(f"{source} are those of {given.controller}, not of {controller}")
    return source, given


def unsuited(
    controller: str,
    choice: str | Path | Mapping[str, Any] | None,
    nominal: NominalModel,
    control_period: float,
) -> str:
    """A sentence without its stop on gains whose arm or control period [s] is far from these.

    It is empty if they are alike, or nothing is known of the gains. The choice is that of
    `gain_set_of`: recommended gains were set for the arm of the tuned ones, and are for no control
    period in particular. Raises OctarmError if there is no such set.
    """
    source, gains = gain_set_of(controller, choice)
    if gains is None:
        gains, control_period = shipped(controller), 0.0
    there = {} if gains is None else gains.arm
    here = {name: float(value) for name, value in nominal.descriptors.items()}
    here["control_period"] = control_period / float(nominal.time_scale)
    far = ", ".join(
        f"{word} {here[name]:.3g} instead of {there[name]:.3g}"
        for name, word in _WORDS.items()
        if name in there and _far(name, here[name], there[name])
    )
    return far and f"{source} were found for another arm or control period: {far}"


def shortest(gain: np.ndarray) -> Any:
    """A gain, of any shape, as a number where all its values are the same, else as a list."""
    values = np.unique(gain)
    return values.item() if values.size == 1 else np.asarray(gain).tolist()
