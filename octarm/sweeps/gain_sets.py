"""The gains of a sweep's controllers: which set, and what differs from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.errors import closest
from octarm.interfaces import Controller
from octarm.sweeps.spec import SweepSpec
from octarm.toml_table import Source, Table, floats, is_number, items, shown

SETS = ("tuned", "recommended")


class Gains(NamedTuple):
    """What a spec says of gains.

    Attributes:
        sets: one of `SETS`, by controller.
        gains: where they are not those of the set, by controller; those of files among them.
        alone: whether no file was read.
    """

    sets: dict[str, str]
    gains: dict[str, dict[str, Any]]
    alone: bool


def parse_gains(top: Table, controllers: Sequence[str], folder: Path) -> Gains:
    """The keys `gain_set` and `gains` of a spec.

    Args:
        top: the spec.
        controllers: names of those that it runs.
        folder: where files are looked for.

    Raises:
        ValueError: for what is no set of gains; the sentence names the line.
    """
    sets: dict[str, str] = {}
    gains: dict[str, dict[str, Any]] = {}
    alone = True
    if isinstance(top.take("gain_set"), dict):
        table = top.table("gain_set")
        keys = {name: name for name in table.data}
    else:
        table = top
        keys = dict.fromkeys(controllers if "gain_set" in top.data else (), "gain_set")
    for name, key in keys.items():
        _check_known(name, controllers, table, key)
        own = table.data[key]
        if isinstance(own, str) and own.endswith(".toml"):
            try:
                text = (folder / own).read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                reason = getattr(error, "strerror", None) or "it is not text"
                raise table.error(f"{folder / own} cannot be read: {reason}", key) from None
            sets[name], alone = "recommended", False
            gains[name] = _of_file(Source(text, str(folder / own)), name)
        elif own in SETS:
            sets[name] = own
        else:
            known = ", ".join(SETS)
            raise table.error(f"unknown {key} {shown(own)}; known are {known}, or NAME.toml", key)
    given = top.table("gains")
    for name in given.data:
        _check_known(name, controllers, given, name)
        gains[name] = {**gains.get(name, {}), **_numbers(given.table(name))}
    return Gains(sets, gains, alone)


@dataclasses.dataclass(frozen=True)
class OfSets:
    """A factory of controllers that starts from the gain sets of a spec.

    Attributes:
        factory: that takes a keyword `gain_set`, as `controllers.make_controller` does.
        sets: of the spec.
    """

    factory: Any
    sets: Mapping[str, str]

    def __call__(self, name: str, nominal: ArmParameters, gains: Mapping[str, Any]) -> Controller:
        """The controller of this name."""
        if name not in self.sets:
            return self.factory(name, nominal, gains)
        return self.factory(name, nominal, gains, gain_set=self.sets[name])


def of_sets(factory: Any, spec: SweepSpec) -> Any:
    """The factory that a spec asks for: the given one, or one that starts from its gain sets."""
    return OfSets(factory, spec.gain_sets) if spec.gain_sets else factory


def _check_known(name: str, controllers: Sequence[str], table: Table, key: str) -> None:
    if name not in controllers:
        raise table.error(
            f"gains of {name!r}, which is no controller of this sweep{closest(name, controllers)}",
            key,
        )


def _of_file(source: Source, controller: str) -> dict[str, Any]:
    """The gains in a file of `octarm tune`."""
    table = source.table()
    whose, modules = table.take("controller"), table.take("modules")
    if whose != controller:
        raise table.error(f"holds gains of {shown(whose)}, not of {controller}", "controller")
    if modules != nominal_parameters().modules:
        raise table.error(
            f"is for an arm of {shown(modules)} modules; this one has "
            f"{nominal_parameters().modules}",
            "modules",
        )
    return _numbers(table.table("gains"))


def _numbers(table: Table) -> dict[str, Any]:
    """The gains in a table."""
    for gain, value in table.data.items():
        numbers = items(value)
        if not (numbers if numbers is not None else is_number(value)) or not all(
            map(is_number, numbers or ())
        ):
            raise table.error(
                f"{gain} is {shown(value)}; a gain is one number, or one a coordinate", gain
            )
    return {gain: floats(value) for gain, value in table.data.items()}
