"""The numbers that describe one arm, or a batch of arms."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from octarm.arm.recursion import Constants
from octarm.arrays import Entry, entry, plain, read_only, split
from octarm.errors import OctarmError, closest, quoted
from octarm.units import MISMATCH, Range

MOST_MODULES = 100

# What numbers without batch axes are, for people, and what is allowed.
PARAMETERS = {
    "mass": Range("kg", above=0.0, plausible=100.0),
    "inertia": Range("kg m^2", above=0.0),
    "width": Range("m", above=0.0, plausible=10.0),
    "stiffness": Range("N/m", above=0.0),
    "damping": Range("N s/m", at_least=0.0),
    "rest_length": Range("m", above=0.0, plausible=10.0),
    "gravity": Range("m/s^2"),
    "tip_length": Range("m", at_least=0.0, plausible=10.0),
    "input_range": Range("N", plausible=1e6),
    "rest_angle": Range("rad", plausible=2.0 * np.pi),
    "backbone_stiffness": Range("N/m or N m/rad", at_least=0.0),
    "backbone_damping": Range("N s/m or N m s/rad", at_least=0.0),
}
# Number of axes after the batch axes: modules, or columns or directions and modules.
_AXES = dict.fromkeys(PARAMETERS, 1) | {
    "gravity": 0, "tip_length": 0, "stiffness": 2, "damping": 2, "input_range": 2,
    "backbone_stiffness": 2, "backbone_damping": 2,
}  # fmt: skip
_MOSTLY_ZERO = ("rest_angle", "backbone_stiffness", "backbone_damping")
# What a factor on a parameter multiplies as well.
_FOLLOWING = {
    "stiffness": "backbone_stiffness",
    "damping": "backbone_damping",
    "rest_length": "rest_angle",
}

_UNLIMITED: Any = (-np.inf, np.inf)
_NOTHING: Any = 0.0


class Entries(NamedTuple):
    """Parameters entry by entry, for arithmetic along the arm; see `octarm.arrays.split`.

    An entry is a number, or an array of shape (...). Units are those of `ArmParameters`.

    Attributes:
        mass: N entries.
        inertia: N entries.
        half_width: half the distance between the columns, N entries.
        stiffness: for columns 1 and 2, N entries each.
        damping: for columns 1 and 2, N entries each.
        rest_length: N entries.
        rest_angle: N entries.
        backbone_stiffness: along and in bending, N entries each.
        backbone_damping: along and in bending, N entries each.
        gravity: one entry.
        tip_length: one entry.
        plain: whether all modules are straight without force, and have no springs or dampers but
            their columns.
    """

    mass: Sequence[Entry]
    inertia: Sequence[Entry]
    half_width: Sequence[Entry]
    stiffness: tuple[Sequence[Entry], Sequence[Entry]]
    damping: tuple[Sequence[Entry], Sequence[Entry]]
    rest_length: Sequence[Entry]
    rest_angle: Sequence[Entry]
    backbone_stiffness: tuple[Sequence[Entry], Sequence[Entry]]
    backbone_damping: tuple[Sequence[Entry], Sequence[Entry]]
    gravity: Entry
    tip_length: Entry
    plain: bool


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ArmParameters:
    """Parameters of N serially stacked modules, each a slide followed by a hinge.

    Every field may carry batch axes before the axes named here, and one number stands for all
    modules and columns. Arrays are copied and read-only.
    Row 0 of the two-row fields is column 1 of each module, the one that lengthens with a positive
    bending angle.

    Attributes:
        mass: lumped mass at the end of each module, shape (..., N) [kg].
        inertia: its moment of inertia about the bending axis, shape (..., N) [kg m^2].
        width: distance between the two columns of each module, shape (..., N), or (..., 1) where
            all modules of an arm are alike [m]; `l` in the paper, whose printed text shows it as 1.
        stiffness: of each column, shape (..., 2, N) [N/m].
        damping: of each column, shape (..., 2, N) [N s/m].
        rest_length: length of each module's columns without force, shape (..., N) [m].
        gravity: acceleration along the hanging arm, shape (...) [m/s^2].
        tip_length: length of a rigid, massless piece from the last plate to the tip, shape (...)
            [m].
        input_range: lowest and highest input force of each column, in the order of tau, shape
            (..., 2, 2N), or (..., 2, 1) where all columns of an arm are alike [N]. A pair (low,
            high) stands for all columns of all arms. The lowest is 0 for columns that only push,
            the highest for those that only pull; without a range, inputs are not limited.
        rest_angle: bend of each module without force, shape (..., N) [rad]; columns 1 and 2 are
            then rest_length +- (width / 2) rest_angle long.
        backbone_stiffness: what a module has beside its columns, shape (..., 2, N): along it [N/m]
            in row 0, in bending [N m/rad] in row 1.
        backbone_damping: likewise [N s/m], [N m s/rad].

    Raises:
        OctarmError: if a field has the wrong shape, sign, or a value that is not finite, or if
            the input range does not hold 0, the input before an episode begins.
    """

    mass: np.ndarray
    inertia: np.ndarray
    width: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    rest_length: np.ndarray
    gravity: np.ndarray
    tip_length: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(()))
    input_range: np.ndarray = _UNLIMITED
    rest_angle: np.ndarray = _NOTHING
    backbone_stiffness: np.ndarray = _NOTHING
    backbone_damping: np.ndarray = _NOTHING

    if TYPE_CHECKING:  # the constructor takes anything array-like, by name

        def __init__(self, **fields: npt.ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        *arms, modules = read_only("mass", self.mass).shape or (0,)
        for name, axes in _AXES.items():
            if name == "input_range":
                value = _checked_range(self.input_range, arms, 2 * modules)
            else:
                value = read_only(name, getattr(self, name))
                shape = (2, modules)[2 - axes :]
                if name == "width" and value.shape[-1:] in ((), (1,)):
                    shape = (1,)
                if name in _MOSTLY_ZERO and not np.any(value):
                    value = np.zeros(())  # for any number of modules
                if modules and not value.ndim:
                    value = read_only(name, np.full(shape, value))
                _check_shape(name, value, shape)
                _check_bound(name, value, PARAMETERS[name])
            object.__setattr__(self, name, value)
        _ = self.batch_shape  # raises when the batch axes do not fit together

    def __reduce__(self) -> tuple[Any, ...]:  # copies and pickles stay read-only
        return functools.partial(ArmParameters, **self._fields()), ()

    def _fields(self) -> dict[str, np.ndarray]:
        return {name: getattr(self, name) for name in PARAMETERS}

    @functools.cached_property
    def modules(self) -> int:
        """Number of modules N."""
        return self.mass.shape[-1]

    @functools.cached_property
    def coordinates(self) -> int:
        """Number of generalised coordinates 2N."""
        return 2 * self.modules

    @functools.cached_property
    def batch_shape(self) -> tuple[int, ...]:
        """Batch axes that the fields broadcast to; () for one arm."""
        batch = {n: x.shape[: x.ndim - _AXES[n]] for n, x in self._fields().items()}
        try:
            return np.broadcast_shapes(*batch.values())
        except ValueError:
            listed = ", ".join(f"{name} {shape}" for name, shape in batch.items() if shape)
            raise OctarmError(f"the batch axes of the parameters do not fit: {listed}") from None

    @functools.cached_property
    def entries(self) -> Entries:
        """The parameters entry by entry: floats for one arm, views of shape (...) for a batch."""
        by_axes = (entry, split, _two_rows)
        fields = [(name, x) for name, x in self._fields().items() if name in Entries._fields]
        parts: dict[str, Any] = {name: by_axes[_AXES[name]](x) for name, x in fields}
        plain = not any(np.any(getattr(self, name)) for name in _MOSTLY_ZERO)
        return Entries(half_width=split(0.5 * self.widths), plain=plain, **parts)

    @functools.cached_property
    def inertial(self) -> Constants:
        """Masses, inertias, and gravity, one entry, for recursions."""
        return Constants(self.mass, self.inertia, self.gravity[..., None])

    @functools.cached_property
    def elastic(self) -> Constants:
        """Half widths, rest lengths and angles, stiffness and damping, for recursions.

        These two of columns 1 and 2, then of the backbone along it and in bending: rows that are
        empty where modules have nothing but their columns.
        """
        springs = (self.stiffness, self.damping, self.backbone_stiffness, self.backbone_damping)
        pairs = [x[..., i, :] for x in springs for i in (0, 1)]
        if self.entries.plain:
            pairs[4:] = [x[..., :0] for x in pairs[4:]]
        return Constants(0.5 * self.widths, self.rest_length, self.rest_angle, *pairs)

    @functools.cached_property
    def rows(self) -> Constants:
        """All that the equations of motion depend on, for recursions."""
        return Constants(*self.inertial.arrays, *self.elastic.arrays)

    @functools.cached_property
    def widths(self) -> np.ndarray:
        """The width of each module, shape (..., N) [m]."""
        return np.broadcast_to(self.width, (*self.width.shape[:-1], self.modules))

    def input_bounds(self, batch_shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest input force of each column of a batch.

        Each has the shape (*batch_shape, 2N) [N], contiguous along the arms, and is read-only.
        """
        shape = (*batch_shape, 2, self.coordinates)
        low_high = np.array(np.broadcast_to(self.input_range, shape).T, order="C").T
        low_high.setflags(write=False)
        return low_high[..., 0, :], low_high[..., 1, :]

    def arm(self, i: int | slice) -> ArmParameters:
        """The parameters of arm i, or of some arms, of a batch with one batch axis."""
        fields = self._fields().items()
        return ArmParameters(**{n: x[i] if x.ndim > _AXES[n] else x for n, x in fields})

    def scaled(self, **factors: npt.ArrayLike) -> ArmParameters:
        """A copy with the named fields multiplied by factors [1] that broadcast against them.

        What the backbone has of stiffness or damping follows the mean of a module's columns, and
        the bend without force follows the rest length. Raises OctarmError for an unknown field, or
        a factor that makes a field invalid.
        """
        changed: dict[str, Any] = {}
        for name, factor in factors.items():
            if name not in PARAMETERS:
                raise OctarmError(f"unknown parameter {quoted(name)}{closest(name, PARAMETERS)}")
            by, field = read_only(f"factor of {name}", factor), getattr(self, name)
            _check_bound(f"factor of {name}", by, PARAMETERS[name])
            try:
                changed[name] = changed.get(name, field) * by
            except ValueError:
                raise OctarmError(
                    f"factor of {name} has shape {by.shape}, which does not fit {field.shape}"
                ) from None
            other = _FOLLOWING.get(name, "")
            if other and np.any(getattr(self, other)):
                rows = by.ndim > 1 and by.shape[-2] == 2 and other != "rest_angle"
                mean = 0.5 * (by[..., :1, :] + by[..., 1:, :]) if rows else by
                changed[other] = changed.get(other, getattr(self, other)) * mean
        return dataclasses.replace(self, **changed)

    def mismatched(self, mismatch: npt.ArrayLike) -> ArmParameters:
        """A nominal model that is wrong by `mismatch` [1], shape () or a batch's (...).

        Mass, inertia and damping are multiplied by 1 + mismatch, stiffness by 1 + mismatch/2.
        Raises OctarmError unless mismatch is above -1 and at most 1e6.
        """
        wrong = np.asarray(mismatch, dtype=np.float64)
        if not np.all(good := MISMATCH.allows(wrong)):
            worst = wrong[~good].flat[0].item()
            raise OctarmError(
                f"mismatch is {worst:g}; it must be above -1 and at most 1e+06"
                f"{MISMATCH.meant(worst)}"
            )
        factor = (1.0 + wrong)[..., None]
        half = (1.0 + wrong / 2.0)[..., None, None]
        arm = self.scaled(mass=factor, inertia=factor, damping=factor[..., None], stiffness=half)
        # Contiguous along the arms, as states are.
        return ArmParameters(**{n: np.array(x, order="F") for n, x in arm._fields().items()})

    def to_dict(self) -> dict[str, Any]:
        """The fields as numbers and nested lists, ready for JSON.

        Of the last three those that are 0 throughout are left out.
        """
        fields = self._fields().items()
        return {n: plain(x) for n, x in fields if n not in _MOSTLY_ZERO or np.any(x)}

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> ArmParameters:
        """The inverse of `to_dict`; OctarmError if a field is missing, unknown or invalid."""
        optional = {"tip_length", *_MOSTLY_ZERO}  # have defaults
        wrong = (set(fields) ^ set(PARAMETERS)) - optional
        if wrong:
            raise OctarmError(
                f"parameters need exactly the fields {', '.join(PARAMETERS)}; "
                f"missing or unknown: {', '.join(sorted(wrong))}"
            )
        return cls(**fields)


