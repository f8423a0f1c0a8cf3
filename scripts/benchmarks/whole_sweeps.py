"""How whole sweeps do: with two workers, over many episodes, and beside what they compute."""

import contextlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

import octarm
from benchmarks.figures import Row, Settings
from controllers import make_controller
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import run_arms
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.workers import WorkerProcesses

CONTROLLER = "afsmc"
WORKERS = 2
_PERIOD = 5e-4  # of control [s]
_TIMES = 3  # that one and two workers are compared
_SHARDS = 4  # of that sweep
_GLANCE = 0.02  # between two looks at the memory [s]


def text_of(episodes: int, duration: float, batch: int) -> str:
    """The spec of a sweep of one controller under noise."""
    return (
        f'controller = "{CONTROLLER}"\nepisodes = {episodes}\nduration = {duration!r}\n'
        f"batch = {batch}\n[disturbance]\nnoise = 0.4\n"
    )


def workers(settings: Settings) -> list[Row]:
    """Two workers against one, in turns, on processes that are up already."""
    spec = parse_spec(text_of(_SHARDS * settings.arms, 0.2 * settings.seconds, settings.arms))
    taken = np.empty((_TIMES, 2))  # [s]
    with WorkerProcesses(1) as one, WorkerProcesses(WORKERS) as two:
        pools = (one, two)
        for count, pool in enumerate(pools, 1):
            _run(parse_spec(text_of(count, _PERIOD, 1)), pool, count)
        for times in taken:
            for count, pool in enumerate(pools, 1):
                times[count - 1] = _run(spec, pool, count)
    ratio = float(np.median(taken[:, 0] / taken[:, 1]))
    return [Row("two workers, throughput over one", ratio, "1", at_least=1.9)]


def _run(spec: SweepSpec, pool: WorkerProcesses, count: int) -> float:
    """How long a sweep takes [s]."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        octarm.sweep(spec, make_controller, Path(folder) / "sweep", executor=pool, in_flight=count)
        return time.perf_counter() - begun


def memory(settings: Settings) -> list[Row]:
    """Peak memory of a sweep of many short episodes, and of one of a fifth of them.

    What a sweep needs besides does not grow once every process has had two shards. A million
    episodes take ten times as long as those that are run; `--episodes 1000000` measures them.
    """
    many, few = settings.episodes, max(1, settings.episodes // 5)
    large, small = peak_memory(many, settings.arms), peak_memory(few, settings.arms)
    million = large + max(0.0, large - small) * (1e6 - many) / max(1, many - few)
    return [
        Row(f"a sweep of {many} episodes, all processes", large, "MB", at_most=1000.0),
        Row(f"that above one of {few} episodes", large - small, "MB", at_most=100.0),
        Row("by these two, a sweep of a million", million, "MB", at_most=1000.0),
    ]


def peak_memory(episodes: int, arms: int) -> float:
    """The most that the processes of `octarm sweep` hold together [MB].

    What they share counts for each. The episodes have four control periods.
    """
    with tempfile.TemporaryDirectory() as folder:
        spec, out = Path(folder) / "spec.toml", Path(folder) / "sweep"
        spec.write_text(text_of(episodes, 4 * _PERIOD, arms), encoding="utf-8")
        command = [sys.executable, "-m", "octarm"]
        command += ["sweep", str(spec), "--out", str(out), "--workers", str(WORKERS)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        peak = 0.0
        while process.poll() is None:
            peak = max(peak, sum(map(_held, _family(process.pid))))
            time.sleep(_GLANCE)
    if process.returncode:
        raise RuntimeError(f"octarm sweep of {episodes} episodes ended with {process.returncode}")
    return peak


def _family(ancestor: int) -> list[psutil.Process]:
    """A process and those that it started."""
    with contextlib.suppress(psutil.NoSuchProcess):
        parent = psutil.Process(ancestor)
        return [parent, *parent.children(recursive=True)]
    return []


def _held(process: psutil.Process) -> float:
    """Resident memory [MB]; none if the process is gone."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return process.memory_info().rss / 1e6
    return 0.0


def overhead(settings: Settings) -> list[Row]:
    """What a sweep takes beside its shards: starting, writing, merging, reading, waiting.

    It is measured over short episodes. Of long ones the shards alone would take longer.
    """
    short, long = 0.1 * settings.seconds, 10.0  # [s]
    episodes = max(2, settings.episodes // 10)
    spec = parse_spec(text_of(episodes, short, settings.arms))
    with tempfile.TemporaryDirectory() as name:
        folder, begun = Path(name) / "sweep", time.perf_counter()
        with WorkerProcesses(WORKERS) as pool:
            octarm.sweep(spec, make_controller, folder, executor=pool, in_flight=WORKERS)
        table = octarm.read_sweep(folder)
        taken = WORKERS * (time.perf_counter() - begun)
    inside = float(np.sum(table["wall_time"].to_numpy()))
    plan = Plan(spec)
    begun = time.perf_counter()
    run_arms(plan, plan.arms(plan.shard(0)), make_controller, duration=_PERIOD)
    once = len(plan.shards) * (time.perf_counter() - begun)
    all_inside = once + (inside - once) * long / short
    beside = taken - inside
    share = 100.0 * beside / (beside + all_inside)
    return [
        Row(f"{WORKERS} workers' time beside their shards", beside, "s"),
        Row(f"that within {episodes} episodes of {long:g} s (their", share, "%", at_most=5.0),
        Row(f"  shards' time extrapolated from {short:g} s)", all_inside, "s"),
    ]
