"""Running a sweep: shards to workers, tables to files, whatever happens in between."""

from __future__ import annotations

import collections
import contextlib
import time
from collections.abc import Callable, Collection
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from octarm.arm.mjcf import nominal_parameters
from octarm.errors import OctarmError
from octarm.interfaces import ControllerFactory, Instant
from octarm.runs import folder as runs
from octarm.simulation.environment import whole_periods
from octarm.sweeps.plan import Plan
from octarm.sweeps.progress import Note, Notes
from octarm.sweeps.shards import begin, run_arms, run_shard
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.store import PROGRESS, SweepFolder, shard_bytes
from octarm.sweeps.workers import WorkerProcesses, cores

_TRIES = 4  # of a shard whose worker dies
_GLANCE = 1.0  # [s]; after so long it looks how far the shards are, and at the number of workers
_MENDABLE = (OctarmError, OSError, MemoryError, BrokenExecutor, CancelledError)  # others are bugs
_FAILURES = 3  # shards that may fail before no new one is begun
_MEASURED, _WARM = 60, 10  # control periods that an estimate runs, and those of them not counted


def _ignore(_: object) -> None:
    """For callers who do not listen."""


def sweep(
    spec: SweepSpec,
    factory: ControllerFactory,
    out: str | Path,
    *,
    executor: Executor | None = None,
    in_flight: int | Callable[[], int] | None = None,
    resume: bool = False,
    progress: Callable[[int], object] = _ignore,
    partial: Callable[[float], object] = _ignore,
    say: Callable[[str], object] = _ignore,
) -> Path:
    """Runs the episodes of a sweep that are not there yet; `read_sweep` gives the table.

    The table depends on the spec alone, `wall_time` aside: not on the executor, the number of
    workers, nor on how often the sweep was interrupted.

    Args:
        spec: see `octarm.sweeps.spec_file.read_spec`.
        factory: makes a controller from its name, the nominal model and gains, and the gain set if
            the spec names one, as `controllers.make_controller` does; other processes have to be
            able to import it.
        out: folder of the sweep.
        executor: that runs the shards; processes on all cores when not given.
        in_flight: number of shards that it is given at a time; one a core when not given.
        resume: whether a sweep that was begun in the folder goes on.
        progress: called with the number of episodes that have just been finished, first with that
            of those that were already there.
        partial: called about once a second with how many episodes the finished parts of those at
            work are worth.
        say: called with sentences on what happens meanwhile.

    Returns:
        The folder.

    Raises:
        OctarmError: for a spec that cannot be run, or a folder that holds something else.
        OSError: if the folder cannot be written; what was finished is kept.
        RuntimeError: if shards failed; the others are kept.
        KeyboardInterrupt: if interrupted, when the shards at work are finished; at once if
            interrupted again. It says what is there.
    """
    plan = Plan(spec)
    folder = SweepFolder(Path(out), plan)
    folder.check(resume=resume)
    gains = rehearse(plan, factory)
    with folder.locked():
        for change in folder.begin(gains):
            say(change)
        done = set(folder.finished())
        progress(sum(len(plan.shards[i]) for i in done))
        todo = [i for i in range(len(plan.shards)) if i not in done]
        # Processes are started one by one, when there is a call for them.
        pool = executor or WorkerProcesses(max(1, min(cores(), len(todo))))
        owned = contextlib.nullcontext() if executor else pool
        with owned, Notes(folder.path / PROGRESS) as notes:

            def submit(shard: int) -> Future[pa.Table]:
                notes.forget(shard)
                return pool.submit(_run_noted, spec, shard, factory, notes.file(shard))

            def keep(shard: int, table: pa.Table) -> None:
                folder.write(shard, table)
                notes.forget(shard)
                progress(len(plan.shards[shard]))

            def glance(shards: Collection[int]) -> None:
                partial(sum(notes.share(i) * len(plan.shards[i]) for i in shards))

            run = _Run(todo, submit, keep, glance, say)
            run.go(in_flight if callable(in_flight) else in_flight or cores())
    run.report()
    return folder.path


def _run_noted(spec: SweepSpec, shard: int, factory: ControllerFactory, note: Path) -> pa.Table:
    """`run_shard`, with a note on how far it is."""
    return run_shard(spec, shard, factory, Note(note, spec.duration))


