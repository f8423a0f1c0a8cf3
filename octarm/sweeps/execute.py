"""Running a sweep: shards to workers, tables to files, whatever happens in between."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import wait as first_of
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from octarm.errors import OctarmError
from octarm.interfaces import ControllerFactory, Instant
from octarm.memory import check_batch
from octarm.simulation.environment import whole_periods
from octarm.sweeps.plan import Plan, with_step
from octarm.sweeps.progress import Note, notes_in
from octarm.sweeps.shards import begin, run_arms, run_shard
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.store import PROGRESS, SweepFolder, shard_bytes
from octarm.sweeps.workers import WorkerProcesses, WorkersError, check_not_beginning, cores

_TRIES = 4  # of a shard whose worker dies
_GLANCE = 1.0  # [s]; after so long it looks how far the shards are, and at the number of workers
# Others are bugs.
_MENDABLE = (
    OctarmError, OSError, MemoryError, ModuleNotFoundError, BrokenExecutor, CancelledError,
)  # fmt: skip
_FAILURES = 3  # shards that may fail before no new one is begun
_MEASURED, _WARM = 60, 10  # control periods that an estimate runs, and those of them not counted


def sweep(
    spec: SweepSpec,
    factory: ControllerFactory,
    out: str | Path,
    *,
    executor: Executor | None = None,
    in_flight: int | Callable[[], int] | None = None,
    resume: bool = False,
    replace: bool = False,
    progress: Callable[[float], object] = lambda episodes: None,
    say: Callable[[str], object] = lambda sentence: None,
) -> Path:
    """Runs the episodes of a sweep that are not there yet; `read_sweep` gives the table.

    The table depends on the spec alone, `wall_time` aside: not on the executor, the number of
    workers, nor on how often the sweep was interrupted.

    Args:
        spec: see `octarm.sweeps.spec_file.read_spec`.
        factory: makes a controller from its name, the nominal model and gains, and the gain set if
            the spec names one; other processes have to be able to import it.
        out: folder of the sweep, which is returned.
        executor: that runs the shards; processes on all cores when not given.
        in_flight: number of shards that it is given at a time, 0 when it has nobody to run them;
            one a core when not given.
        resume: whether a sweep that was begun in the folder goes on.
        replace: whether another sweep in the folder is removed first.
        progress: called with the number of episodes that are finished, first with that of those
            that were already there, then with what finished parts of others are worth added:
            after every shard, and about once a second.
        say: called with sentences on what happens meanwhile.

    Raises:
        OctarmError: for a spec that cannot be run, or a folder that holds something else or cannot
            be written; what was finished is kept.
        RuntimeError: if shards failed; the others are kept.
        KeyboardInterrupt: if interrupted, when the shards at work are finished; at once if
            interrupted again. It says what is there.
    """
    check_not_beginning()
    Plan(spec).check_size()
    spec = with_step(spec)
    plan = Plan(spec)
    folder = SweepFolder(Path(out), plan)
    folder.check(resume=resume, replace=replace)
    with contextlib.ExitStack() as workers:
        if executor is None:
            # Processes are started one by one, when there is a call for them.
            pool = WorkerProcesses(max(1, min(cores(), len(plan.shards))))
            executor = workers.enter_context(pool)
        tried = isinstance(executor, WorkerProcesses) and not resume
        begun = executor.submit(callable, factory) if tried else None
        gains = rehearse(plan, factory)
        # Known before there is a folder, which a script that was mended would find.
        failure = begun.exception() if begun is not None else None
        if isinstance(failure, WorkersError):
            raise failure.with_traceback(None)
        with folder.locked(), workers.pop_all(), notes_in(folder.path / PROGRESS) as notes:
            if replace and not resume:
                folder.clear()
            for change in folder.begin(gains):
                say(change)
            done = folder.finished()
            there = sum(len(plan.shard(i)) for i in done)
            progress(there)
            todo = sorted({*plan.shards} - {*done})
            run = _Run(plan, factory, folder, notes, executor, progress, say, todo, there)
            run.go(in_flight if callable(in_flight) else lambda: in_flight or cores())
    run.report()
    return folder.path


@dataclasses.dataclass(eq=False)
class _Run:
    """The shards of a sweep on their way."""

    plan: Plan
    factory: ControllerFactory
    folder: SweepFolder
    notes: Path
    pool: Executor
    progress: Callable[[float], object]
    say: Callable[[str], object]
    pending: list[int]
    finished: int  # episodes

    def __post_init__(self) -> None:
        self._at_work: dict[Future[pa.Table], int] = {}
        self._tries = collections.Counter[int]()
        self._failed: dict[int, BaseException] = {}
        self._interrupted = False

    def go(self, limit: Callable[[], int]) -> None:
        useful = 1
        while self._at_work or (self.pending and not self._stopping):
            try:
                useful = self._useful(limit)
                if self._interrupted and not useful:
                    return
                self._begin(max(1, useful))
                for future in first_of(self._at_work, _GLANCE, "FIRST_COMPLETED").done:
                    self._take(self._at_work[future], future)
                    del self._at_work[future]
                    self._tell()
                future = None  # a cluster keeps the result for as long as anybody might ask for it
                self._tell()
            except KeyboardInterrupt:
                if self._interrupted or not useful:
                    raise KeyboardInterrupt(self._left()) from None
                self._interrupted = True
                n = len(self._at_work)
                self.say(f"finishing the {n} shards that are at work; Ctrl-C again stops at once")

    def _useful(self, limit: Callable[[], int]) -> int:
        """How many shards there is use for; says what is left if there never will be."""
        try:
            return limit()
        except OctarmError as error:
            raise OctarmError(f"{error}; {self._left()}") from error

    def _note(self, shard: int) -> Note:
        return Note(self.notes / str(shard), self.plan.spec.duration)

    def _tell(self) -> None:
        parts = (self._note(i).share() * len(self.plan.shard(i)) for i in self._at_work.values())
        self.progress(self.finished + sum(parts))

    def report(self) -> None:
        if self._interrupted:
            raise KeyboardInterrupt(self._left())
        if self._failed:
            shard, error = next(iter(self._failed.items()))
            reason = " ".join(str(error).split()) or type(error).__name__
            if isinstance(error, BrokenExecutor | CancelledError):
                reason = f"its worker died {_TRIES} times"
            failure = OctarmError if isinstance(error, _MENDABLE) else RuntimeError
            raise failure(f"shard {shard} failed: {reason}; {self._left()}") from error

    @property
    def _stopping(self) -> bool:
        return self._interrupted or len(self._failed) > _FAILURES

    def _left(self) -> str:
        left = len(self.pending) + len(self._at_work) + len(self._failed)
        return f"shards left to do: {left}, the others are kept; --resume goes on"

    def _begin(self, limit: int) -> None:
        while len(self._at_work) < limit and self.pending and not self._stopping:
            shard = self.pending[0]
            note = self._note(shard)
            note.file.unlink(missing_ok=True)
            future = self.pool.submit(run_shard, self.plan.spec, shard, self.factory, note)
            self._at_work[future] = shard
            del self.pending[0]

    def _take(self, shard: int, future: Future[pa.Table]) -> None:
        try:
            table = future.result()
        except (BrokenExecutor, CancelledError) as error:
            self._tries[shard] += 1
            if self._tries[shard] < _TRIES:
                if isinstance(error, BrokenExecutor):  # or a cluster is lost, as it says itself
                    self.say(f"a worker died; shard {shard} is run again")
                self.pending.append(shard)
            else:
                self._failed[shard] = error
        except WorkersError:
            raise
        except Exception as error:
            self._failed[shard] = error
        else:
            self.folder.write(shard, table)
            self._note(shard).file.unlink(missing_ok=True)
            self.finished += len(self.plan.shard(shard))


def rehearse(plan: Plan, factory: ControllerFactory) -> dict[str, Any]:
    """Runs a control period of every controller with every value of every axis.

    It returns the gains of each controller for the first arm, ready for JSON.
    """
    # No shard is larger by more than one arm.
    check_batch(len(plan.shard(0)), plan.spec.most_modules)
    gains = {name: plan.spec.stated_gains(name, factory) for name in plan.spec.controllers}
    for episodes in plan.probes():
        arms = plan.arms(episodes)
        environment, _ = begin(plan.spec, arms, factory)
        whole_periods(plan.spec.duration, environment.control_timestep())
        run_arms(plan, arms, factory, duration=environment.control_timestep())
    return gains


class Forecast(NamedTuple):
    """What a sweep will take: seconds of one worker, at most `size` bytes on disk."""

    episodes: int
    shards: int
    seconds: float
    size: int


def estimate(spec: SweepSpec, factory: ControllerFactory) -> Forecast:
    """Measures a few control periods of a shard of each controller; writes nothing."""
    spec = with_step(spec, probes=True)
    plan = Plan(spec)
    rehearse(plan, factory)
    each = len(plan.shards) // len(spec.controllers)  # which are the slowest axis
    parts = [_estimate(plan, i, each, factory) for i in plan.shards[::each]]
    seconds, size = map(sum, zip(*parts, strict=True))
    return Forecast(plan.episodes, len(plan.shards), seconds, size)


def _estimate(plan: Plan, first: int, count: int, factory: ControllerFactory) -> tuple[float, int]:
    """Time [s] and size [byte] of the shards of one controller."""
    arms, instants = plan.arms(plan.shard(first)), list[float]()
    period = begin(plan.spec, arms, factory)[0].control_timestep()
    periods = whole_periods(plan.spec.duration, period)

    def clock(_: Instant) -> None:
        instants.append(time.perf_counter())

    started = time.perf_counter()
    table = run_arms(plan, arms, factory, clock, duration=min(_MEASURED, periods) * period)
    elapsed = time.perf_counter() - started
    warm = instants[min(_WARM, len(instants) - 1) :]
    rate = (warm[-1] - warm[0]) / max(1, len(warm) - 1)
    once = max(0.0, elapsed - len(instants) * rate)  # a shard, before and after its periods
    empty = len(shard_bytes(table.slice(0, 0)))
    more = plan.episodes // len(plan.spec.controllers) / len(arms.seeds)  # times as many arms
    return once * count + rate * periods * more, int(empty * count + table.nbytes * more)
