"""A dask cluster: its workers, its losses, and what is said of them."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from pathlib import Path

import distributed
import pytest
from clusters import dask_process
from test_sweep import SPEC, run

import octarm
from octarm.errors import ExitCode, OctarmError
from octarm.sweeps import cluster
from octarm.sweeps.cluster import dask_cluster

pytestmark = pytest.mark.slow
KILLS = int(os.environ.get("OCTARM_KILLS", "3"))
ROOT = Path(__file__).parent.parent
LONGER = SPEC.replace("0.02", "0.2")


@pytest.fixture(scope="module")
def empty():
    """The address of a cluster without workers."""
    with dask_process(0) as (address, _):
        yield address


@pytest.fixture(scope="module")
def single():
    """The address of a cluster with one worker."""
    with dask_process(1) as (address, _):
        yield address


def test_a_cluster_without_workers_is_waited_for_and_no_longer(empty):
    before = time.monotonic()
    with (
        pytest.raises(OctarmError, match=r"has had no worker for 0\.5 s; --wait-for-workers"),
        dask_cluster(empty, 1, 0.5),
    ):
        pass
    assert time.monotonic() - before > 0.5
    with (
        pytest.raises(OctarmError, match="wait-for-workers is nan s; it must be at least 0 s"),
        dask_cluster(empty, 1, float("nan")),
    ):
        pass


def sweep_command(spec_file: Path, *words: str) -> subprocess.Popen[str]:
    spec_file.write_text(LONGER)
    return subprocess.Popen(
        [sys.executable, "-m", "octarm", "sweep", spec_file, "--out", spec_file.with_name("s"),
         *words],
        stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip


def test_the_command_ends_at_the_first_interrupt_when_nothing_runs(tmp_path, empty):
    process = sweep_command(tmp_path / "my.toml", "--cluster", empty)
    time.sleep(5.0)  # it imports, or waits
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=1800)
    assert (process.returncode, error) == (ExitCode.INTERRUPTED, "octarm: interrupted\n")
    assert out.startswith("note: ") and out.count("\n") == 1
    assert not (tmp_path / "s").exists()


def test_a_sweep_without_workers_ends_at_the_first_interrupt(tmp_path):
    """Those at work have nobody to run them any more."""

    class Lost:
        def submit(self, *_args, **_options):
            return Future()

    calls: list[int] = []

    def nobody() -> int:
        calls.append(1)
        if len(calls) > 2:
            raise KeyboardInterrupt
        return 2 if len(calls) == 1 else 0

    with pytest.raises(KeyboardInterrupt, match="shards left to do: 6, the others are kept"):
        run(tmp_path / "s", executor=Lost(), in_flight=nobody)
    assert len(calls) == 3


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"numpy": "1.0"}, r"worker tcp://127.0.0.1:\d+ has numpy \S+ and not 1.0; all workers"),
        ({"nothing-such": "2.0"}, r"worker tcp://127.0.0.1:\d+ has no nothing-such; all workers"),
        ({"python": "3.99.1"}, r"has python 3.1\d and not 3.99; all workers"),
        ({"platform": "other", "rerun-sdk": "other"}, ""),
    ],
)
def test_workers_need_what_is_installed_here(changed, sentence, single, monkeypatch):
    versions = cluster.versions
    monkeypatch.setattr(cluster, "versions", lambda: {**versions(), **changed})
    if sentence:
        with pytest.raises(OctarmError, match=sentence), dask_cluster(single, 1):
            pass
    else:
        with dask_cluster(single, 1) as (executor, useful):
            assert useful() == 8 and executor.submit(pow, 2, 3).result() == 8


def test_a_cluster_that_loses_its_workers_is_waited_for_and_no_longer():
    with dask_process(1) as (address, _), dask_cluster(address, 1, 0.3) as (_, useful):
        assert useful() == 8
        with distributed.Client(address, set_as_default=False) as client:
            while client.nthreads():  # a worker that is busy may refuse at first
                client.retire_workers()
        with pytest.raises(OctarmError, match=r"has had no worker for 0\.3 s"):
            for _ in range(600):
                assert useful() in (0, 8)
                time.sleep(0.05)


def test_a_call_whose_workers_die_fails_with_a_sentence():
    with (
        dask_cluster("local", 1) as (executor, _),
        pytest.raises(OctarmError, match="its worker died 4 times"),
    ):
        executor.submit(os._exit, 1).result()


def test_nothing_is_said_of_what_is_as_usual(tmp_path):
    process = sweep_command(tmp_path / "my.toml", "--cluster", "local", "--workers", "2")
    out, error = process.communicate(timeout=1800)
    assert (process.returncode, error) == (0, "")
    assert "wrote" in out


def test_a_sweep_whose_scheduler_is_killed_goes_on_with_another_one(tmp_path):
    expected = run(tmp_path / "undisturbed", LONGER)
    folder, lost = tmp_path / "s", 0
    for kill in range(KILLS):
        with dask_process(1) as (address, process):
            before = finished(folder)

            def strike(
                episodes: int, process=process, folder=folder, before=before, kill=kill
            ) -> None:
                if len(finished(folder)) >= len(before) + kill % 3:
                    delay = 0.02 * (kill % 7)
                    threading.Timer(delay, process.send_signal, [signal.SIGKILL]).start()

            try:
                with dask_cluster(address, 1) as (executor, useful):
                    table = run(
                        folder, LONGER, executor=executor, in_flight=useful, resume=True,
                        progress=strike,
                    )  # fmt: skip
                assert table.equals(expected)
            except OctarmError as error:
                assert "does not answer any more; shards left to do:" in str(error)
                assert "--resume goes on" in str(error)
                lost += 1
        after = finished(folder)
        assert {name: after[name] for name in before} == before  # none was run again
        assert not (folder / ".progress").exists()
        if len(after) == 6:
            assert octarm.read_sweep(folder).num_rows == len(expected)
            folder = tmp_path / f"s{kill}"
    assert lost
    print(f"{KILLS} kills, {lost} sweeps lost their scheduler")
    assert run(folder, LONGER, resume=True).equals(expected)


def test_the_command_says_one_sentence_of_a_scheduler_that_is_killed(tmp_path):
    with dask_process(1) as (address, scheduler):
        process = sweep_command(tmp_path / "my.toml", "--cluster", address)
        while not finished(tmp_path / "s") and process.poll() is None:
            time.sleep(0.02)
        scheduler.kill()
        out, error = process.communicate(timeout=1800)
    assert process.returncode == ExitCode.BAD_INPUT and out.count("\n") == 1  # on short runs
    assert "does not answer any more; shards left to do:" in error and error.count("\n") == 1


def finished(folder: Path) -> dict[str, int]:
    """The finished shards, and when they were written."""
    return {file.name: file.stat().st_mtime_ns for file in folder.glob("episodes/*.parquet")}
