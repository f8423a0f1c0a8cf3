"""Running a sweep: shards to workers, tables to files, whatever happens in between."""

from __future__ import annotations

import collections
import contextlib
import time
from collections.abc import Callable, Collection, Generator
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
from octarm.runs import folder as runs
from octarm.simulation.environment import whole_periods
from octarm.sweeps.gain_sets import of_sets
from octarm.sweeps.plan import Plan
from octarm.sweeps.shard_file import shard_bytes
from octarm.sweeps.shards import Factory, begin, run_arms
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.store import SweepFolder
from octarm.sweeps.under_way import run_noted_shard, watched
from octarm.sweeps.workers import WorkerProcesses, cores

_TRIES = 4  # of a shard whose worker dies
_GLANCE = 1.0  # [s]; after so long it looks how far the shards are, and at the number of workers
_MENDABLE = (OctarmError, OSError, MemoryError, BrokenExecutor, CancelledError)  # others are bugs
_FAILURES = 3  # shards that may fail before no new one is begun
_MEASURED, _WARM = 60, 10  # control periods that an estimate runs, and those of them not counted


def _unheard(_: object) -> None:
    """For those who do not listen."""


def sweep(
    spec: SweepSpec,
    factory: Factory,
    out: str | Path,
    *,
    executor: Executor | None = None,
    in_flight: int | Callable[[], int] | None = None,
    resume: bool = False,
    progress: Callable[[int], object] = _unheard,
    under_way: Callable[[float], object] = _unheard,
    say: Callable[[str], object] = _unheard,
) -> Path:
    """Runs the episodes of a sweep that are not there yet; `read_sweep` gives the table.

    The table depends on the spec alone, `wall_time` aside: not on the executor, the number of
    workers, nor on how often the sweep was interrupted.

    Args:
        spec: see `octarm.sweeps.parser.read_spec`.
        factory: makes a controller from its name, the nominal model and gains, and the gain set if
            the spec names one, as `controllers.make_controller` does; other processes have to be
            able to import it.
        out: folder of the sweep.
        executor: that runs the shards; processes on all cores when not given.
        in_flight: number of shards that it is given at a time; one a core when not given.
        resume: whether a sweep that was begun in the folder goes on.
        progress: called with the number of episodes that have just been finished, first with that
            of those that were already there.
        under_way: called about once a second with how many episodes the finished parts of those
            under way are worth.
        say: called with sentences on what happens meanwhile.

    Returns:
        The folder.

    Raises:
        ValueError: for a spec that cannot be run, or a folder that holds something else.
        OSError: if the folder cannot be written; what was finished is kept.
        RuntimeError: if shards failed; the others are kept.
        KeyboardInterrupt: if interrupted, when the shards under way are finished; at once if
            interrupted again. It says what is there.
    """
    plan = Plan(spec)
    folder = SweepFolder(Path(out), plan)
    folder.check(resume=resume)
    factory = of_sets(factory, spec)
    gains = rehearse(plan, factory)
    with folder.locked():
        for change in folder.begin(gains):
            say(change)
        done = set(folder.finished())
        progress(sum(len(plan.shards[i]) for i in done))
        todo = [i for i in range(len(plan.shards)) if i not in done]
        with _executor(executor, len(todo)) as pool, folder.notes() as notes:

            def submit(shard: int) -> Future[pa.Table]:
                return pool.submit(run_noted_shard, spec, shard, factory, notes.file(shard))

            def keep(shard: int, table: pa.Table) -> None:
                folder.write(shard, table)
                notes.forget(shard)
                progress(len(plan.shards[shard]))

            def glance(shards: Collection[int]) -> None:
                under_way(sum(notes.share(i) * len(plan.shards[i]) for i in shards))

            limit = in_flight if callable(in_flight) else lambda: in_flight or cores()
            run = _Run(todo, submit, keep, glance, say)
            run.go(limit)
    run.report()
    return folder.path


def rehearse(plan: Plan, factory: Factory) -> dict[str, object]:
    """Runs a control period of every controller with every value of every axis.

    Returns:
        The gains of each controller for the nominal arm, ready for JSON.

    Raises:
        ValueError: if something cannot be made as the spec has it.
    """
    gains: dict[str, object] = {}
    for name in plan.spec.controllers:
        own = plan.spec.gains.get(name, {})
        gains[name] = runs.gains_of(factory(name, nominal_parameters(), own))
    for episodes in plan.probes():
        arms = plan.arms(episodes)
        environment, _ = begin(plan.spec, arms, factory)
        run_arms(plan, arms, factory, environment.control_timestep())
    return gains