class _Run:
    """The shards of a sweep on their way."""

    def __init__(
        self,
        todo: list[int],
        submit: Callable[[int], Future[pa.Table]],
        keep: Callable[[int, pa.Table], None],
        glance: Callable[[Collection[int]], None],
        say: Callable[[str], object],
    ) -> None:
        self._pending = collections.deque(todo)
        self._submit, self._keep, self._glance, self._say = submit, keep, glance, say
        self._at_work: dict[Future[pa.Table], int] = {}
        self._tries = collections.Counter[int]()
        self._failed: dict[int, BaseException] = {}
        self._interrupted = False

    def go(self, limit: int | Callable[[], int]) -> None:
        """Runs them, so many at a time."""
        while self._at_work or (self._pending and not self._stopping):
            try:
                self._begin((limit() if callable(limit) else limit) - len(self._at_work))
                for future in wait(self._at_work, _GLANCE, FIRST_COMPLETED).done:
                    self._take(self._at_work[future], future)
                    del self._at_work[future]
                future = None  # a cluster keeps the result for as long as anybody might ask for it
                self._glance(self._at_work.values())
            except KeyboardInterrupt:
                if self._interrupted:
                    raise KeyboardInterrupt(self._left()) from None
                self._interrupted = True
                n = len(self._at_work)
                self._say(f"finishing the {n} shards that are at work; Ctrl-C again stops at once")

    def report(self) -> None:
        """Raises the error that the run ended with, if it did."""
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
        left = len(self._pending) + len(self._at_work) + len(self._failed)
        return f"shards left to do: {left}, the others are kept; --resume goes on"

    def _begin(self, most: int) -> None:
        """Submits shards, if the run goes on."""
        while most > 0 and self._pending and not self._stopping:
            self._at_work[self._submit(self._pending[0])] = self._pending[0]
            self._pending.popleft()
            most -= 1

    def _take(self, shard: int, future: Future[pa.Table]) -> None:
        """Keeps a finished shard, or has it run again."""
        try:
            table = future.result()
        except (BrokenExecutor, CancelledError) as error:
            self._tries[shard] += 1
            if self._tries[shard] < _TRIES:
                self._say(f"a worker died; shard {shard} is run again")
                self._pending.append(shard)
            else:
                self._failed[shard] = error
        except Exception as error:
            self._failed[shard] = error
        else:
            self._keep(shard, table)


def rehearse(plan: Plan, factory: ControllerFactory) -> dict[str, object]:
    """Runs a control period of every controller with every value of every axis.

    Returns:
        The gains of each controller for the nominal arm, ready for JSON.

    Raises:
        OctarmError: if something cannot be made as the spec has it.
    """
    nominal = nominal_parameters()
    gains: dict[str, object] = {
        name: runs.gains_of(plan.spec.controller(name, nominal, factory))
        for name in plan.spec.controllers
    }
    for episodes in plan.probes():
        arms = plan.arms(episodes)
        environment, _ = begin(plan.spec, arms, factory)
        run_arms(plan, arms, factory, duration=environment.control_timestep())
    return gains


class Forecast(NamedTuple):
    """What a sweep will take.

    Attributes:
        episodes: their number.
        periods: number of control periods of an episode.
        shards: their number.
        seconds: that one worker needs [s].
        size: of the table on disk, at most [byte].
    """

    episodes: int
    periods: int
    shards: int
    seconds: float
    size: int


def estimate(spec: SweepSpec, factory: ControllerFactory) -> Forecast:
    """Measures a few control periods of a shard of each controller; writes nothing.

    Raises:
        OctarmError: for a spec that cannot be run.
    """
    plan = Plan(spec)
    rehearse(plan, factory)
    names = [plan.arms(shard[:1]).controller for shard in plan.shards]
    costs = {name: _cost(plan, plan.shards[names.index(name)], factory) for name in names}
    pairs = [(costs[name], len(shard)) for name, shard in zip(names, plan.shards, strict=True)]
    return Forecast(
        episodes=plan.episodes,
        periods=costs[names[0]].periods,
        shards=len(plan.shards),
        seconds=sum(cost.start + cost.arm * n for cost, n in pairs),
        size=int(sum(cost.empty + cost.row * n for cost, n in pairs)),
    )


class _Cost(NamedTuple):
    """What a shard takes."""

    periods: int  # control periods of an episode
    start: float  # before and after the control periods [s]
    arm: float  # the control periods of an arm [s]
    empty: int  # the file without rows [byte]
    row: float  # each of its rows, if every metric had a value [byte]


def _cost(plan: Plan, shard: range, factory: ControllerFactory) -> _Cost:
    """Measures the first control periods of a shard."""
    arms, instants = plan.arms(shard), list[float]()
    period = begin(plan.spec, arms, factory)[0].control_timestep()
    periods = whole_periods(plan.spec.duration, period)

    def clock(_: Instant) -> None:
        instants.append(time.perf_counter())

    started = time.perf_counter()
    table = run_arms(plan, arms, factory, clock, duration=min(_MEASURED, periods) * period)
    elapsed = time.perf_counter() - started
    warm = instants[min(_WARM, len(instants) - 1) :]
    rate = (warm[-1] - warm[0]) / max(1, len(warm) - 1)
    return _Cost(
        periods=periods,
        start=max(0.0, elapsed - len(instants) * rate),
        arm=rate * periods / len(shard),
        empty=len(shard_bytes(table.slice(0, 0))),
        row=table.nbytes / len(shard),
    )
