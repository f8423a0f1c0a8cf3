"""Options that several commands share, declared once.

A command takes one of these tables as a parameter; its fields are options like the others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from octarm.commands import kinds

if TYPE_CHECKING:
    from octarm.arm.parameters import ArmParameters


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """What is changed of an arm, and what the controller believes of it.

    Attributes:
        mismatch: error of the controller's model: mass, inertia and damping times 1 + X,
            stiffness times 1 + X/2
        nominal: a further factor on a parameter of the controller's model, e.g. mass:0.7
        parameter: a parameter of the true arm and of the model, e.g. mass:0.3,0.25,0.2 [kg], or
            input_range:-12,12 for the lowest and highest force of the columns [N]
        plant_modules: modules of the true arm, a multiple of the model's: a chain of the same rod,
            of which the controller knows groups; the model's modules when not given
        layout: of such a chain: paper, or centred with hinges in the middle of elements
        sensing: what is read of it: groups for sums over groups of modules, or plates for arcs
            between the plates that end them
    """

    mismatch: Annotated[float, kinds.X, kinds.MODEL] = 0.0
    nominal: Annotated[tuple[str, ...], kinds.text("NAME:FACTOR"), kinds.MODEL] = ()
    parameter: Annotated[tuple[str, ...], kinds.text("NAME:VALUES"), kinds.MODEL] = ()
    plant_modules: Annotated[int | None, kinds.COUNT, kinds.MODEL] = None
    layout: Annotated[str, kinds.LAYOUT, kinds.MODEL] = "paper"
    sensing: Annotated[str, kinds.SENSING, kinds.MODEL] = "groups"

    def of(self, arm: str | None) -> ArmOptions:
        """The same options of an arm."""
        return ArmOptions(arm=arm, **vars(self))

    def factors(self) -> Mapping[str, Any]:
        """The further factors of the controller's model, by parameter; raises OctarmError."""
        from octarm.commands import words

        return words.parameter_values("--nominal", self.nominal)


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
        from octarm.commands import words

        return words.true_arm(self.parameter, self.arm)

    def both(self) -> tuple[ArmParameters, ArmParameters]:
        """The arm, and the controller's model of it; raises OctarmError if one cannot be."""
        factors, true = self.factors(), self.true_arm()
        return true, true.mismatched(self.mismatch).scaled(**factors)

    def command(self) -> list[str]:
        """The words of a command line that give the same options."""
        return _spelt(self)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class GainOptions:
    """The gains of the controller.

    Attributes:
        gains: those to start from, scaled by the controller's model: tuned, recommended (set by
            hand), or a file NAME.toml of octarm tune; tuned ones, in octarm tune recommended
            ones, when not given
        gain: one gain in SI, e.g. lambda:15 or K:1.6,1.0,0.8,0.4,0.25,0.03 in the order of q
        roll_off: corner of a roll-off of the force that the controller asks for [Hz]
    """

    gains: Annotated[str | None, kinds.GAINS, kinds.GAIN] = None
    gain: Annotated[tuple[str, ...], kinds.text("NAME:VALUES"), kinds.GAIN] = ()
    roll_off: Annotated[float | None, kinds.HZ, kinds.GAIN] = None

    def values(self) -> Mapping[str, Any]:
        """The gains that are given one by one, by name [SI]; raises OctarmError."""
        from octarm.commands import words

        corner = {} if self.roll_off is None else {"roll_off": self.roll_off}
        return words.gain_values(self.gain) | corner

    def command(self) -> list[str]:
        """The words of a command line that give the same options."""
        return _spelt(self)


ANY_MODEL, NOMINAL_ARM, USUAL_GAINS = ModelOptions(), ArmOptions(), GainOptions()


def _spelt(options: ArmOptions | GainOptions) -> list[str]:
    """The options that are not as usual, a word each."""
    spelt: list[str] = []
    for field in dataclasses.fields(options):
        value: Any = getattr(options, field.name)
        if value != field.default:
            option = f"--{field.name.replace('_', '-')}"
            spelt += [f"{option}={x}" for x in (value if field.default == () else (value,))]
    return spelt
