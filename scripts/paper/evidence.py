"""The one table of measured cells, and all else that claims, tables and figures rest on."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

import octarm
from octarm.reports.statistics import Interval, medians
from paper import jobs, lyapunov
from paper.plants import Planted, Search
from paper.runs import Cost, Request, Series
from paper.studies import BENDS, MODELS, NOISE, SCALE, TIME, Effort, Sweep, study_of_plants, sweeps
from paper.variants import Variant

# What an episode has where its sweep does not say it, in the order of the fields of `Cell`.
NEUTRAL = {"noise": 0.0, "noise.time": TIME, "payload": 0.0, "actuation-delay": 0.0, "loss": 0.0}
_METRICS = ("rms_error", "overshoot", "chattering")


class Cell(NamedTuple):
    """Episodes that differ in their seed alone."""

    label: str  # of the variant
    study: str = "tracking"  # that they belong to
    reference: str = BENDS  # name
    mismatch: float = 0.0  # of the nominal model [1]
    noise: float = 0.0  # its rms over the input's amplitude [1]
    time: float = TIME  # its correlation time [s]
    payload: float = 0.0  # [kg]
    delay: float = 0.0  # of actuation [s]
    loss: float = 0.0  # of actuation [1]
    plant: int = 3  # number of modules of the arm that is controlled

    def models(self) -> list[Cell]:
        """The same with each nominal model of the paper's figures."""
        return [self._replace(mismatch=model) for model in MODELS]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What was run and measured.

    Quantities of an episode are the metrics `rms_error_s1`, `overshoot_theta1` and so on, and

    - `error` = sqrt(mean_j (rms_j / A_j)^2), A = 0.0175 m and 0.3 rad: the error of all
      coordinates as a share of the motion, as tuning has it [1];
    - `chattering` = sqrt(mean_j (chattering_j / W_j)^2), chattering of Q above 50 Hz, W = the arm's
      weight for slides and times its width for bends: as a share of the weight [1].

    They are infinite for an episode that diverged.
    """

    variants: Mapping[str, Variant]  # who ran, by label
    effort: Effort  # how much was run
    rows: Mapping[Cell, np.ndarray]  # of the episodes of each cell, in the order of their seeds
    columns: Mapping[str, np.ndarray]  # quantities, and `diverged`, with an entry an episode
    series: Mapping[str, Series]  # runs over time, by name
    outcomes: Sequence[lyapunov.Outcome]  # how Lyapunov functions went
    periods: Mapping[str, Mapping[str, np.ndarray]]  # by label; see `paper.plants.Search`
    costs: Mapping[str, Cost]  # of a controller's step, by name

    def has(self, *cells: Cell) -> bool:
        """Whether all these cells were run."""
        return all(cell in self.rows for cell in cells)

    def known(self, cells: Sequence[Cell]) -> list[Cell]:
        """Those of the cells that were run."""
        return [cell for cell in cells if cell in self.rows]

    def values(self, cell: Cell, quantity: str) -> np.ndarray:
        """A quantity of the episodes of a cell in the order of their seeds, shape (seeds,)."""
        return self.columns[quantity][self.rows[cell]]

    def diverged(self, *cells: Cell) -> tuple[int, int]:
        """How many episodes of cells diverged, and how many there are."""
        lost = [self.values(cell, "diverged") for cell in cells]
        return sum(int(x.sum()) for x in lost), sum(map(len, lost))

    def median(self, cell: Cell, quantity: str, factor: float = 1.0) -> Interval:
        """Median over seeds of a quantity, times a factor, and its 95 % interval."""
        return Interval(*(factor * x for x in interval(self.values(cell, quantity))))

    def error(self, cell: Cell) -> Interval:
        """Error of a cell [% of the motion]."""
        return self.median(cell, "error", 100.0)

    def chattering(self, cell: Cell) -> Interval:
        """Chattering of a cell [% of the weight]."""
        return self.median(cell, "chattering", 100.0)

    def mean_error(self, label: str, noise: float) -> Interval:
        """Error of a variant on theta1 and theta2, mean of the models seed by seed [%]."""
        return interval(100.0 * self._over_models(label, noise))

    def over(self, label: str, other: str, noise: float) -> Interval:
        """The error of `mean_error` over that of another variant, seed by seed [1]."""
        return interval(self._over_models(label, noise) / self._over_models(other, noise))

    def ratio(self, cell: Cell, label: str, quantity: str = "error") -> Interval:
        """Median of a quantity over that of another variant in the same place, seed by seed [1].

        Where both arms are lost, neither is better: 1.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = self.values(cell, quantity) / self.values(cell._replace(label=label), quantity)
        return interval(np.where(np.isnan(shares), 1.0, shares))

    def rank(self, cell: Cell, names: Sequence[str]) -> Interval:
        """The rank of a law by its error among laws in the same place, 1 the best; NaN if lost.

        The interval ends where it is better, or worse, than others beyond their own intervals:
        pair by pair, seed by seed.
        """
        own = self.error(cell).value
        if not np.isfinite(own):
            return Interval(np.nan, np.nan, np.nan)
        others = [name for name in names if name != cell.label]
        ratios = [self.ratio(cell, name) for name in others]
        better = sum(self.error(cell._replace(label=name)).value < own for name in others)
        low, high = sum(r.low > 1.0 for r in ratios), sum(not r.high < 1.0 for r in ratios)
        return Interval(1.0 + better, 1.0 + low, 1.0 + high)

    def plants(self) -> Iterator[list[Cell]]:
        """The cells of all laws in each place of the study of plants: plant, period, noise."""
        places = itertools.product(self.effort.plant_rates, (0.0, NOISE), self.effort.plants)
        for rate, noise, modules in places:
            start = Cell("", study_of_plants(rate), noise=noise, plant=modules)
            cells = [start._replace(label=name) for name in self.effort.plant_labels]
            if known := self.known(cells):
                yield known

    def models(self, label: str) -> list[float]:
        """The model errors with which a variant was run on theta1 and theta2 without noise [1]."""
        return sorted(c.mismatch for c in self.rows if c == Cell(label, mismatch=c.mismatch))

    def noises(self) -> list[float]:
        """The strengths of the noise in the study of degradation, rising [1]."""
        return sorted({cell.noise for cell in self.rows if cell.study == "degradation"})

    def ranked(self, names: Sequence[str], noise: float) -> list[str]:
        """Those that were run with this noise, the one with the least error first."""
        known = [name for name in names if self.has(Cell(name, noise=noise))]
        return sorted(known, key=lambda name: self.mean_error(name, noise).value)

    def _over_models(self, label: str, noise: float) -> np.ndarray:
        cells = Cell(label, noise=noise).models()
        return np.mean([self.values(cell, "error") for cell in cells], axis=0)


