"""What `octarm sweep` does."""

from __future__ import annotations

import contextlib
import dataclasses
import shlex
from collections.abc import Callable, Generator
from concurrent.futures import Executor
from pathlib import Path

import numpy as np
from tqdm import tqdm

from controllers import CONTROLLERS, make_controller
from octarm.bars import bar as new_bar
from octarm.commands.many_runs import SweepOptions
from octarm.commands.notes import print_late, print_unsuited
from octarm.commands.options import spelt
from octarm.commands.terminal import note
from octarm.declared import short_name, word_of
from octarm.errors import ExitCode, OctarmError, printable, sentence_of
from octarm.fields import field_kinds
from octarm.formats import read_toml
from octarm.memory import check_batch
from octarm.metrics.metric import unsettled
from octarm.simulation.engines import LAGRANGE, check_engine
from octarm.simulation.steps import AUTO
from octarm.sweeps import engine_check
from octarm.sweeps.cluster import dask_cluster
from octarm.sweeps.episodes import COLUMNS, METRIC, FinishedSweep, record_episodes, select
from octarm.sweeps.execute import estimate
from octarm.sweeps.execute import sweep as run_sweep
from octarm.sweeps.plan import Plan, with_step
from octarm.sweeps.progress import ProgressBar, digits
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.spec_file import read_spec
from octarm.sweeps.store import RECORDED, SweepFolder, read_sweep
from octarm.sweeps.workers import WorkerProcesses, cores


def sweep(file: Path, options: SweepOptions) -> int:
    """`octarm sweep`: runs a spec into a folder."""
    spec = _checked_spec(file, options)
    if options.resume and options.force:
        raise OctarmError("--resume and --force exclude each other")
    if options.out is None:
        raise OctarmError("there is no folder to write to; give --out DIR, or --dry-run")
    if options.resume and not (options.out.is_dir() and any(options.out.iterdir())):
        raise OctarmError(f"there is nothing in {options.out} to go on with by --resume")
    words = ["octarm", "sweep", str(file), *spelt(options, "resume", "force"), "--resume"]
    again = shlex.join(words)
    _run(spec, options, options.out, again)
    alike = _record(spec, options.out, again)
    _print_summary(options.out)
    if spec.engine == LAGRANGE:  # some episodes ran on both engines
        (column,) = (x.to_numpy() for x in read_sweep(options.out, [engine_check.COLUMN]))
        difference = column[~np.isnan(column)]
        print(engine_check.sentence(difference, len(column)))
        alike &= bool(np.all(difference <= engine_check.LIMIT))
    print(f"wrote {printable(str(options.out))}/  (spec.toml, manifest.json, episodes/*.parquet)")
    print(f"read it: octarm.read_sweep({str(options.out)!r})")
    return ExitCode.FINE if alike else ExitCode.CHECK_FAILED


def dry_run(file: Path, options: SweepOptions) -> None:
    """`octarm sweep --dry-run`: prints what the sweep will take."""
    spec = _checked_spec(file, options)
    workers = options.workers or cores()
    if spec.timestep == AUTO:
        spec = with_step(spec, probes=True)
        print(f"a physics step of {spec.timestep:g} s, as a few episodes need it")
    expected = estimate(spec, make_controller)
    print(f"{expected.episodes} episodes of {spec.duration:g} s in {expected.shards} shards")
    for axis in (*spec.axes, *spec.random):
        print(f"  {axis.name}: {', '.join(map(str, axis.values))}")
    busy = min(workers, expected.shards)
    simulated = expected.episodes * spec.duration / expected.seconds * busy
    time, size = tqdm.format_interval(expected.seconds / busy), tqdm.format_sizeof(expected.size)
    print(
        f"about {time} on {busy} workers ({digits(simulated)} simulated s/s), at most {size}B on "
        "disk"
    )
    try:
        Plan(spec).check_size()
    except OctarmError as error:
        print(f"octarm sweep will refuse it: {error}")


