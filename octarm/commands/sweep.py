"""What `octarm sweep` does."""

from __future__ import annotations

import contextlib
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.compute as pc
from tqdm import tqdm

from controllers import make_controller
from octarm.checks.verify_episode import FinishedSweep
from octarm.errors import ExitCode
from octarm.model import nominal_parameters
from octarm.sweep import estimate
from octarm.sweep import sweep as run_sweep
from octarm.sweeps.chosen import COLUMNS, RECORDED, choose, record_chosen
from octarm.sweeps.folder import SweepFolder, read_sweep
from octarm.sweeps.parser import read_spec
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.workers import WorkerProcesses, cores, dask_cluster
from octarm.toml_table import Source

if TYPE_CHECKING:
    from octarm.cli import Sweep


def sweep(options: Sweep) -> int:
    """`octarm sweep`: runs a spec into a folder, or says what that would take."""
    if options.workers is not None and options.workers < 1:
        raise ValueError(f"workers is {options.workers}; it must be at least 1")
    spec = read_spec(options.spec)
    _check_controllers(spec, options.spec)
    _check_recorded(spec, options.spec)
    if options.dry_run:
        return _dry_run(spec, options.workers or cores())
    if options.out is None:
        raise ValueError("there is no folder to write to; give --out DIR, or --dry-run")
    _run(spec, options, options.out)
    alike = _record(spec, options, options.out)
    _print_summary(options.out)
    print(f"wrote {options.out}/  (spec.toml, manifest.json, episodes/*.parquet)")
    print(f"read it: octarm.read_sweep({str(options.out)!r})")
    return ExitCode.FINE if alike else ExitCode.CHECK_FAILED


def _record(spec: SweepSpec, options: Sweep, out: Path) -> bool:
    """Records the episodes that the spec chooses; whether they are what the table says."""
    if not spec.record:
        return True
    done = FinishedSweep(out)
    chosen = choose(read_sweep(out, COLUMNS), spec.record)
    for note in chosen.notes:
        print(f"octarm: {note}", file=sys.stderr)
    with (
        SweepFolder(out, done.plan).locked(),
        tqdm(unit=" periods", disable=None, leave=False) as bar,
    ):

        def begin(periods: int, label: str) -> None:
            bar.reset(periods)
            bar.set_description(label)

        try:
            different = record_chosen(
                done, chosen.reasons, make_controller, begin=begin, progress=bar.update
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"all rows are there; {_resume(options)} goes on") from None
    for sentence in different.values():
        print(f"octarm: {sentence}", file=sys.stderr)
    names = [f"{episode} ({', '.join(why)})" for episode, why in chosen.reasons.items()]
    print(f"recorded in {out / RECORDED}/: {', '.join(names) or 'none'}")
    return not different


def _run(spec: SweepSpec, options: Sweep, out: Path) -> None:
    """The sweep, with a bar on its progress."""
    plan = Plan(spec)
    bar = _Bar(plan.episodes, spec.duration)
    with _pool(options, plan) as (executor, in_flight), bar:
        try:
            run_sweep(
                spec,
                make_controller,
                out,
                executor=executor,
                in_flight=in_flight,
                resume=options.resume,
                progress=bar.update,
                say=bar.say,
            )
        except KeyboardInterrupt as interrupt:
            raise KeyboardInterrupt(*interrupt.args, _resume(options)) from None
        except OSError as error:
            raise OSError(
                f"{_reason(error)}; finished shards are kept: {_resume(options)}"
            ) from None


@contextlib.contextmanager
def _pool(options: Sweep, plan: Plan) -> Iterator[tuple[Executor, int | Callable[[], int]]]:
    """The executor that was asked for, and how many shards it should be given at a time."""
    workers = options.workers or cores()
    if options.cluster is not None:
        with dask_cluster(options.cluster, workers) as cluster:
            yield cluster
        return
    workers = min(workers, len(plan.shards))
    with WorkerProcesses(workers) as processes:
        yield processes, workers