def interval(values: np.ndarray) -> Interval:
    """Median of numbers with one seed each, shape (seeds,), and its 95 % interval or range.

    The interval has no width where all are the same, since nothing is random there.
    """
    if np.all(values == values[0]):
        return Interval(float(values[0]), float(values[0]), float(values[0]))
    return Interval(*(float(x[0]) for x in medians(values[:, None], np.arange(len(values)))))


def gather(
    variants: Mapping[str, Variant], effort: Effort, out: Path, costs: Mapping[str, Cost]
) -> Evidence:
    """Reads what `paper.jobs.run_all` left in a folder.

    Raises:
        OctarmError: if a sweep is missing.
        OSError: if another file is.
    """
    tasks = {task: jobs.read_arrays(out, task) for task in jobs.all_tasks(variants, effort)}
    plants = {task: kept for task, kept in tasks.items() if isinstance(task, Planted)}
    requests = {task: kept for task, kept in tasks.items() if isinstance(task, Request)}
    rows, columns = with_plants(
        *measured(list(sweeps(variants, effort)), out / jobs.SWEEPS), plants
    )
    return Evidence(
        variants=variants,
        effort=effort,
        rows=rows,
        columns=columns,
        series={one.name: Series(**kept) for one, kept in requests.items() if "q" in kept},
        outcomes=[
            outcome
            for one, kept in requests.items()
            if one.keep is lyapunov.counts
            for outcome in lyapunov.outcomes(one, kept)
        ],
        periods={t.variant.label: kept for t, kept in tasks.items() if isinstance(t, Search)},
        costs=costs,
    )


