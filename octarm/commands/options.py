"""Tables of options: each is declared once, and the work of a command takes it whole.

A command takes such a table as a parameter; its fields are options like the others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from octarm.commands import kinds
from octarm.errors import OctarmError, closest, quoted
from octarm.units import Range, is_bare, is_like_a_number

if TYPE_CHECKING:
    from octarm.arm.parameters import ArmParameters


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """What is changed of an arm, and what the controller believes of it.

    Attributes:
        mismatch: error of the controller's model: mass, inertia and damping times 1 + X,
            stiffness times 1 + X/2
        nominal: a further factor on a parameter of the controller's model, e.g. mass:70%
        model: what the controller believes before mismatch and factors: a file NAME.toml, or an
            arm that comes with octarm; an arm of more modules is controlled in as many groups as
            it has modules; the true arm when not given
        parameter: a parameter of the true arm and, without --model, of the model, e.g.
            mass:300g,250g,200g, or input_range:-12,12 for the lowest and highest force of the
            columns [N]
        plant_modules: modules of the true arm, a multiple of the model's: a chain of the same rod,
            of which the controller knows groups; the model's modules when not given
        layout: of such a chain: paper, or centred with hinges in the middle of elements
        sensing: what is read of it: groups for sums over groups of modules, or plates for arcs
            between the plates that end them
    """

    mismatch: Annotated[float, kinds.MISMATCH, kinds.MODEL] = 0.0
    nominal: Annotated[tuple[str, ...], kinds.kind("NAME:FACTOR"), kinds.MODEL] = ()
    model: Annotated[str | None, kinds.ARM, kinds.MODEL] = None
    parameter: Annotated[tuple[str, ...], kinds.kind("NAME:VALUES"), kinds.MODEL] = ()
    plant_modules: Annotated[int | None, kinds.COUNT, kinds.MODEL] = None
    layout: Annotated[str, kinds.LAYOUT, kinds.MODEL] = "paper"
    sensing: Annotated[str, kinds.SENSING, kinds.MODEL] = "groups"

    def factors(self) -> Mapping[str, Any]:
        """The further factors of the controller's model, by parameter; raises OctarmError."""
        return _parameters("--nominal", self.nominal)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class OneArm:
    """An arm, before what is changed of it.

    Attributes:
        arm: the true arm and the controller's model of it: a file NAME.toml, or an arm that comes
            with octarm, see octarm arm --help; the nominal arm when not given
    """

    arm: Annotated[str | None, kinds.ARM, kinds.MODEL] = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class ArmOptions(ModelOptions, OneArm):
    """The arm, and what the controller believes of it; `arm` is the first of the options."""

    def true_arm(self) -> ArmParameters:
        """The arm; raises OctarmError if there is no such one, or no such parameter."""
        values = _parameters("--parameter", self.parameter)
        if self.arm is not None:
            from octarm.arm.file import read_arm

            arm = read_arm(self.arm)
        else:
            from octarm.arm.mjcf import nominal_parameters  # imports MuJoCo

            arm = nominal_parameters()
        try:
            return dataclasses.replace(arm, **values)
        except OctarmError:
            import numpy as np

            given = np.size(values.get("mass", arm.mass))
            if given != arm.modules:  # all others would be blamed for the number of modules
                raise OctarmError(
                    f"mass has {given} values; the other parameters need one for each of "
                    f"{arm.modules} modules, or as many new values"
                ) from None
            raise

    def both(self) -> tuple[ArmParameters, ArmParameters]:
        """The arm, and the controller's model of it; raises OctarmError if one cannot be."""
        from octarm.arm.file import read_arm

        factors, true = self.factors(), self.true_arm()
        believed = true if self.model is None else read_arm(self.model)
        return true, believed.mismatched(self.mismatch).scaled(**factors)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class GainOptions:
    """The gains of the controller.

    Attributes:
        gains: those to start from, scaled by the controller's model: tuned, recommended (set by
            hand), or a file NAME.toml of octarm tune; tuned ones, in octarm tune recommended
            ones, when not given
        gain: one gain in SI or with its unit, e.g. lambda:15/s or K:1.6,1.0,0.8,0.4,0.25,0.03 in
            the order of q
        roll_off: corner of a roll-off of the force that the controller asks for [Hz]
    """

    gains: Annotated[str | None, kinds.GAINS, kinds.GAIN] = None
    gain: Annotated[tuple[str, ...], kinds.kind("NAME:VALUES"), kinds.GAIN] = ()
    roll_off: Annotated[float | None, kinds.HZ, kinds.GAIN] = None

    def values(self, *controllers: str) -> Mapping[str, Any]:
        """The gains that are given one by one, by name: numbers [SI] and texts with a unit.

        Raises OctarmError if one does not read so, or one of the controllers does not have it.
        """
        from controllers import gains_in_si

        gains = _named_values("--gain", self.gain)
        for item, value in zip(self.gain, gains.values(), strict=True):
            if isinstance(value, list) and isinstance(value[0], list):
                raise OctarmError(
                    f"--gain is {quoted(item)}; a gain is one number, or one a coordinate"
                )
        for controller in controllers:
            gains_in_si(controller, gains)
        return gains if self.roll_off is None else {**gains, "roll_off": self.roll_off}


