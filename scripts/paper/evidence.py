"""Runs all that is missing, and reads it: the measured cells, and what else claims rest on."""

import dataclasses
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow as pa
import tomlkit

import octarm
from controllers import make_controller
from octarm.bars import bar
from octarm.files import write_files
from octarm.reports.statistics import Interval, medians
from octarm.sweeps.tune_cost import root_mean_square, weight
from octarm.sweeps.workers import WorkerProcesses, cores
from paper import plants, runs
from paper.claims import Entry
from paper.runs import Cost, Descent, Series, name_of, outcomes
from paper.studies import COORDINATES, MODELS, MODULES, NOISE, SCALE, Cell, Effort, Sweep, sweeps
from paper.variants import ARM, Variant

SPECS, SWEEPS, SERIES, RUNS = "specs", "sweeps", "series", "runs"  # folders
# The fields of a cell that differ within a sweep, by the columns of its table.
FIELDS = {"reference": "reference", "mismatch": "mismatch", "noise": "noise", "noise.time": "time",
          "payload": "payload", "actuation-delay": "delay", "loss": "loss"}  # fmt: skip
Perform = Callable[[], Mapping[str, np.ndarray]]  # makes the arrays of a file


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What was run and measured.

    Quantities of an episode are the metrics `rms_error_theta1` [mm], [mrad], `overshoot_theta1` [%]
    and so on, and

    - `error` = sqrt(mean_j (rms_j / A_j)^2), A = 0.0175 m and 0.3 rad: the error of all
      coordinates as a share of the motion, as tuning has it [%];
    - `chattering` = sqrt(mean_j (chattering_j / W_j)^2), chattering of Q above 50 Hz, W = the arm's
      weight for slides and times its width for bends: as a share of the weight [%].

    They are infinite for an episode that diverged.
    """

    variants: Mapping[str, Variant]  # who ran, by label
    effort: Effort  # how much was run
    # Quantities, and `diverged`, by cell and name, each in the order of its seeds, shape (seeds,).
    cells: Mapping[Cell, Mapping[str, np.ndarray]]
    series: Mapping[str, Series]  # runs over time, by name
    outcomes: Sequence[Descent]  # how Lyapunov functions went
    periods: Mapping[str, Mapping[str, np.ndarray]]  # by label; see `paper.plants.searched`
    costs: Mapping[str, Cost]  # of a controller's step, by name

    def has(self, *cells: Cell) -> bool:
        """Whether all these cells were run."""
        return all(one in self.cells for cell in cells for one in cell.models())

    def known(self, cells: Iterable[Cell]) -> list[Cell]:
        """Those of the cells that were run."""
        return list(filter(self.has, cells))

    def ranked(self, cells: Iterable[Cell]) -> list[Cell]:
        """Those that were run, the one with the least error first."""
        return sorted(self.known(cells), key=lambda cell: self.median(cell).value)

    def varied(self, start: Cell, field: str) -> list[float]:
        """The values of a field that were tried in this place, by any variant, rising."""
        same = {"label": "", field: 0.0}
        alike = [x for x in self.cells if x._replace(**same) == start._replace(**same)]
        return sorted({getattr(cell, field) for cell in alike})

    def diverged(self, *cells: Cell) -> tuple[int, int]:
        """How many episodes of cells diverged, and how many there are."""
        lost = [self.cells[cell]["diverged"] for cell in cells]
        return sum(int(x.sum()) for x in lost), sum(map(len, lost))

    def values(self, cell: Cell, quantity: str = "error") -> np.ndarray:
        """A quantity in the order of its seeds, shape (seeds,)."""
        return np.mean([self.cells[one][quantity] for one in cell.models()], axis=0)

    def median(self, cell: Cell, quantity: str = "error") -> Interval:
        """Median over seeds of a quantity, and its 95 % interval."""
        return interval(self.values(cell, quantity))

    def ratio(self, cell: Cell, label: str, quantity: str = "error") -> Interval:
        """Median of a quantity over that of another variant in the same place, seed by seed [1].

        Where both arms are lost, neither is better: 1.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = self.values(cell, quantity) / self.values(cell._replace(label=label), quantity)
        return interval(np.where(np.isnan(shares), 1.0, shares))

    def rank(self, cell: Cell, cells: Sequence[Cell]) -> Entry:
        """The rank of a law by its error among laws in the same place, 1 the best, or `lost`.

        The interval ends where it is better, or worse, than others beyond their own intervals:
        pair by pair, seed by seed.
        """
        error = self.median(cell).value
        if not np.isfinite(error):
            return "lost"
        ratios = [self.ratio(cell, other.label) for other in cells if other != cell]
        better = sum(self.median(other).value < error for other in cells)
        low, high = sum(r.low > 1.0 for r in ratios), sum(not r.high < 1.0 for r in ratios)
        return Interval(1.0 + better, 1.0 + low, 1.0 + high)

    def plants(self) -> Iterator[list[Cell]]:
        """The cells of all laws, the best first, in each place of the study of plants."""
        effort = self.effort
        for rate, noise, modules in product(effort.plant_rates, (0.0, NOISE), effort.plants):
            start = Cell("", "plants", rate=rate, noise=noise, plant=modules)
            if cells := self.ranked(start.of(effort.plant_labels)):
                yield cells