class _Bar:
    """Episodes, how many a second, simulated seconds a second, and the time left."""

    def __init__(self, episodes: int, duration: float) -> None:
        self._duration = duration
        self._bar = tqdm(
            total=episodes, unit=" episodes", disable=None, leave=False, smoothing=0.05
        )
        self._started: float | None = None
        self._done = 0

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def update(self, episodes: int) -> None:
        if self._started is None:  # those that were there already take no time
            self._started = time.perf_counter()
            self._bar.initial = self._bar.n = episodes
            self._bar.refresh()
            return
        self._done += episodes
        speed = self._done * self._duration / (time.perf_counter() - self._started)
        self._bar.set_postfix_str(f"{speed:.0f} simulated s/s", refresh=False)
        self._bar.update(episodes)

    def say(self, sentence: str) -> None:
        self._bar.clear()
        print(f"octarm: {sentence}", file=sys.stderr)


def _check_controllers(spec: SweepSpec, file: Path) -> None:
    """Raises ValueError, with the line, unless every controller can be made."""
    source = Source(spec.text, str(file))
    for name in spec.controllers:
        gains = spec.gains.get(name, {})
        try:
            make_controller(name, nominal_parameters(), gains)
        except ValueError as error:
            keys = ("gains", name) if gains else ("grid", "controller")
            raise ValueError(f"{source.where(*keys)}: {error}") from None


def _check_recorded(spec: SweepSpec, file: Path) -> None:
    """Raises ValueError, with the line, for the number of an episode that there is not."""
    plan = Plan(spec)
    for episode in spec.record:
        if isinstance(episode, int):
            try:
                plan.episode(episode)
            except ValueError as error:
                where = Source(spec.text, str(file)).where("record", "episodes")
                raise ValueError(f"{where}: {error}") from None


def _dry_run(spec: SweepSpec, workers: int) -> int:
    """Prints what the sweep will take."""
    expected = estimate(spec, make_controller)
    print(f"{expected.episodes} episodes of {spec.duration:g} s in {expected.shards} shards")
    for axis in spec.axes:
        print(f"  {axis.name}: {', '.join(str(value) for value in axis.values)}")
    for axis in spec.random:
        print(f"  {axis.name}: {axis.low:g} .. {axis.high:g}, {axis.method}")
    print(f"  seeds: {spec.episodes} a cell")
    busy = min(workers, expected.shards)
    simulated = expected.episodes * spec.duration / expected.seconds * busy
    print(
        f"about {_span(expected.seconds / busy)} on {busy} workers "
        f"({simulated:.0f} simulated s/s), {_size(expected.size)} on disk"
    )
    if expected.shards < workers:
        print(f"a batch below {spec.batch} would make more shards, for all {workers} workers")
    return ExitCode.FINE


def _print_summary(folder: Path) -> None:
    """A row a controller."""
    table = read_sweep(folder, ["controller", "status", "rms_error_theta1"])
    print("controller            episodes  diverged  median rms error of theta1")
    for name in pc.unique(table["controller"]).to_pylist():  # pyright: ignore
        own = table.filter(pc.equal(table["controller"], name))  # pyright: ignore
        diverged = sum(status == "diverged" for status in own["status"].to_pylist())
        errors = own["rms_error_theta1"].drop_null().to_numpy()
        median = f"{np.median(errors):.3e} rad" if errors.size else "-"
        print(f"{name:<20} {own.num_rows:>9} {diverged:>9}  {median}")


def _resume(options: Sweep) -> str:
    words = ["octarm", "sweep", str(options.spec), "--out", str(options.out)]
    words += ["--workers", str(options.workers)] if options.workers else []
    words += ["--cluster", options.cluster] if options.cluster else []
    return shlex.join([*words, "--resume"])


def _reason(error: OSError) -> str:
    if error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _span(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 999.5:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} GB"