class Estimate(NamedTuple):
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


def estimate(spec: SweepSpec, factory: Factory) -> Estimate:
    """Measures a few control periods of a shard of each controller; writes nothing.

    Raises:
        ValueError: for a spec that cannot be run.
    """
    plan = Plan(spec)
    factory = of_sets(factory, spec)
    rehearse(plan, factory)
    cost: dict[str, _Cost] = {}
    for shard in plan.shards:
        arms = plan.arms(shard)
        if arms.controller not in cost:
            cost[arms.controller] = _Cost.measured(plan, shard, factory)
    seconds = size = 0.0
    for shard in plan.shards:
        own = cost[plan.arms(shard[:1]).controller]
        seconds += own.start + own.period * own.periods * len(shard)
        size += own.labels + own.row * len(shard)
    periods = next(iter(cost.values())).periods
    return Estimate(plan.episodes, periods, len(plan.shards), seconds, int(size))


class _Cost(NamedTuple):
    """What a shard takes.

    Attributes:
        start: before and after the control periods [s].
        period: each of an arm's control periods [s].
        periods: their number.
        labels: the file without rows [byte].
        row: each of its rows, if every measure had a value [byte].
    """

    start: float
    period: float
    periods: int
    labels: int
    row: float

    @classmethod
    def measured(cls, plan: Plan, shard: range, factory: Factory) -> _Cost:
        arms = plan.arms(shard)
        period = begin(plan.spec, arms, factory)[0].control_timestep()
        periods = whole_periods(plan.spec.duration, period)
        instants: list[float] = []

        def tell(_: float) -> None:
            instants.append(time.perf_counter())

        started = time.perf_counter()
        table = run_arms(plan, arms, watched(factory, tell), min(_MEASURED, periods) * period)
        elapsed = time.perf_counter() - started
        few = min(_WARM, len(instants) - 1)
        rate = (instants[-1] - instants[few]) / max(1, len(instants) - 1 - few)
        return cls(
            start=max(0.0, elapsed - len(instants) * rate),
            period=rate / len(shard),
            periods=periods,
            labels=len(shard_bytes(table.slice(0, 0))),
            row=table.nbytes / len(shard),
        )


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
        self._under_way: dict[Future[pa.Table], int] = {}
        self._tries = collections.Counter[int]()
        self._failed: dict[int, BaseException] = {}
        self._interrupted = False

    def go(self, limit: Callable[[], int]) -> None:
        """Runs them, so many at a time."""
        while self._under_way or (self._pending and not self._stopping):
            try:
                self._begin(limit() - len(self._under_way))
                for future in wait(self._under_way, _GLANCE, FIRST_COMPLETED).done:
                    self._take(self._under_way[future], future)
                    del self._under_way[future]
                future = None  # a cluster keeps the result for as long as anybody might ask for it
                self._glance(self._under_way.values())
            except KeyboardInterrupt:
                if self._interrupted:
                    raise KeyboardInterrupt(self._there()) from None
                self._interrupted = True
                n = len(self._under_way)
                self._say(
                    f"finishing the {n} shards that are under way; Ctrl-C again stops at once"
                )

    def report(self) -> None:
        """Raises the error that the run ended with, if it did."""
        if self._interrupted:
            raise KeyboardInterrupt(self._there())
        if self._failed:
            shard, error = next(iter(self._failed.items()))
            failure = OctarmError if isinstance(error, _MENDABLE) else RuntimeError
            raise failure(f"shard {shard} failed: {_told(error)}; {self._there()}") from error

    @property
    def _stopping(self) -> bool:
        return self._interrupted or len(self._failed) > _FAILURES

    def _there(self) -> str:
        left = len(self._pending) + len(self._under_way) + len(self._failed)
        return f"shards left to do: {left}, the others are kept; --resume goes on"

    def _begin(self, most: int) -> None:
        """Submits shards, if the run goes on."""
        while most > 0 and self._pending and not self._stopping:
            self._under_way[self._submit(self._pending[0])] = self._pending[0]
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


@contextlib.contextmanager
def _executor(given: Executor | None, shards: int) -> Generator[Executor]:
    """The executor that was given, or processes that live as long as the block."""
    if given is not None:
        yield given
        return
    with WorkerProcesses(max(1, min(cores(), shards))) as pool:
        yield pool


def _told(error: BaseException) -> str:
    if isinstance(error, BrokenExecutor | CancelledError):
        return f"its worker died {_TRIES} times"
    return " ".join(str(error).split()) or type(error).__name__
