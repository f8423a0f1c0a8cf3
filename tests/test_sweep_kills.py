"""Whatever is killed and whenever: the table becomes the same, and no finished shard is lost.

OCTARM_KILLS=20 kills each as often.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
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

KILLS = int(os.environ.get("OCTARM_KILLS", "6"))
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
    assert f"octarm sweep {spec_file} --out={folder} --workers=2 --resume" in error
    assert not (folder / ".progress").exists()
    finished = len(octarm.read_sweep(folder, ["episode"]))
    assert 0 < finished < len(longer)
    done: list[int] = []
    assert run(folder, LONGER, resume=True, progress=done.append).equals(longer)
    assert done[0] == finished


class Killer:
    """Kills a process once, soon after a sweep has told its progress so many times."""

    def __init__(self, victim: Callable[[], int]) -> None:
        """The victim is the number of the process."""
        self._victim = victim
        self._wait = random.randrange(2, 6)  # at the first time none is at work yet
        self.done: list[int] = []

    def __call__(self, episodes: int) -> None:
        self.done.append(episodes)
        if len(self.done) == self._wait:
            time.sleep(random.uniform(0.0, 0.01))
            os.kill(self._victim(), signal.SIGKILL)

    @property
    def has_killed(self) -> bool:
        return len(self.done) >= self._wait


def test_one_of_two_workers_that_is_killed_costs_its_shard_a_second_run(tmp_path, undisturbed):
    repeated, sweeps = 0, 0
    with WorkerProcesses(2) as processes:
        while repeated < KILLS:  # the others died between two shards
            said: list[str] = []
            kill_one = Killer(lambda: random.choice(active_children()).pid or 0)
            table = run(
                tmp_path / str(sweeps), executor=processes, in_flight=2, say=said.append,
                progress=kill_one,
            )  # fmt: skip
            assert kill_one.has_killed
            assert table.equals(undisturbed)
            assert len(said) <= 1
            repeated, sweeps = repeated + len(said), sweeps + 1
            assert sweeps < 20 * KILLS


def test_the_table_is_the_same_on_a_dask_cluster_that_loses_a_worker(tmp_path, undisturbed):
    with dask_cluster("local", 2) as (executor, useful):
        assert useful() == 2
        for i in range(KILLS):
            kill_one = Killer(lambda: executor.submit(os.getpid).result())
            table = run(tmp_path / str(i), executor=executor, in_flight=useful, progress=kill_one)
            assert kill_one.has_killed
            assert table.equals(undisturbed)
