"""What all laws have in common: a nominal model, and gains that are declared at their fields.

A gain is a field of the law, annotated with all that is to be known of it:

    K_v: Annotated[Gain, GainField("linear gain", "N s/m, N m s/rad", linear_gain)]

`Law` checks the gains when it is made, `make_controller` fills in the recommended ones, and
`octarm tune` turns the knobs. Gains that several laws share stand in `controllers.recommended`.
A law holds them in SI. Its units say how a gain scales with the nominal model, see
`controllers.scaling`: sets of gains hold numbers in these scales, which suit all similar arms.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import inspect
import typing
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from controllers.scaling import along, unit
from octarm.arrays import read_only
from octarm.errors import OctarmError, quoted
from octarm.interfaces import Command, Knob, Measurement, NominalModel, Reference
from octarm.units import is_like_a_number, number

Gain = np.ndarray | float


@dataclasses.dataclass(frozen=True)
class GainField:
    """A gain that may differ from coordinate to coordinate: it broadcasts to shape (..., 2N).

    Attributes:
        meaning: for people.
        units: of slides and of bends, such as "N s/m, N m s/rad"; one unit if they are the same.
            They are the gain's dimension: what it is scaled by, see `controllers.scaling`.
        recommended: the value where nothing else is asked for: numbers in the scales of the
            nominal model, or a function that gives the SI value for a nominal model; None for a
            gain that has to be given, or has a default.
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
        """The recommended value for a nominal model [SI], broadcasts to (..., 2N)."""
        if callable(self.recommended):
            return self.recommended(nominal)
        return None if self.recommended is None else self.scaled(self.recommended, nominal)

    def scaled(self, numbers: npt.ArrayLike, nominal: NominalModel) -> npt.ArrayLike:
        """The gain [SI] for numbers in the scales of a nominal model, see `controllers.scaling`.

        Numbers of shape (), (..., 1) or (..., 2M), for any M, become (..., 1) or (..., 2N).
        What is no number, or too many of them, stays as it is, to be refused by `checked`.
        """
        try:
            array = np.asarray(numbers, dtype=np.float64)
        except (TypeError, ValueError):
            return numbers
        array = along(array, nominal.modules, nominal.coordinates)
        fits = array.ndim == 0 or array.shape[-1] in (1, nominal.coordinates)
        return array * unit(self.units, nominal) if fits else array

    def in_si(self, name: str, value: Any) -> Any:
        """The gain with numbers [SI] in place of texts such as "15/s", one or a list.

        Of a list the first half are those of slides; a word stays as it is. Raises OctarmError for
        a number with the unit of another quantity.
        """
        units = self.units.split(", ")
        if isinstance(value, str):
            return number(name, value, " or ".join(units)) if is_like_a_number(value) else value
        if not isinstance(value, list | tuple):
            return value
        listed = cast("Sequence[Any]", value)
        return [
            number(name, x, units[i * len(units) // len(listed)]) if isinstance(x, str) else x
            for i, x in enumerate(listed)
        ]

    def checked(self, name: str, value: Any, nominal: NominalModel) -> Any:
        """The gain as a read-only float array, of shape (), (..., 1) or (..., 2N).

        Raises OctarmError if it is not finite, not positive, or has neither one value nor 2N of
        them.
        """
        gain = read_only(name, value, unbounded=self.infinite).copy(order="F")  # arm beside arm
        gain.setflags(write=False)
        _check_coordinates(name, gain, nominal)
        if self.zero:
            return _within(name, gain, gain >= 0.0, "at least 0")
        return _within(name, gain, gain > 0.0, "above 0")


class _Unscaled(GainField):
    """What is the same for all arms, and not one number for each coordinate."""

    def scaled(self, numbers: npt.ArrayLike, nominal: NominalModel) -> npt.ArrayLike:
        del nominal
        return numbers


class ShareField(_Unscaled):
    """A share in [0, 1), one number an arm: shape () or (..., 1) [1]."""

    def checked(self, name: str, value: Any, nominal: NominalModel) -> np.ndarray:
        share = read_only(name, value)
        if share.ndim and share.shape[-1] != 1:
            raise OctarmError(f"{name} has {share.shape[-1]} values; it is one number an arm")
        return _within(name, share, (share >= 0.0) & (share < 1.0), "at least 0, below 1")


class RuleField(_Unscaled):
    """One number for each of M fuzzy rules, shape (M,) or (..., 2N, M); M is 1 if it is shared."""

    def checked(self, name: str, value: Any, nominal: NominalModel) -> np.ndarray:
        """The numbers as a read-only float array; they may be negative if they may be 0."""
        numbers = np.atleast_1d(read_only(name, value))
        if numbers.ndim > 1 and numbers.shape[-2] not in (1, nominal.coordinates):
            raise OctarmError(
                f"{name} has shape {numbers.shape}; it must be (M,) or "
                f"(..., {nominal.coordinates}, M) for M rules"
            )
        return _within(name, numbers, self.zero | (numbers > 0.0), "above 0")


class Switch(_Unscaled):
    """True or False; 1 or 0 on the command line and in files."""

    def checked(self, name: str, value: Any, nominal: NominalModel) -> bool:
        if np.ndim(value) > 0 or value not in (0, 1):
            raise OctarmError(f"{name} is {quoted(value)}; it must be True or False, or 1 or 0")
        return bool(value)


@dataclasses.dataclass(frozen=True)
class Undeclared(_Unscaled):
    """What a law says nothing of: one number, 2N of them, or what has the shape of its default."""

    default: Any = None

    def checked(self, name: str, value: Any, nominal: NominalModel) -> Any:
        """A float or a read-only float array; words and whole numbers as they are."""
        if isinstance(value, str | bool | int):
            return value
        array = read_only(name, value)
        if array.shape != np.shape(self.default):
            _check_coordinates(name, array, nominal)
        return array if array.ndim else array.item()


def _check_coordinates(name: str, gain: np.ndarray, nominal: NominalModel) -> None:
    if gain.ndim and gain.shape[-1] not in (1, nominal.coordinates):
        raise OctarmError(
            f"{name} has {gain.shape[-1]} values; it needs 1 or {nominal.coordinates}, one for "
            "each coordinate"
        )


def _within(name: str, gain: np.ndarray, good: np.ndarray, allowed: str) -> np.ndarray:
    if not np.all(good):
        raise OctarmError(f"{name} holds {gain[~good].flat[0]:g}; it must be {allowed}")
    return gain


@functools.cache
def gain_fields(law: type) -> dict[str, GainField]:
    """The gains of a law by the names of its fields, in the order of the fields."""
    hints: dict[str, Any] = {}
    for base in reversed(law.__mro__):
        hints |= inspect.get_annotations(base, eval_str=True)
    return {
        name: declared
        for name, hint in hints.items()
        for declared in typing.get_args(hint)
        if isinstance(declared, GainField)
    }


def spelled(field: str) -> str:
    """The name of a gain outside Python, which keeps the word `lambda` of `lambda_` for itself."""
    return field.rstrip("_")


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Law(abc.ABC):
    """A controller with gains; a law adds its gains as fields, and `__call__`.

    Attributes:
        nominal: the model that the controller believes.

    Raises:
        OctarmError: for a gain that its field does not allow.
    """

    nominal: NominalModel

    def __post_init__(self) -> None:
        optional = {field.name for field in dataclasses.fields(self) if field.default is None}
        for name, field in gain_fields(type(self)).items():
            value = getattr(self, name)
            if value is not None or name not in optional:
                value = field.checked(spelled(name), value, self.nominal)
                object.__setattr__(self, name, value)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> Any:
        """None: nothing is remembered from before the first call."""
        del batch_shape

    @abc.abstractmethod
    def __call__(
        self, state: Any, measurement: Measurement, reference: Reference
    ) -> tuple[Command, Any]:
        """The force Q for this instant, shape (..., 2N) [N], [N m], and the next state."""

    def knobs(self) -> tuple[Knob, ...]:
        """What tuning may turn, each knob with the names of its gains."""
        gains: dict[Knob, tuple[str, ...]] = {}
        for name, field in gain_fields(type(self)).items():
            if field.knob is not None:
                gains[field.knob] = (*gains.get(field.knob, ()), spelled(name))
        return tuple(knob._replace(gains=names) for knob, names in gains.items())

    def scales(self) -> dict[str, np.ndarray]:
        """What 1 in the scales of the nominal model is of each gain, see `controllers.scaling`.

        The gains that are numbers by the names that `knobs` uses; shape () or (..., 2N) [SI].
        """
        return {
            spelled(name): np.asarray(field.scaled(1.0, self.nominal))
            for name, field in gain_fields(type(self)).items()
        }

    def errors(
        self, measurement: Measurement, reference: Reference
    ) -> tuple[np.ndarray, np.ndarray]:
        """The errors e = q - q_d and e' = q' - q_d', each of shape (..., 2N); see `check`."""
        self.check(measurement, reference)
        return measurement.q - reference.q, measurement.v - reference.v

    def check(self, measurement: Measurement, reference: Reference) -> None:
        """Raises OctarmError unless all arrays of one instant fit the arm and each other.

        They are of shape (..., 2N), and their batch axes broadcast.
        """
        q, v, (q_d, v_d, a_d) = measurement.q, measurement.v, reference
        shape, size = q.shape, self.nominal.coordinates
        if shape[-1:] == (size,) and v.shape == q_d.shape == v_d.shape == a_d.shape == shape:
            return
        arrays = {"q": q, "v": v, "q_d": q_d, "v_d": v_d, "a_d": a_d}
        for name, array in arrays.items():
            if array.shape[-1:] != (size,):
                raise OctarmError(
                    f"{name} has shape {array.shape}; its last axis must hold {size} coordinates "
                    f"for {self.nominal.modules} modules"
                )
        try:
            np.broadcast_shapes(*(array.shape for array in arrays.values()))
        except ValueError:
            listed = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise OctarmError(f"the batch axes of one instant do not fit: {listed}") from None

    def without_windup(
        self, measurement: Measurement, command: Command, rate: np.ndarray
    ) -> np.ndarray:
        """The rate of what a law integrates, 0 where integrating on would be windup.

        Conditional integration: where inputs are cut off at their range, the arm lacks a part of Q,
        see `NominalModel.shortfall`. A coordinate that lacks force in the direction in which -s
        pushes gets no more of it by integrating further in that direction. Where nothing is cut
        off, the rate is what it was. It is that of an integral that acts on Q with a minus sign,
        such as e or s, shape (..., 2N); the command that the law answers has the signal s.
        """
        lacking = self.nominal.shortfall(measurement.q, command.force)
        if lacking is None:
            return rate
        further = (lacking * command.signals["s"] < 0.0) & (lacking * rate < 0.0)
        return np.where(further, 0.0, rate)


def elapsed(before: float | None, now: float) -> float:
    """Time since the last call [s], 0 if there was none; raises OctarmError if time went back."""
    if before is None:
        return 0.0
    if now < before:
        raise OctarmError(
            f"t is {now:g} s after {before:g} s; time must not go back, start from initial_state"
        )
    return now - before
