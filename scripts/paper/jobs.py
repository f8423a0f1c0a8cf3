"""Running all that is missing: several sweeps and runs at a time on one set of processes."""

import io
import itertools
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

import octarm
from controllers import make_controller
from octarm.files import write_files
from octarm.simulation.engines import LAGRANGE, usual_engine
from octarm.sweeps.workers import WorkerProcesses, cores
from paper import plants, runs
from paper.runs import Request
from paper.studies import MODELS, Cell, Effort, Sweep, sweeps
from paper.variants import CONTROLLERS, Variant

SPECS, SWEEPS, SERIES, RUNS = "specs", "sweeps", "series", "runs"  # folders
Advance = Callable[[float], object]  # takes simulated seconds that are done


class Task(NamedTuple):
    """Something that is run, of which a file of arrays is kept."""

    name: str  # of the file
    seconds: float  # what it simulates, or weighs among other tasks [s]
    perform: Callable[[], Mapping[str, np.ndarray]]
    of: Request | Cell  # what the arrays are measured of


def run_all(variants: Mapping[str, Variant], effort: Effort, out: Path, workers: int = 0) -> None:
    """Runs what is not there yet, on one process a core if the number of workers is 0.

    What is there does not depend on that number, or on how often it was interrupted: what was
    finished is kept. Raises OctarmError if the folder holds results of other studies, and OSError
    if it cannot be written.
    """
    (out / RUNS).mkdir(parents=True, exist_ok=True)
    tasks = all_tasks(variants, effort)
    jobs = [(sweep.seconds, partial(_sweep, sweep, out)) for sweep in sweeps(variants, effort)]
    jobs += [(task.seconds, partial(_keep, task, out)) for task in tasks]
    jobs += [
        (8.0 * one.duration, partial(_record, one, model, out))  # what an arm alone costs
        for one, model in itertools.product([task.of for task in tasks], MODELS)
        if isinstance(one, Request) and one.seeds and one.quiet and effort.long
        if one.variant.label in CONTROLLERS
    ]
    jobs.sort(key=lambda job: -job[0])
    total, count = sum(seconds for seconds, _ in jobs), workers or cores()
    with (
        tqdm(total=total, unit=" simulated s", unit_scale=True, disable=None, leave=False) as bar,
        WorkerProcesses(count) as processes,
        ThreadPoolExecutor(count + 1) as threads,
    ):
        futures = [threads.submit(do, processes, bar.update) for _, do in jobs]
        try:
            for future in as_completed(futures):
                future.result()
        except BaseException:  # an interrupt, too
            threads.shutdown(wait=False, cancel_futures=True)
            processes.kill()
            raise


def all_tasks(variants: Mapping[str, Variant], effort: Effort) -> list[Task]:
    """All that is run besides sweeps; plants where the engine `lagrange` is installed."""
    tasks = [Task(x.name, x.seconds, x.perform, x) for x in runs.requests(variants, effort)]
    if usual_engine() != LAGRANGE:
        return tasks
    for rate, modules in itertools.product(effort.plant_rates, effort.plants):
        # Weighed by what a control period costs for all arms.
        seconds = plants.DURATION * rate / 200.0 * (1.0 + modules / 10.0)
        for label in effort.plant_labels:
            perform = partial(plants.planted, variants[label], modules, rate, effort.seeds)
            cell = Cell(label, "plants", plant=modules, rate=rate)
            tasks.append(Task(f"plant-{modules}-{rate:g}-Hz-{label}", seconds, perform, cell))
    for label in effort.plant_labels:
        perform = partial(plants.searched, variants[label], effort.plants)
        tasks.append(Task(f"periods-{label}", 100.0 * len(effort.plants), perform, Cell(label)))
    return tasks


def _sweep(sweep: Sweep, out: Path, pool: Executor, advance: Advance) -> None:
    file, duration = out / SPECS / f"{sweep.name}.toml", sweep.content["duration"]
    write_files({file: sweep.text().encode()})
    octarm.sweep(
        octarm.read_spec(file), make_controller, out / SWEEPS / sweep.name,
        executor=pool, in_flight=2, resume=True,
        progress=lambda episodes: advance(episodes * duration),
    )  # fmt: skip


def _keep(task: Task, out: Path, pool: Executor, advance: Advance) -> None:
    file, content = out / SERIES / f"{task.name}.npz", io.BytesIO()
    if not file.is_file():
        np.savez(content, allow_pickle=False, **pool.submit(task.perform).result())
        write_files({file: content.getvalue()})
    advance(task.seconds)


def _record(request: Request, model: float, out: Path, pool: Executor, advance: Advance) -> None:
    folder = out / RUNS / f"{request.name}-{100 * model:+.0f}"
    if not (folder / "run.rrd").is_file() or not (folder / "run.npz").is_file():
        pool.submit(runs.record, request, model, folder).result()
    advance(8.0 * request.duration)