def _two_rows(x: np.ndarray) -> tuple[Sequence[Entry], Sequence[Entry]]:
    return split(x[..., 0, :]), split(x[..., 1, :])


def _check_shape(name: str, value: np.ndarray, expected: tuple[int, ...]) -> None:
    if 0 in expected:
        raise OctarmError(f"mass has shape {value.shape}; it must be (..., N) with N at least 1")
    if value.shape[max(0, value.ndim - len(expected)) :] != expected:
        wanted = f"(..., {', '.join(map(str, expected))})"
        raise OctarmError(
            f"{name} has shape {value.shape}; it must be {wanted} for the {expected[-1]} modules "
            "that mass has"
        )


def _checked_range(value: npt.ArrayLike, arms: Sequence[int], columns: int) -> np.ndarray:
    """An input range as a read-only array, of shape (..., 2, columns) or (..., 2, 1) [N]."""
    bounds = read_only("input_range", value, unbounded=True, unbounded_below=True)
    if bounds.shape == (2,):
        bounds = np.tile(bounds[:, None], (*arms, 1, 1))
        bounds.setflags(write=False)
    if bounds.shape[-2:] not in ((2, 1), (2, columns)):
        raise OctarmError(
            f"input_range has shape {bounds.shape}; it must be a pair (low, high), or "
            f"(..., 2, {columns}) with the low and the high bound of each of {columns} columns"
        )
    low, high = bounds[..., 0, :], bounds[..., 1, :]
    wrong = ~((low <= 0.0) & (high >= 0.0) & (low < high))
    if np.any(wrong):
        raise OctarmError(
            f"input_range goes from {low[wrong].flat[0]:g} to {high[wrong].flat[0]:g}; it must go "
            "from at most 0 to at least 0, and not be empty"
        )
    return bounds


def _check_bound(name: str, value: np.ndarray, kind: Range) -> None:
    good = kind.allows(value)
    if not np.all(good):
        allowed = "at least" if np.isinf(kind.above) else "above"
        raise OctarmError(f"{name} holds {value[~good].flat[0]:g}; it must be {allowed} 0")