def _checked_spec(file: Path, options: SweepOptions) -> SweepSpec:
    """The spec, whose controllers can be made and whose recorded episodes there are."""
    spec = read_spec(file)
    if options.engine is not None:
        spec = dataclasses.replace(spec, engine=options.engine)
    check_engine(spec.engine)
    for name in spec.controllers:
        keys = ("gain_set", name) if name in spec.gain_sets else ("grid", "controller")
        with _in_file(file, *(("gains", name) if name in spec.gains else keys)):
            code = None if name in spec.code else CONTROLLERS.code(name)
            if code is not None:  # an entry point of an installed package
                spec = dataclasses.replace(spec, code={**spec.code, name: code}, text="")
            period, gains = spec.control_period, spec.gain_sets.get(name)
            for arm in spec.all_believed():
                spec.controller(name, arm, make_controller)
                label = short_name(word_of(name, spec.code))
                print_unsuited(label, gains, arm, spec.timestep, period)
    if early := unsettled(spec.duration, spec.settle, "settle ="):
        print(f"note: {early}")
    print_late(_starts(spec), spec.references, spec.code, spec.duration)
    plan = Plan(spec)
    for episode in spec.record:
        if isinstance(episode, int):
            with _in_file(file, "record", "episodes"):
                plan.episode(episode)
    return spec


def _starts(spec: SweepSpec) -> list[tuple[str, float]]:
    """What begins of the disturbances of a spec, and the times from which on it does [s]."""
    axes = (*spec.axes, *(dataclasses.replace(x, values=x.values[:1]) for x in spec.random))
    times = {(axis.disturbance, axis.field): axis.values for axis in axes}
    return [
        (name, float(at))
        for name in spec.disturbances
        if getattr(field_kinds(spec.class_of(name)).get("at"), "unit", "") == "s"
        for at in times.get((name, "at"), [spec.fixed.get(name, {}).get("at", 0.0)])
    ]


@contextlib.contextmanager
def _in_file(file: Path, *keys: str) -> Generator[None]:
    """Lets an error name the line of these keys."""
    try:
        yield
    except OctarmError as error:
        raise read_toml(file).error(str(error), *keys) from None


def _record(spec: SweepSpec, out: Path, again: str) -> bool:
    """Records the episodes that the spec selects; whether they are what the table says."""
    if not spec.record:
        return True
    done = FinishedSweep(out)
    selection = select(read_sweep(out, COLUMNS), spec.record)
    for sentence in selection.notes:
        note(sentence)
    with SweepFolder(out, done.plan).locked(), new_bar(unit=" periods") as bar:

        def begin(periods: int, label: str) -> None:
            bar.reset(periods)
            bar.set_description(label)

        try:
            different = record_episodes(
                done, selection.reasons, make_controller, begin=begin, progress=bar.update
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"all rows are there; {again} goes on") from None
    for sentence in different.values():
        note(sentence)
    names = [f"{episode} ({', '.join(why)})" for episode, why in selection.reasons.items()]
    print(f"recorded in {printable(str(out / RECORDED))}/: {', '.join(names) or 'none'}")
    return not different


def _run(spec: SweepSpec, options: SweepOptions, out: Path, again: str) -> None:
    """The sweep, with a bar on its progress; `again` is the command that goes on with it."""
    plan = Plan(spec)
    with _pool(options, plan) as (executor, in_flight), ProgressBar(spec) as bar:
        try:
            run_sweep(
                spec,
                make_controller,
                out,
                executor=executor,
                in_flight=in_flight,
                resume=options.resume,
                replace=options.force,
                progress=bar.update,
                say=bar.say,
            )
        except KeyboardInterrupt as interrupt:
            raise KeyboardInterrupt(*interrupt.args, again) from None
        except OSError as error:
            reason = sentence_of(error)
            raise OctarmError(f"{reason}; finished shards are kept: {again}") from None


@contextlib.contextmanager
def _pool(options: SweepOptions, plan: Plan) -> Generator[tuple[Executor, int | Callable[[], int]]]:
    """The executor that was asked for, and how many shards it should be given at a time."""
    workers = options.workers or cores()
    if options.cluster is not None:
        with dask_cluster(options.cluster, workers, options.wait_for_workers) as cluster:
            yield cluster
        return
    workers = min(workers, len(plan.shards))
    check_batch(len(plan.shard(0)), plan.spec.most_modules, workers)
    with WorkerProcesses(workers) as processes:
        yield processes, workers


def _print_summary(folder: Path) -> None:
    """A row a controller; who diverged is worse than all others."""
    names, status, errors = (
        column.to_numpy() for column in read_sweep(folder, ["controller", "status", METRIC])
    )
    print(f"controller            episodes  diverged  median {METRIC} [mm]")
    for name in dict.fromkeys(names.tolist()):
        diverged = status[names == name] == "diverged"
        values = np.where(diverged, np.inf, errors[names == name])
        known = values[~np.isnan(values)]  # a short episode has none
        median = f"{1e3 * np.median(known):.3g}" if known.size else "-"
        print(f"{printable(name, 40):<20} {values.size:>9} {diverged.sum():>9}  {median}")
