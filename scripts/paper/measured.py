"""All episodes of all studies in one table, and the medians that claims rest on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from octarm.arm.mjcf import coordinate_names, nominal_parameters
from octarm.reports.statistics import Interval, medians
from octarm.sweeps.store import read_sweep
from octarm.sweeps.tune_cost import BEND_SCALE, SLIDE_SCALE, root_mean_square, weight
from paper.studies import BENDS, SLIDES, TIME, Part

# What a part has in all its episodes where it does not vary it.
NEUTRAL = {
    "noise": 0.0,
    "noise.time": TIME,
    "payload": 0.0,
    "actuation-delay": 0.0,
    "loss": 0.0,
}
MOVING = {BENDS: ("theta1", "theta2"), SLIDES: ("s1", "s2")}  # what each reading moves
_METRICS = ("rms_error", "overshoot", "chattering")


class Cell(NamedTuple):
    """Episodes that differ in their seed alone.

    Attributes:
        label: of the variant.
        study: that they belong to.
        reference: name.
        mismatch: of the nominal model [1].
        noise: its rms over the input's amplitude [1].
        time: its correlation time [s].
        payload: [kg].
        delay: of actuation [s].
        loss: of actuation [1].
    """

    label: str
    study: str = "tracking"
    reference: str = BENDS
    mismatch: float = 0.0
    noise: float = 0.0
    time: float = TIME
    payload: float = 0.0
    delay: float = 0.0
    loss: float = 0.0

    def values(self) -> tuple[object, ...]:
        """In the order of the table's key."""
        return tuple(self)


class Measured:
    """The table.

    Quantities, each an array with a number an episode:

    - `rms_error_s1` and so on, `overshoot_s1` and so on: metrics, see `octarm.metrics`;
    - `error` = sqrt(mean_j (rms_j / A_j)^2), A = 0.0175 m and 0.3 rad: the error of all
      coordinates as a share of the motion, as tuning has it [1];
    - `chattering` = sqrt(mean_j (chattering_j / W_j)^2), chattering of Q above 50 Hz, W = the arm's
      weight for slides and times its width for bends: as a share of the weight [1].

    An episode that diverged has infinite values.
    """

    def __init__(self, cells: dict[Cell, np.ndarray], columns: dict[str, np.ndarray]) -> None:
        """Rows of each cell, and the columns."""
        self._rows, self._columns = cells, columns

    def has(self, cell: Cell) -> bool:
        """Whether there are such episodes."""
        return cell in self._rows

    def cells(self) -> list[Cell]:
        """All cells."""
        return list(self._rows)

    def values(self, cell: Cell, quantity: str) -> np.ndarray:
        """A quantity of the episodes of a cell in the order of their seeds, shape (seeds,).

        Raises:
            KeyError: if there are no such episodes.
        """
        return self._columns[quantity][self._rows[cell]]

    def diverged(self, cell: Cell) -> tuple[int, int]:
        """How many episodes of a cell diverged, and how many there are."""
        rows = self._rows[cell]
        return int(self._columns["diverged"][rows].sum()), len(rows)

    def median(self, cell: Cell, quantity: str) -> Interval:
        """Median over seeds and its 95 % interval."""
        return interval(self.values(cell, quantity))

    def ratio(self, cell: Cell, other: Cell, quantity: str) -> Interval:
        """Median over seeds of a quantity over that of another cell, seed by seed."""
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = self.values(cell, quantity) / self.values(other, quantity)
        return interval(shares)


def interval(values: np.ndarray) -> Interval:
    """Median of numbers with one seed each, shape (seeds,).

    The interval has no width where they are all the same.
    """
    seeds = np.arange(len(values))
    if np.all(values == values[0]):  # nothing random acts
        return Interval(float(values[0]), float(values[0]), float(values[0]))
    return Interval(*(float(x[0]) for x in medians(values[:, None], seeds)))


def measure(parts: Iterable[Part], folder: Path) -> Measured:
    """Reads the sweeps of parts.

    Raises:
        ValueError: if one is not there.
    """
    tables = [(part, read_sweep(folder / part.name)) for part in parts]
    keys: list[Cell] = []
    seeds: list[int] = []
    for part, table in tables:
        keys += _cells(part, table)
        seeds += table["seed"].to_pylist()
    columns = _columns([table for _, table in tables])
    rows: dict[Cell, list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    number = np.array(seeds)
    return Measured({k: _by_seed(np.array(own), number) for k, own in rows.items()}, columns)


def _by_seed(rows: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    return rows[np.argsort(seeds[rows], kind="stable")]


def _cells(part: Part, table: pa.Table) -> list[Cell]:
    count, names = table.num_rows, table.column_names

    def column(name: str) -> list[float]:
        return table[name].to_pylist() if name in names else [NEUTRAL[name]] * count

    controllers = table["controller"].to_pylist()
    return [
        Cell(part.labels[controller], part.study, *values)
        for controller, *values in zip(
            controllers,
            table["reference"].to_pylist(),
            table["mismatch"].to_pylist(),
            *(column(name) for name in NEUTRAL),
            strict=True,
        )
    ]


def _columns(tables: list[pa.Table]) -> dict[str, np.ndarray]:
    names = coordinate_names(nominal_parameters().modules)
    columns = {
        f"{metric}_{name}": np.concatenate([_numbers(t, f"{metric}_{name}") for t in tables])
        for metric in _METRICS
        for name in names
    }
    lost = np.concatenate([np.array(t["status"].to_pylist()) == "diverged" for t in tables])
    columns = {name: np.where(lost, np.inf, values) for name, values in columns.items()}
    true = nominal_parameters()
    scale = np.repeat([SLIDE_SCALE, BEND_SCALE], true.modules)
    heavy = weight(true) * np.repeat([1.0, float(true.width)], true.modules)

    def together(metric: str, by: np.ndarray) -> np.ndarray:
        stacked = np.stack([columns[f"{metric}_{name}"] for name in names], axis=-1)
        return root_mean_square(stacked / by)

    return {
        **columns,
        "error": together("rms_error", scale),
        "chattering": together("chattering", heavy),
        "diverged": lost,
    }


def _numbers(table: pa.Table, name: str) -> np.ndarray:
    return table[name].to_numpy()


Quantity = Callable[[Cell], Interval]
