"""Running all studies: several sweeps and series at a time on one set of processes, resumable."""

from __future__ import annotations

import contextlib
import functools
import json
import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from tqdm import tqdm

from octarm.files import write_text
from octarm.sweeps.execute import sweep
from octarm.sweeps.workers import WorkerProcesses, cores
from paper import series, shown, stability
from paper.effort import Effort
from paper.studies import Part, parts
from paper.variants import Cast, Factory

SWEEPS, SERIES, STABILITY, RUNS = "sweeps", "series", "stability", "runs"  # folders

Job = tuple[float, Callable[[], object]]  # what it simulates [s], and what does it


def run_all(cast: Cast, effort: Effort, factory: Factory, out: Path, workers: int = 0) -> None:
    """Runs what is not there yet.

    What is there does not depend on the number of processes, or on how often it was interrupted.

    Args:
        cast: who runs.
        effort: how much.
        factory: `controllers.make_controller`; other processes have to be able to import it.
        out: folder.
        workers: number of processes; one a core when 0.

    Raises:
        ValueError: if the folder holds results of other studies.
        OSError: if it cannot be written.
        KeyboardInterrupt: if interrupted; what was finished is kept.
    """
    for folder in (SWEEPS, SERIES, STABILITY, RUNS):
        (out / folder).mkdir(parents=True, exist_ok=True)
    sweeps, runs = parts(cast, effort), series.requests(cast, effort)
    trials, singles = stability.requests(cast, effort), list(shown.requests(cast, effort))
    everything = (*sweeps, *runs, *trials, *singles)
    total = sum(job.seconds for job in everything)
    count = workers or cores()
    with (
        tqdm(total=total, unit=" simulated s", unit_scale=True, disable=None, leave=False) as bar,
        WorkerProcesses(count) as processes,
    ):
        pool = _Pool(processes)
        jobs = [
            *((p.seconds, functools.partial(_sweep, p, factory, out, pool, bar)) for p in sweeps),
            *((r.seconds, functools.partial(_series, r, factory, out, pool, bar)) for r in runs),
            *((t.seconds, functools.partial(_trial, t, factory, out, pool, bar)) for t in trials),
            *((s.seconds, functools.partial(_single, s, factory, out, pool, bar)) for s in singles),
        ]
        _together(sorted(jobs, key=lambda job: -job[0]), count + 1, pool)


class _Pool(Executor):
    """Processes that several threads may give work to, until it is stopped."""

    def __init__(self, processes: WorkerProcesses) -> None:
        self._processes, self._lock, self._stopped = processes, threading.Lock(), False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        with self._lock:
            if self._stopped:
                raise RuntimeError("the processes were stopped")
            return self._processes.submit(fn, *args, **kwargs)

    def stop(self) -> None:
        """Ends the processes at once."""
        with self._lock:
            self._stopped = True
            self._processes.kill()


def _together(jobs: list[Job], threads: int, pool: _Pool) -> None:
    """Does jobs, some at a time; the first error, or an interrupt, ends them all."""
    waiting: queue.SimpleQueue[Job] = queue.SimpleQueue()
    for job in jobs:
        waiting.put(job)
    errors: list[BaseException] = []

    def work() -> None:
        while not errors:
            try:
                _, do = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                do()
            except BaseException as error:
                errors.append(error)

    workers = [threading.Thread(target=work, daemon=True) for _ in range(threads)]
    for worker in workers:
        worker.start()
    try:
        while any(worker.is_alive() for worker in workers) and not errors:
            for worker in workers:
                worker.join(0.2)
    except KeyboardInterrupt as interrupt:
        errors.append(interrupt)
    if errors:
        pool.stop()
        for worker in workers:
            worker.join(10.0)
        raise errors[0]


def _sweep(part: Part, factory: Factory, out: Path, pool: Executor, bar: tqdm[Any]) -> None:
    sweep(
        part.spec,
        factory,
        out / SWEEPS / part.name,
        executor=pool,
        in_flight=2,
        resume=True,
        progress=lambda episodes: _advance(bar, episodes * part.spec.duration),
    )


def _series(
    request: series.Request, factory: Factory, out: Path, pool: Executor, bar: tqdm[Any]
) -> None:
    path = series_file(out, request.name)
    if not path.is_file():
        series.write(pool.submit(series.run, request, factory).result(), path)
    _advance(bar, request.seconds)


def _trial(
    request: stability.Request, factory: Factory, out: Path, pool: Executor, bar: tqdm[Any]
) -> None:
    path = stability_file(out, request)
    if not path.is_file():
        outcomes = pool.submit(stability.run, request, factory).result()
        write_text(path, json.dumps([outcome._asdict() for outcome in outcomes], indent=1) + "\n")
    _advance(bar, request.seconds)


def _single(
    request: shown.Shown, factory: Factory, out: Path, pool: Executor, bar: tqdm[Any]
) -> None:
    pool.submit(shown.record, request, factory, out / RUNS / request.name).result()
    _advance(bar, request.seconds)


def series_file(out: Path, name: str) -> Path:
    """Where a series stands."""
    return out / SERIES / f"{name}.npz"


def stability_file(out: Path, request: stability.Request) -> Path:
    """Where the outcomes of a stability request stand."""
    name = request.variant.label.replace(", ", "-")
    return out / STABILITY / f"{name}-{request.rate:g}-Hz.json"


def outcomes(cast: Cast, effort: Effort, out: Path) -> Iterator[stability.Outcome]:
    """All outcomes of stability requests."""
    for request in stability.requests(cast, effort):
        with contextlib.closing(open(stability_file(out, request), encoding="utf-8")) as file:
            for row in json.load(file):
                yield stability.Outcome(**row)


_BAR = threading.Lock()


def _advance(bar: tqdm[Any], seconds: float) -> None:
    with _BAR:
        bar.update(seconds)
