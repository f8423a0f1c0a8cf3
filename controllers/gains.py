"""How a law declares its gains: units, what is allowed, the recommended value, and its tuning.

A gain is a field of the law, annotated with all that is to be known of it:

    K_v: Annotated[Gain, GainField("linear gain", "N s/m, N m s/rad", linear_gain)]

`Law` checks the gains when it is made, `make_controller` fills in the recommended ones, and
`octarm tune` turns the knobs. Gains that several laws share stand in `controllers.recommended`.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from octarm.arrays import read_only
from octarm.errors import OctarmError
from octarm.interfaces import Knob, NominalModel

Gain = np.ndarray | float


@dataclasses.dataclass(frozen=True)
class GainField:
    """A gain that may differ from coordinate to coordinate: it broadcasts to shape (..., 2N).

    Attributes:
        meaning: for people.
        units: of slides and of bends, such as "N s/m, N m s/rad"; one unit if they are the same.
        recommended: the value where nothing else is asked for, or what gives it for a nominal
            model; None for a gain that has to be given, or has a default.
        knob: what multiplies the recommended value in tuning; gains may share one.
        zero: whether it may be 0.
        infinite: whether it may be infinite.
        replaced_by: name of a gain in whose presence this one is not filled in.
    """

    meaning: str
    units: str
    recommended: npt.ArrayLike | Callable[[NominalModel], npt.ArrayLike] | None = None
    knob: Knob | None = None
    _: dataclasses.KW_ONLY
    zero: bool = False
    infinite: bool = False
    replaced_by: str = ""

    def start(self, nominal: NominalModel) -> npt.ArrayLike | None:
        """The recommended value for a nominal model, broadcasts to (..., 2N)."""
        return self.recommended(nominal) if callable(self.recommended) else self.recommended

    def checked(self, name: str, value: Any, nominal: NominalModel) -> Any:
        """The gain as a read-only float array.

        Args:
            name: of the gain, for errors.
            value: a number, or an array of shape (..., 1) or (..., 2N).
            nominal: says what N is.

        Raises:
            OctarmError: if it is not finite, not positive, or has neither one value nor 2N of them.
        """
        gain = read_only(name, value, unbounded=self.infinite)
        self._check_shape(name, gain, nominal)
        good = gain >= 0.0 if self.zero else gain > 0.0
        if not np.all(good):
            allowed = "at least 0" if self.zero else "above 0"
            raise OctarmError(f"{name} holds {gain[~good].flat[0]:g}; it must be {allowed}")
        return gain

    def _check_shape(self, name: str, gain: np.ndarray, nominal: NominalModel) -> None:
        if gain.ndim and gain.shape[-1] not in (1, nominal.coordinates):
            raise OctarmError(
                f"{name} has {gain.shape[-1]} values; it needs 1 or {nominal.coordinates}, one for "
                "each coordinate"
            )


class ShareField(GainField):
    """A share in [0, 1), one number an arm: shape () or (..., 1) [1]."""

    def checked(self, name: str, value: Any, nominal: NominalModel) -> np.ndarray:
        """The share as a read-only float array."""
        del nominal
        share = read_only(name, value)
        if share.ndim and share.shape[-1] != 1:
            raise OctarmError(f"{name} has {share.shape[-1]} values; it is one number an arm")
        good = (share >= 0.0) & (share < 1.0)
        if not np.all(good):
            worst = share[~good].flat[0]
            raise OctarmError(f"{name} holds {worst:g}; it must be at least 0, below 1")
        return share


class RuleField(GainField):
    """One number for each of M fuzzy rules, shape (M,) or (..., 2N, M); M is 1 if it is shared."""

    def checked(self, name: str, value: Any, nominal: NominalModel) -> np.ndarray:
        """The numbers as a read-only float array; they may be negative if they may be 0."""
        numbers = np.atleast_1d(read_only(name, value))
        if numbers.ndim > 1 and numbers.shape[-2] not in (1, nominal.coordinates):
            raise OctarmError(
                f"{name} has shape {numbers.shape}; it must be (M,) or "
                f"(..., {nominal.coordinates}, M) for M rules"
            )
        if not self.zero and not np.all(numbers > 0.0):
            worst = numbers[numbers <= 0.0].flat[0]
            raise OctarmError(f"{name} holds {worst:g}; it must be above 0")
        return numbers


class Switch(GainField):
    """True or False; 1 or 0 on the command line and in files."""

    def checked(self, name: str, value: Any, nominal: NominalModel) -> bool:
        """Whether it is on."""
        del nominal
        if np.ndim(value) > 0 or value not in (0, 1):
            raise OctarmError(f"{name} is {value!r}; it must be True or False, or 1 or 0")
        return bool(value)


@functools.cache
def gain_fields(law: type) -> dict[str, GainField]:
    """The gains of a law by the names of its fields, in the order of the fields."""
    hints: dict[str, Any] = {}
    for base in reversed(law.__mro__):
        hints |= inspect.get_annotations(base, eval_str=True)
    fields: dict[str, GainField] = {}
    for field in dataclasses.fields(law):
        declared = [x for x in typing.get_args(hints[field.name]) if isinstance(x, GainField)]
        if declared:
            fields[field.name] = declared[0]
    return fields


def spelled(field: str) -> str:
    """The name of a gain outside Python, which keeps the word `lambda` of `lambda_` for itself."""
    return field.rstrip("_")


def knobs(law: type) -> tuple[Knob, ...]:
    """What may be turned to tune a law, each knob with the names of its gains."""
    gains: dict[Knob, tuple[str, ...]] = {}
    for name, field in gain_fields(law).items():
        if field.knob is not None:
            gains[field.knob] = (*gains.get(field.knob, ()), spelled(name))
    return tuple(knob._replace(gains=names) for knob, names in gains.items())
