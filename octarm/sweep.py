"""Running a sweep: shards to workers, tables to files, whatever happens in between."""

from __future__ import annotations

import collections
import contextlib
import time
from collections.abc import Callable, Iterator
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

from octarm import runs
from octarm.environment import whole_periods
from octarm.model import nominal_parameters
from octarm.sweeps.folder import SweepFolder, parquet_bytes
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import Factory, begin, run_arms, run_shard
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.workers import WorkerProcesses, cores

_TRIES = 4  # of a shard whose worker dies
_GLANCE = 5.0  # [s]; after so long it looks whether there are more workers
_FAILURES = 3  # shards that may fail before no new one is begun


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
    say: Callable[[str], object] = _unheard,
) -> Path:
    """Runs the episodes of a sweep that are not there yet; `read_sweep` gives the table.

    The table depends on the spec alone, `wall_time` aside: not on the executor, the number of
    workers, nor on how often the sweep was interrupted.

    Args:
        spec: see `octarm.sweeps.parser.read_spec`.
        factory: makes a controller from its name, the nominal model and gains, as
            `controllers.make_controller` does; other processes have to be able to import it.
        out: folder of the sweep.
        executor: that runs the shards; processes on all cores when not given.
        in_flight: number of shards that it is given at a time; one a core when not given.
        resume: whether a sweep that was begun in the folder goes on.
        progress: called with the number of episodes that have just been finished, first with that
            of those that were already there.
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
    gains = rehearse(plan, factory)
    with folder.locked():
        for change in folder.begin(gains):
            say(change)
        done = set(folder.finished())
        progress(sum(len(plan.shards[i]) for i in done))
        todo = [i for i in range(len(plan.shards)) if i not in done]
        with _executor(executor, len(todo)) as pool:

            def submit(shard: int) -> Future:
                return pool.submit(run_shard, spec, shard, factory)

            def keep(shard: int, table: object) -> None:
                folder.write(shard, table)  # pyright: ignore[reportArgumentType]
                progress(len(plan.shards[shard]))

            limit = in_flight if callable(in_flight) else lambda: in_flight or cores()
            run = _Run(todo, submit, keep, say)
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
    gains = {}
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
        shards: their number.
        seconds: that one worker needs [s].
        size: of the files [byte].
    """

    episodes: int
    shards: int
    seconds: float
    size: int


def estimate(spec: SweepSpec, factory: Factory) -> Estimate:
    """Measures a few control periods of a shard of each controller; writes nothing.

    Raises:
        ValueError: for a spec that cannot be run.
    """
    plan = Plan(spec)
    rehearse(plan, factory)
    cost = {}
    for shard in plan.shards:
        arms = plan.arms(shard)
        if arms.controller not in cost:
            cost[arms.controller] = _Cost.measured(plan, shard, factory)
    seconds = size = 0.0
    for shard in plan.shards:
        own = cost[plan.arms(shard[:1]).controller]
        seconds += own.start + own.run * len(shard)
        size += own.size * len(shard)
    return Estimate(plan.episodes, len(plan.shards), seconds, int(size))


class _Cost(NamedTuple):
    """What a shard takes: seconds to start, seconds and bytes an episode."""

    start: float
    run: float
    size: float

    @classmethod
    def measured(cls, plan: Plan, shard: range, factory: Factory) -> _Cost:
        arms = plan.arms(shard)
        period = begin(plan.spec, arms, factory)[0].control_timestep()
        periods = whole_periods(plan.spec.duration, period)
        few, many = min(3, periods), min(30, periods + 3)
        times = []
        for count in (few, many):
            started = time.perf_counter()
            table = run_arms(plan, arms, factory, count * period)
            times.append(time.perf_counter() - started)
        rate = max(0.0, times[1] - times[0]) / (many - few)
        size = len(parquet_bytes(table)) / len(shard)
        return cls(max(0.0, times[0] - few * rate), rate * periods / len(shard), size)


class _Run:
    """The shards of a sweep on their way."""

    def __init__(
        self,
        todo: list[int],
        submit: Callable[[int], Future],
        keep: Callable[[int, object], None],
        say: Callable[[str], object],
    ) -> None:
        self._pending = collections.deque(todo)
        self._submit, self._keep, self._say = submit, keep, say
        self._under_way: dict[Future, int] = {}
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
            raise RuntimeError(f"shard {shard} failed: {_told(error)}; {self._there()}") from error

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

    def _take(self, shard: int, future: Future) -> None:
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
def _executor(given: Executor | None, shards: int) -> Iterator[Executor]:
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
