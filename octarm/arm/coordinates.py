"""Names and units of an arm's coordinates and inputs, for printing, plotting and recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from octarm.arrays import coordinate_names


class Coordinates(NamedTuple):
    """The coordinates and inputs of an arm.

    Attributes:
        names: one for each coordinate, in the order of q.
        groups: where the coordinates of one kind stand in q, by the name of the group; they share a
            unit and a scale, and are plotted together, group below group.
        units: unit of the coordinates of each group, `m` or `rad`.
        inputs: one name for each input force, in the order of tau.
    """

    names: tuple[str, ...]
    groups: Mapping[str, slice]
    units: Mapping[str, str]
    inputs: tuple[str, ...]

    @property
    def unit_of_each(self) -> tuple[str, ...]:
        """The unit of each coordinate, in the order of q."""
        units = [""] * len(self.names)
        for group, part in self.groups.items():
            units[part] = [self.units[group]] * len(self.names[part])
        return tuple(units)


def planar_coordinates(modules: int) -> Coordinates:
    """Those of the planar arm: q = [s1..sN, theta1..thetaN], and two columns for each module."""
    columns = [f"column_{a}_{i}" for i in range(1, modules + 1) for a in (1, 2)]
    return Coordinates(
        names=tuple(coordinate_names(modules)),
        groups={"bends": slice(modules, 2 * modules), "slides": slice(modules)},
        units={"bends": "rad", "slides": "m"},
        inputs=tuple(columns),
    )
