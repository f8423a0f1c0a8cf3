"""All that claims, tables and figures take their numbers from."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from octarm import read_sweep
from octarm.arm.mjcf import coordinate_names, nominal_parameters
from octarm.reports.statistics import Interval, medians
from octarm.sweeps.tune_cost import BEND_SCALE, SLIDE_SCALE, root_mean_square, weight
from paper.lyapunov import Outcome, lyapunov_requests
from paper.runs import SWEEPS, Cost, Series, series_requests
from paper.studies import BENDS, MODELS, PROPOSED, TIME, Cast, Effort, Part

# What a part has in all its episodes where it does not vary it.
NEUTRAL = {"noise": 0.0, "noise.time": TIME, "payload": 0.0, "actuation-delay": 0.0, "loss": 0.0}
_METRICS = ("rms_error", "overshoot", "chattering")
NAMES = tuple(coordinate_names(nominal_parameters().modules))  # of the coordinates


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

    def models(self) -> list[Cell]:
        """The same with each of the three nominal models."""
        return [self._replace(mismatch=model) for model in MODELS]

    def over(self, label: str) -> tuple[Cell, Cell]:
        """The cell, and the same of another variant."""
        return self, self._replace(label=label)


class Measured:
    """All episodes of all studies, and medians over their seeds.

    Quantities, each an array with a number an episode:

    - `rms_error_s1` and so on, `overshoot_s1` and so on: metrics, see `octarm.metrics`;
    - `error` = sqrt(mean_j (rms_j / A_j)^2), A = 0.0175 m and 0.3 rad: the error of all
      coordinates as a share of the motion, as tuning has it [1];
    - `chattering` = sqrt(mean_j (chattering_j / W_j)^2), chattering of Q above 50 Hz, W = the arm's
      weight for slides and times its width for bends: as a share of the weight [1].

    An episode that diverged has infinite values.
    """

    def __init__(self, cells: dict[Cell, np.ndarray], columns: dict[str, np.ndarray]) -> None:
        """Rows of each cell in the order of their seeds, and the columns."""
        self._rows, self._columns = cells, columns

    @classmethod
    def read(cls, parts: Iterable[Part], folder: Path) -> Measured:
        """The sweeps of parts.

        Raises:
            OctarmError: if one is not there.
        """
        tables = [(part, read_sweep(folder / part.name)) for part in parts]
        cells = [cell for part, table in tables for cell in _cells(part, table)]
        seeds = np.concatenate([table["seed"].to_numpy() for _, table in tables])
        rows: dict[Cell, list[int]] = {}
        for row in np.argsort(seeds, kind="stable").tolist():
            rows.setdefault(cells[row], []).append(row)
        in_order = {cell: np.array(rows[cell]) for cell in dict.fromkeys(cells)}
        return cls(in_order, _columns([table for _, table in tables]))

    def has(self, *cells: Cell) -> bool:
        """Whether there are episodes of all these cells."""
        return all(cell in self._rows for cell in cells)

    def cells(self) -> list[Cell]:
        """All cells."""
        return list(self._rows)

    def values(self, cell: Cell, quantity: str) -> np.ndarray:
        """A quantity of the episodes of a cell in the order of their seeds, shape (seeds,).

        Raises:
            KeyError: if there are no such episodes.
        """
        return self._columns[quantity][self._rows[cell]]

    def diverged(self, *cells: Cell) -> str:
        """How many episodes of some cells diverged, of how many: "3 of 64"."""
        lost = np.concatenate([self.values(cell, "diverged") for cell in cells])
        return f"{lost.sum()} of {len(lost)}"

    def median(self, cell: Cell, quantity: str, factor: float = 1.0) -> Interval:
        """Median over seeds and its 95 % interval, times a factor."""
        return scaled(interval(self.values(cell, quantity)), factor)

    def percent(self, cell: Cell, quantity: str = "error") -> Interval:
        """Error [% of the motion], or chattering [% of the weight], of a cell."""
        return self.median(cell, quantity, 100.0)

    def ratio(self, cell: Cell, other: Cell, quantity: str = "error") -> Interval:
        """Median over seeds of a quantity over that of another cell, seed by seed."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return interval(self.values(cell, quantity) / self.values(other, quantity))

    def over_proposed(self, cell: Cell, quantity: str = "error") -> Interval:
        """A quantity over that of the proposed controller, seed by seed."""
        return self.ratio(*cell.over(PROPOSED), quantity)

    def mean_error(self, label: str, noise: float) -> np.ndarray:
        """Error of a variant, mean over the nominal models, shape (seeds,) [1]."""
        cells = Cell(label, noise=noise).models()
        return np.mean([self.values(cell, "error") for cell in cells], axis=0)


