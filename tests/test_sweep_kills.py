"""Whatever is killed and whenever: the table becomes the same, and no finished shard is lost."""

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing import active_children
from pathlib import Path

import pyarrow as pa
import pytest
from test_sweep import SPEC, run

import octarm
from octarm.errors import ExitCode
from octarm.sweeps.cluster import dask_cluster
from octarm.sweeps.workers import WorkerProcesses

KILLS = 20
pytestmark = pytest.mark.slow
LONGER = SPEC.replace("episodes = 3", "episodes = 12")  # 24 shards


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> pa.Table:
    return run(tmp_path_factory.mktemp("undisturbed") / "sweep")


@pytest.fixture(scope="module")
def longer(tmp_path_factory) -> pa.Table:
    return run(tmp_path_factory.mktemp("longer") / "sweep", LONGER)


@pytest.fixture
def spec_file(tmp_path) -> Path:
    file = tmp_path / "my.toml"
    file.write_text(LONGER)
    return file


def start_command(spec_file: Path, folder: Path) -> subprocess.Popen[str]:
    begun = folder.is_dir() and any(folder.iterdir())
    return subprocess.Popen(
        [sys.executable, "-m", "octarm", "sweep", spec_file, "--out", folder,
         "--workers", "2", *(["--resume"] if begun else [])],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True,
        cwd=Path(__file__).parent.parent,
    )  # fmt: skip


def wait_for(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 1800.0
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.01)


def is_gone(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


def shards(folder: Path) -> dict[str, int]:
    """The finished ones, and when they were written."""
    return {file.name: file.stat().st_mtime_ns for file in folder.glob("episodes/*.parquet")}


def test_a_killed_command_leaves_whole_shards_and_goes_on(tmp_path, spec_file, longer):
    folder = tmp_path / "s"
    for i in range(KILLS):
        before = shards(folder)
        process = start_command(spec_file, folder)
        wait_for(lambda: len(shards(folder)) > len(before))  # noqa: B023
        time.sleep(random.uniform(0.0, 0.1))
        process.kill()
        process.communicate(timeout=1800)
        wait_for(lambda: is_gone(process.pid))  # noqa: B023 - no worker goes on alone
        after = shards(folder)
        assert {name: after[name] for name in before} == before  # none was run again
        if len(after) > 12 or i == KILLS - 1:
            finished = len(octarm.read_sweep(folder, ["episode"]))
            done: list[int] = []
            assert run(folder, LONGER, resume=True, progress=done.append).equals(longer)
            assert done[0] == finished > 0
            shutil.rmtree(folder)


def test_an_interrupted_command_finishes_its_shards_and_says_how_to_go_on(
    tmp_path, spec_file, longer
):
    folder = tmp_path / "s"
    process = start_command(spec_file, folder)
    wait_for(lambda: len(shards(folder)) > 1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers get it as well
    error = process.communicate(timeout=1800)[1]
    wait_for(lambda: is_gone(process.pid))
    assert process.returncode == ExitCode.INTERRUPTED
    assert "Traceback" not in error
    assert f"octarm sweep {spec_file} --out {folder} --workers 2 --resume" in error
    assert not (folder / ".progress").exists()
    finished = len(octarm.read_sweep(folder, ["episode"]))
    assert 0 < finished < len(longer)
    done: list[int] = []
    assert run(folder, LONGER, resume=True, progress=done.append).equals(longer)
    assert done[0] == finished


def test_one_of_two_workers_that_is_killed_costs_its_shard_a_second_run(tmp_path, undisturbed):
    def kill_one() -> None:
        time.sleep(random.uniform(0.0, 1.0))
        while not (children := active_children()):
            time.sleep(0.01)
        os.kill(random.choice(children).pid or 0, signal.SIGKILL)

    with WorkerProcesses(2) as processes:
        for i in range(KILLS):
            said: list[str] = []
            killer = threading.Thread(target=kill_one)
            killer.start()
            table = run(tmp_path / str(i), executor=processes, in_flight=2, say=said.append)
            killer.join()
            assert table.equals(undisturbed)
            assert len(said) <= 1


def test_the_table_is_the_same_on_a_dask_cluster_that_loses_a_worker(tmp_path, undisturbed):
    with dask_cluster("local", 2) as (executor, useful):
        assert useful() == 2
        for i in range(KILLS):
            calls, chosen, killed = [], random.randrange(1, 6), []

            def kill_one(done: int, calls=calls, chosen=chosen, killed=killed) -> None:
                calls.append(done)
                if len(calls) == chosen:
                    time.sleep(random.uniform(0.0, 0.1))
                    killed.append(executor.submit(os.getpid).result())
                    os.kill(killed[0], signal.SIGKILL)

            table = run(tmp_path / str(i), executor=executor, in_flight=useful, progress=kill_one)
            assert killed
            assert table.equals(undisturbed)