FACTOR = Range("1", plausible=20.0)


def spelt(options: Any, *without: str) -> list[str]:
    """The words of a command line that give the options of a table which are not as usual.

    Those of tables within it are among them, and options `without` are not.
    """
    words: list[str] = []
    for field in dataclasses.fields(options):
        value: Any = getattr(options, field.name)
        option = f"--{field.name.replace('_', '-')}"
        if dataclasses.is_dataclass(value):
            words += spelt(value, *without)
        elif value != field.default and field.name not in without:
            several: Any = value if field.default == () else (value,)
            words += [option if each is True else f"{option}={each}" for each in several]
    return words


def _parameters(option: str, items: Sequence[str]) -> dict[str, Any]:
    """Values by parameter of an arm; raises OctarmError for an unknown one."""
    from octarm.arm.parameters import PARAMETERS

    values = _named_values(option, items)
    for name, value in values.items():
        if name not in PARAMETERS:
            raise OctarmError(f"unknown parameter {quoted(name)}{closest(name, PARAMETERS)}")
        kind = PARAMETERS[name] if option == "--parameter" else FACTOR
        values[name] = _converted(f"{name} of {option}", value, kind)
    return values


def _converted(name: str, value: Any, kind: Range) -> Any:
    """Texts as numbers, and lists of them."""
    if isinstance(value, str):
        return kind.parse(name, value)
    sizes = [x for x in value if isinstance(x, str) and x.strip("-+ ") not in ("0", "inf")]
    if kind.unit != "1" and len({*map(is_bare, sizes)}) > 1:
        raise OctarmError(
            f"{name} is {quoted(','.join(value))}; each number needs its unit, or none"
        )
    return [_converted(name, x, kind) for x in value]


def _named_values(option: str, items: Sequence[str]) -> dict[str, Any]:
    """Each NAME:VALUES as a text, texts with `,` between them, or rows with `;` between them."""
    values: dict[str, Any] = {}
    for item in items:
        name, _, text = item.partition(":")
        if name in values:
            raise OctarmError(f"{option} gives {name} twice")
        rows = [row.split(",") for row in text.split(";")]
        alike = all(len(row) == len(rows[0]) for row in rows)
        if not alike or not all(map(is_like_a_number, (x for row in rows for x in row))):
            raise OctarmError(
                f"{option} is {quoted(item)}; it must read NAME:NUMBER, NAME:A,B,C or NAME:A,B;C,D"
            )
        row = rows if len(rows) > 1 else rows[0]
        values[name] = row[0] if len(rows[0]) == len(rows) == 1 else row
    return values
