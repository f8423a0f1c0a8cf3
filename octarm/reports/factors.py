"""What differs between the episodes of a sweep, from its columns and its manifest."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from octarm.errors import printable
from octarm.sweeps.spec import Axis, SweepSpec

LONGEST = 60  # characters of a name in tables and figures
_FEWEST, _MOST_RANGES = 4, 6  # values in a range of a drawn factor, and ranges


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """What differs between episodes, apart from the controller and the seed: an axis of the grid.

    Attributes:
        unit: of its labels and places, % of a share; empty for words.
        levels: in words, as the table of the sweep has them; ranges when its values were drawn.
        labels: the same in its unit.
        places: where its levels stand on an axis, shape (k,); their order when they are words or
            infinite.
        scaled: whether the places are numbers.
        drawn: whether it was drawn for each seed.
        code: the number of the level of each episode, shape (n,).
    """

    name: str
    unit: str
    levels: tuple[str, ...]
    labels: tuple[str, ...]
    places: np.ndarray
    scaled: bool
    drawn: bool
    code: np.ndarray

    @property
    def title(self) -> str:
        """The name with its unit."""
        return self.name + (f" [{self.unit}]" if self.unit else "")


def factors_of(
    held: Mapping[str, np.ndarray], spec: SweepSpec, axes: Sequence[Axis]
) -> list[Factor]:
    """The factors that take more than one value, of some axes, given columns of shape (n,)."""
    factors: list[Factor] = []
    for axis in axes:
        column, title = held[axis.name], printable(axis.name, LONGEST)
        numbers = axis.range(spec.code)
        unit = "" if numbers is None else numbers.unit
        size, unit = (100.0, "%") if unit == "1" else (1.0, unit)
        if axis.method:
            factors += _drawn(title, size, unit, column)
            continue
        values = np.array(axis.values)
        if len(values) < 2:
            continue
        levels = labels = tuple(printable(str(value), LONGEST) for value in values.tolist())
        if not axis.words:
            values = np.sort(values.astype(float))
            levels, labels = (tuple(f"{k * v:g}" for v in values) for k in (1.0, size))
        scaled = not axis.words and bool(np.isfinite(values).all())
        place = size * values if scaled else np.arange(len(values))
        code = places(column, values)
        factors.append(Factor(title, unit, levels, labels, place, scaled, drawn=False, code=code))
    return factors


def _drawn(name: str, size: float, unit: str, column: np.ndarray) -> list[Factor]:
    """A drawn factor, cut into ranges with as many values each; none if there are too few."""
    different = np.unique(column)
    bins = min(len(different) // _FEWEST, _MOST_RANGES)
    if bins < 2:
        return []
    edges = np.quantile(different, np.linspace(0.0, 1.0, bins + 1))
    code = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, bins - 1)
    levels, labels = (
        tuple(f"{k * a:.3g} .. {k * b:.3g}" for a, b in itertools.pairwise(edges))
        for k in (1.0, size)
    )
    middles = size * np.array([np.median(column[code == i]) for i in range(bins)])
    return [Factor(name, unit, levels, labels, middles, scaled=True, drawn=True, code=code)]


def places(column: np.ndarray, values: npt.ArrayLike) -> np.ndarray:
    """The places of a column's entries in a list, shape (n,)."""
    return np.argmax(column[:, None] == np.asarray(values), axis=1)