def interval(values: np.ndarray) -> Interval:
    """Median of numbers with one seed each, shape (seeds,), and its 95 % interval or range.

    The interval has no width where all are the same, since nothing is random there.
    """
    if np.all(values == values[0]):
        return Interval(*[float(values[0])] * 3)
    return Interval(*(float(x[0]) for x in medians(values[:, None], np.arange(len(values)))))


def run_all(variants: Mapping[str, Variant], effort: Effort, out: Path, workers: int = 0) -> None:
    """Runs what is not there yet, on one process a core if the number of workers is 0.

    What is there does not depend on that number, or on how often it was interrupted: what was
    finished is kept. Raises OctarmError if the folder holds results of other studies, and OSError
    if it cannot be written.
    """
    (out / RUNS).mkdir(parents=True, exist_ok=True)
    count = workers or cores()
    with WorkerProcesses(count) as processes, ThreadPoolExecutor(count + 1) as threads:
        jobs = [threads.submit(_sweep, x, out, processes) for x in sweeps(variants, effort)]
        for name, perform in all_tasks(variants, effort).items():
            jobs.append(processes.submit(_keep, out / SERIES / f"{name}.npz", perform))
        for x, model in product(runs.requests(variants, effort), MODELS):
            if effort.long and x.name == name_of(x.variant.controller, x.reference):
                jobs.append(processes.submit(runs.record, x, model, out / RUNS))
        try:
            for job in bar(as_completed(jobs), total=len(jobs), unit=" jobs"):
                job.result()
        except BaseException:  # an interrupt, too
            threads.shutdown(wait=False, cancel_futures=True)
            processes.kill()
            raise


def all_tasks(variants: Mapping[str, Variant], effort: Effort) -> dict[str, Perform]:
    """What makes the arrays of each file of `series`, by its name."""
    tasks: dict[str, Perform] = {x.name: x.perform for x in runs.requests(variants, effort)}
    for label in effort.plant_labels:
        search = partial(plants.searched, variants[label], effort.plants, effort.engine)
        tasks[f"periods-{label}"] = search
    for name, cell in _planted(effort):
        place = variants[cell.label], cell.plant, cell.rate, effort.seeds, effort.engine
        tasks[name] = partial(plants.planted, *place)
    return tasks


def _planted(effort: Effort) -> Iterator[tuple[str, Cell]]:
    """The cells on plants without noise, and the names of their files."""
    for rate, modules in product(effort.plant_rates, effort.plants):
        for cell in Cell("", "plants", plant=modules, rate=rate).of(effort.plant_labels):
            yield f"plant-{modules}-{rate:g}-Hz-{cell.label}", cell