Columns = dict[str, np.ndarray]


def measured(parts: Sequence[Sweep], folder: Path) -> tuple[dict[Cell, np.ndarray], Columns]:
    """The rows of all cells, and the columns, of sweeps; see `Evidence`.

    Raises:
        OctarmError: if one is not there.
    """
    tables = [octarm.read_sweep(folder / part.name) for part in parts]
    keys = [key for part, table in zip(parts, tables, strict=True) for key in _cells(part, table)]
    seeds = np.concatenate([table["seed"].to_numpy() for table in tables])
    rows: dict[Cell, list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    ordered = {key: np.array(sorted(own, key=lambda row: seeds[row])) for key, own in rows.items()}
    return ordered, _columns(tables)


def with_plants(
    rows: dict[Cell, np.ndarray],
    columns: Columns,
    plants: Mapping[Planted, Mapping[str, np.ndarray]],
) -> tuple[dict[Cell, np.ndarray], Columns]:
    """The same with the runs on plants of more modules, of which errors alone are known."""
    count = len(columns["error"])
    for one in plants:
        cell = Cell(one.variant.label, study_of_plants(one.rate), plant=one.modules)
        rows[cell] = np.array([count])
        rows[cell._replace(noise=NOISE)] = count + 1 + np.arange(one.seeds)
        count += 1 + one.seeds
    own = {
        name: np.concatenate([np.empty(0), *(kept[key] for kept in plants.values())])
        for name, key in (("error", "error"), ("diverged", "lost"))
    }
    nothing = np.full(len(own["error"]), np.nan)
    return rows, {
        name: np.concatenate([column, own.get(name, nothing)]) for name, column in columns.items()
    }


def _cells(part: Sweep, table: pa.Table) -> list[Cell]:
    columns = [
        table[name].to_pylist() if name in table.column_names else [value] * table.num_rows
        for name, value in {"reference": BENDS, "mismatch": 0.0, **NEUTRAL}.items()
    ]
    labels = [part.labels[name] for name in table["controller"].to_pylist()]
    return [
        Cell(label, part.study, *values) for label, *values in zip(labels, *columns, strict=True)
    ]


def _columns(tables: Sequence[pa.Table]) -> dict[str, np.ndarray]:
    def column(name: str) -> np.ndarray:
        return np.concatenate([table[name].to_numpy() for table in tables])

    lost = column("status") == "diverged"
    names = coordinates()
    columns = {
        f"{metric}_{name}": np.where(lost, np.inf, column(f"{metric}_{name}"))
        for metric in _METRICS
        for name in names
    }
    true = octarm.nominal_parameters()
    weight = float(sum(true.mass.tolist())) * float(true.gravity)  # of the arm [N]
    scales = {
        "error": ("rms_error", SCALE),
        "chattering": ("chattering", {"s": weight, "theta": weight * float(true.width[0])}),
    }
    for quantity, (metric, scale) in scales.items():
        shares = [columns[f"{metric}_{name}"] / scale[name.rstrip("123")] for name in names]
        columns[quantity] = np.sqrt(sum(share * share for share in shares) / len(names))
    return {**columns, "diverged": lost}


def coordinates() -> list[str]:
    """Names of the nominal arm's coordinates, in the order of q."""
    modules = range(1, octarm.nominal_parameters().modules + 1)
    return [f"{kind}{i}" for kind in ("s", "theta") for i in modules]