def interval(values: np.ndarray) -> Interval:
    """Median of numbers with one seed each, shape (seeds,).

    The interval has no width where they are all the same.
    """
    seeds = np.arange(len(values))
    if np.all(values == values[0]):  # nothing random acts
        return Interval(float(values[0]), float(values[0]), float(values[0]))
    return Interval(*(float(x[0]) for x in medians(values[:, None], seeds)))


def scaled(value: Interval, factor: float) -> Interval:
    """An interval times a factor."""
    return Interval(*(factor * float(x) for x in value))


def _cells(part: Part, table: pa.Table) -> list[Cell]:
    """The cell of each row of a sweep."""

    def column(name: str) -> list[float]:
        if name in table.column_names:
            return table[name].to_pylist()
        return [NEUTRAL[name]] * table.num_rows

    names = ("controller", "reference", "mismatch", *NEUTRAL)
    return [
        Cell(part.labels[controller], part.study, *values)
        for controller, *values in zip(*map(column, names), strict=True)
    ]


def _columns(tables: Sequence[pa.Table]) -> dict[str, np.ndarray]:
    joined = pa.concat_tables(
        table.select(["status", *(f"{metric}_{name}" for metric in _METRICS for name in NAMES)])
        for table in tables
    )
    lost = np.array(joined["status"].to_pylist()) == "diverged"
    columns = {
        name: np.where(lost, np.inf, joined[name].to_numpy()) for name in joined.column_names[1:]
    }
    true = nominal_parameters()
    motion = np.repeat([SLIDE_SCALE, BEND_SCALE], true.modules)
    heavy = weight(true) * np.repeat([1.0, float(true.width)], true.modules)

    def together(metric: str, by: np.ndarray) -> np.ndarray:
        return root_mean_square(
            np.stack([columns[f"{metric}_{name}"] for name in NAMES], axis=-1) / by
        )

    error, chattering = together("rms_error", motion), together("chattering", heavy)
    return {**columns, "error": error, "chattering": chattering, "diverged": lost}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What was run and measured.

    Attributes:
        variants: all that may have run, by label.
        effort: how much.
        measured: all episodes.
        series: runs over time, by name.
        outcomes: how Lyapunov functions went.
        costs: of a step, by label.
    """

    variants: Cast
    effort: Effort
    measured: Measured
    series: Mapping[str, Series]
    outcomes: Sequence[Outcome]
    costs: Mapping[str, Cost]

    @classmethod
    def gather(cls, variants: Cast, effort: Effort, out: Path, costs: Sequence[Cost]) -> Evidence:
        """What `paper.runs.run_all` left in a folder.

        Raises:
            OctarmError: if something is missing.
        """
        series = series_requests(variants, effort)
        stability = lyapunov_requests(variants, effort)
        return cls(
            variants=variants,
            effort=effort,
            measured=Measured.read(effort.parts(variants), out / SWEEPS),
            series={request.name: Series.read(request.file(out)) for request in series},
            outcomes=[outcome for request in stability for outcome in request.read(out)],
            costs={cost.label: cost for cost in costs},
        )