def _sweep(sweep: Sweep, out: Path, pool: Executor) -> None:
    file = out / SPECS / f"{sweep.name}.toml"
    write_files({file: tomlkit.dumps(sweep.content).encode()})
    octarm.sweep(
        octarm.read_spec(file), make_controller, out / SWEEPS / sweep.name,
        executor=pool, in_flight=2, resume=True,
    )  # fmt: skip


def _keep(file: Path, perform: Perform) -> None:
    if not file.is_file():
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **perform())
        write_files({file: content.getvalue()})


def gather(
    variants: Mapping[str, Variant], effort: Effort, out: Path, costs: Mapping[str, Cost]
) -> Evidence:
    """Reads what `run_all` left in a folder.

    Raises OctarmError if a sweep is missing, and OSError if another file is.
    """

    def kept(name: str) -> dict[str, np.ndarray]:
        with np.load(out / SERIES / f"{name}.npz", allow_pickle=False) as file:
            return dict(file)

    cells = measured(list(sweeps(variants, effort)), out / SWEEPS)
    for name, cell in _planted(effort):
        arrays = kept(name)
        error = 100.0 * arrays["error"]
        none = np.full_like(error, np.nan)
        known = {"error": error, "diverged": arrays["lost"], "chattering": none}
        for noise, arms in ((0.0, slice(1)), (NOISE, slice(1, None))):
            cells[cell._replace(noise=noise)] = {name: x[arms] for name, x in known.items()}
    requests = list(runs.requests(variants, effort))
    return Evidence(
        variants=variants, effort=effort, cells=cells, costs=costs,
        series={x.name: Series(**kept(x.name)) for x in requests if x.keep == runs.kept},
        outcomes=[
            one for x in requests if x.keep == runs.counts for one in outcomes(x, kept(x.name))
        ],
        periods={label: kept(f"periods-{label}") for label in effort.plant_labels},
    )  # fmt: skip


def measured(parts: Sequence[Sweep], folder: Path) -> dict[Cell, dict[str, np.ndarray]]:
    """The quantities of all cells of sweeps, see `Evidence`; OctarmError if one is not there."""
    cells: dict[Cell, dict[str, np.ndarray]] = {}
    for part in parts:
        table = octarm.read_sweep(folder / part.name)
        names = [name for name in FIELDS if name in table.column_names]
        rows: dict[Cell, list[int]] = {}  # in the order of their seeds
        for i, row in enumerate(table.select(["controller", *names]).to_pylist()):
            label = part.labels[row.pop("controller")]
            fields = {FIELDS[name]: value for name, value in row.items()}
            cell = Cell(label, part.study, rate=part.rate, **fields)
            rows.setdefault(cell, []).append(i)
        quantities = _quantities(table)
        for cell, places in rows.items():
            cells[cell] = {name: values[places] for name, values in quantities.items()}
    return cells


def _quantities(table: pa.Table) -> dict[str, np.ndarray]:
    """Those of all episodes of a sweep, and whether they diverged."""
    lost = table["status"].to_numpy() == "diverged"

    def columns(metric: str) -> np.ndarray:
        """Of all coordinates, shape (episodes, 2N)."""
        rows = [table[f"{metric}_{name}"].to_numpy() for name in COORDINATES]
        return np.where(lost[:, None], np.inf, np.transpose(rows))

    errors = columns("rms_error")
    each = {"rms_error": 1e3 * errors, "overshoot": columns("overshoot")}
    heavy = weight(ARM) * np.repeat([1.0, float(ARM.width[0])], MODULES)
    return {
        **{f"{metric}_{name}": values[:, j] for metric, values in each.items()
           for j, name in enumerate(COORDINATES)},
        "error": 100.0 * root_mean_square(errors / SCALE),
        "chattering": 100.0 * root_mean_square(columns("chattering") / heavy),
        "diverged": lost,
    }  # fmt: skip
