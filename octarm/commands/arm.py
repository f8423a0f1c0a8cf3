"""What `octarm arm` does."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from controllers import CONTROLLERS, make_controller
from octarm.arm.file import Arm, arm_toml, cannot_hang, read_arm_file
from octarm.arm.fit import fit_modules
from octarm.arm.groups import groups_of
from octarm.arm.mjcf import nominal_parameters, physics_step
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.arm.summary import ArmSummary
from octarm.checks.stability import Stability, check_period
from octarm.declared import named
from octarm.errors import ExitCode, OctarmError, closest, printable, quoted
from octarm.files import write_files, write_text

_ROD = [*(field.name for field in dataclasses.fields(Rod)), "modules", "layout"]


@dataclasses.dataclass(frozen=True)
class LoopOptions:
    """Which loops are looked at, as the command line has it."""

    controllers: tuple[str, ...]
    gains: str | None
    roll_off: float | None
    period: float | None
    plant_modules: int | None
    layout: str

    def of(self, p: ArmParameters) -> Stability | None:
        """The loops of an arm; None if no controller is given."""
        if not self.controllers:
            return None
        period = physics_step() if self.period is None else self.period
        check_period(period)
        short, _ = named((CONTROLLERS, word) for word in self.controllers)
        given = {} if self.roll_off is None else {"roll_off": self.roll_off}
        laws = [make_controller(word, p, given, gain_set=self.gains) for word in self.controllers]
        made = dict(zip(short, laws, strict=True))
        finer = self.plant_modules and groups_of(p, self.plant_modules, self.layout)
        return Stability(p, made, period, finer or None)


@dataclasses.dataclass(frozen=True)
class Source:
    """Which arms are meant, as the command line has it."""

    names: Sequence[str]
    rod: str | None
    fitted: int | None
    layout: str

    def arms(self) -> list[Arm]:
        """The arms; of fitted ones it prints what error remains.

        Raises:
            OctarmError: if one of them is none, cannot hang, or cannot be fitted.
        """
        given = self._given()
        return given if self.fitted is None else [self._fit(each, self.fitted) for each in given]

    def _given(self) -> list[Arm]:
        if self.rod is None:
            if not self.names:
                return [Arm(nominal_parameters(), "the nominal arm")]
            return [read_arm_file(name) for name in self.names]
        if self.names:
            raise OctarmError(
                f"--from-rod is given, and so is {quoted(self.names[0])}; one or the other"
            )
        return [_from_rod(self.rod)]

    def _fit(self, given: Arm, modules: int) -> Arm:
        """The arm of fewer modules that stands best for one."""
        fit = fit_modules(given.parameters, modules, self.layout)
        print(
            f"{printable(given.name)}, fitted by {modules} modules, layout {self.layout}\n{fit}\n"
        )
        return Arm(
            fit.parameters,
            f"{modules} modules for {given.name}",
            converted=(f"all numbers fitted to {given.name}, layout {self.layout}",),
        )


def arm(source: Source, loop: LoopOptions, write: Path | None, out: Path | None) -> int:
    """`octarm arm`: prints what arms are; draws and writes one."""
    several = source.arms()
    if (write or out) and len(several) != 1:
        raise OctarmError(f"{len(several)} arms are given; --write and --out take one")
    stable = True
    for each in several:
        summary = ArmSummary.of(each)
        print("\n".join(summary.lines()))
        stability = loop.of(each.parameters)
        if stability is not None:
            print("\n".join(stability.lines))
            stable &= stability.stable
        if write is not None:
            write_text(write, arm_toml(each))
            print(f"wrote {printable(str(write))}")
        if out is not None:
            from octarm.reports.arm_figure import arm_figure  # takes a second to import

            write_files({out: arm_figure(summary).png})
            print(f"wrote {printable(str(out))}")
        if each is not several[-1]:
            print()
    return ExitCode.FINE if stable or loop.period is None else ExitCode.CHECK_FAILED


def _from_rod(text: str) -> Arm:
    """The arm that KEY=VALUE,.. means."""
    given: dict[str, str] = {}
    for item in text.split(","):
        key, equals, value = item.partition("=")
        if key not in _ROD:
            raise OctarmError(f"--from-rod has no key {quoted(key)}{closest(key, _ROD)}")
        if not equals or key in given:
            raise OctarmError(
                f"--from-rod has {quoted(item)}; each key is given once, as KEY=VALUE"
            )
        given[key] = value
    modules, layout = _modules(given.pop("modules", "")), given.pop("layout", "paper")
    fields: dict[str, Any] = {key: _profile(key, value) for key, value in given.items()}
    rod = Rod(**fields)
    p = arm_from_rod(rod, modules, layout)
    if violation := cannot_hang(p):
        raise OctarmError(violation)
    numbers = ", ".join(
        f"{key} = {_spelt(value)}" for key, value in dataclasses.asdict(rod).items()
    )
    return Arm(
        p,
        f"a rod of {modules} modules, layout {layout}",
        converted=(f"columns, masses and inertias from a rod with {numbers} in SI units",),
    )


def _modules(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        what = f"modules {quoted(word)}" if word else "no modules"
        raise OctarmError(f"--from-rod has {what}; it needs modules=N, a whole number") from None


def _profile(key: str, word: str) -> float | tuple[float, ...]:
    try:
        numbers = tuple(map(float, word.split(":")))
    except ValueError:
        raise OctarmError(
            f"--from-rod has {key} {quoted(word)}; it must be a number, or BASE:TIP"
        ) from None
    return numbers[0] if len(numbers) == 1 else numbers


def _spelt(value: Any) -> str:
    return ":".join(f"{x:g}" for x in np.atleast_1d(value))
