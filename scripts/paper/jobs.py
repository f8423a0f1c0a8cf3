"""Running all that is missing: several sweeps and runs at a time on one set of processes."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

import octarm
from controllers import make_controller
from octarm.files import write_files
from octarm.sweeps.workers import WorkerProcesses, cores
from paper import runs
from paper.periods import Search, searches
from paper.plants import Planted, planted
from paper.runs import Request
from paper.studies import MODELS, Effort, Sweep, sweeps
from paper.variants import CONTROLLERS, Variant

SPECS, SWEEPS, SERIES, RUNS = "specs", "sweeps", "series", "runs"  # folders
Task = Request | Planted | Search  # whose arrays are kept in a file of its name
Advance = Callable[[float], None]  # takes simulated seconds that are done


class Job(NamedTuple):
    """Something to be done."""

    seconds: float  # what it simulates [s]
    # does what is not there yet, on processes, and says how it goes on
    do: Callable[[Executor, Advance], None]


def run_all(variants: Mapping[str, Variant], effort: Effort, out: Path, workers: int = 0) -> None:
    """Runs what is not there yet.

    What is there does not depend on the number of processes, or on how often it was interrupted.

    Args:
        variants: by label.
        effort: how much.
        out: folder.
        workers: number of processes; one a core when 0.

    Raises:
        OctarmError: if the folder holds results of other studies.
        OSError: if it cannot be written.
        KeyboardInterrupt: if interrupted; what was finished is kept.
    """
    for folder in (SPECS, SWEEPS, SERIES, RUNS):
        (out / folder).mkdir(parents=True, exist_ok=True)
    requests = list(runs.requests(variants, effort))
    figure_1 = [
        r
        for r in requests
        if r.seeds and r.quiet and effort.long and r.variant.label in CONTROLLERS
    ]
    jobs = [
        *(_sweep_job(sweep, out) for sweep in sweeps(variants, effort)),
        *(_run_job(request, out) for request in requests),
        *(_run_job(one, out) for one in planted(variants, effort)),
        *(_run_job(one, out) for one in searches(variants, effort)),
        *(_recording_job(r, model, out) for r in figure_1 for model in MODELS),
    ]
    jobs.sort(key=lambda job: -job.seconds)
    lock = threading.Lock()
    with (
        tqdm(
            total=sum(job.seconds for job in jobs), unit=" simulated s", unit_scale=True,
            disable=None, leave=False,
        ) as bar,
        WorkerProcesses(workers or cores()) as processes,
    ):  # fmt: skip

        def advance(seconds: float) -> None:
            with lock:
                bar.update(seconds)

        with ThreadPoolExecutor((workers or cores()) + 1) as threads:
            futures = [threads.submit(job.do, processes, advance) for job in jobs]
            try:
                for future in as_completed(futures):
                    future.result()
            except BaseException:  # an interrupt, too
                threads.shutdown(wait=False, cancel_futures=True)
                processes.kill()
                raise


def _sweep_job(sweep: Sweep, out: Path) -> Job:
    def do(pool: Executor, advance: Advance) -> None:
        file = out / SPECS / f"{sweep.name}.toml"
        write_files({file: sweep.text().encode()})
        duration = sweep.content["duration"]
        octarm.sweep(
            octarm.read_spec(file),
            make_controller,
            out / SWEEPS / sweep.name,
            executor=pool,
            in_flight=2,
            resume=True,
            progress=lambda episodes: advance(episodes * duration),
        )

    return Job(sweep.seconds, do)


def _run_job(request: Task, out: Path) -> Job:
    def do(pool: Executor, advance: Advance) -> None:
        if not series_file(out, request).is_file():
            content = io.BytesIO()
            np.savez(content, allow_pickle=False, **pool.submit(request.perform).result())
            write_files({series_file(out, request): content.getvalue()})
        advance(request.seconds)

    return Job(request.seconds, do)


def _recording_job(request: Request, model: float, out: Path) -> Job:
    folder = out / RUNS / f"{request.name}-{100 * model:+.0f}"
    seconds = 8.0 * request.duration  # weighed by what an arm costs by itself

    def do(pool: Executor, advance: Advance) -> None:
        if not (folder / "run.rrd").is_file() or not (folder / "run.npz").is_file():
            pool.submit(runs.record, request, model, folder).result()
        advance(seconds)

    return Job(seconds, do)


def series_file(out: Path, request: Task) -> Path:
    """Where what was kept of a run stands."""
    return out / SERIES / f"{request.name}.npz"


def read_arrays(out: Path, requests: Iterable[Task]) -> dict[str, dict[str, np.ndarray]]:
    """What was kept of runs, by their names.

    Raises:
        OSError: if one is missing.
    """
    arrays: dict[str, dict[str, np.ndarray]] = {}
    for request in requests:
        with np.load(series_file(out, request), allow_pickle=False) as file:
            arrays[request.name] = dict(file)
    return arrays
