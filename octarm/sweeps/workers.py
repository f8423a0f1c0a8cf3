"""Executors for shards: processes of this machine, or a dask cluster.

This module imports nothing heavy: it is the first thing that a new process imports.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any

from octarm.errors import OctarmError


def cores() -> int:
    """Number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class WorkerProcesses(ThreadPoolExecutor):
    """Processes of one thread each, and for each of them a thread that waits for its answers.

    When a process dies, only the call that it was at fails, with a `BrokenProcessPool`; another
    one takes its place. When the process that made them dies, all of them end.
    """

    def __init__(self, workers: int) -> None:
        """So many processes, each started when there is a call for it."""
        super().__init__(workers, initializer=_block_interrupts)
        self._processes: dict[int, _Process] = {}
        self._killed = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Has the next process that is free call a function."""
        return super().submit(lambda: self._start(fn, *args, **kwargs).result())

    def _start(self, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Future[Any]:
        """Has the process of this thread call a function; a new one if it has none that lives."""
        thread = threading.get_ident()
        if not self._killed:
            with contextlib.suppress(KeyError, BrokenProcessPool):
                return self._processes[thread].submit(fn, *args, **kwargs)
        process = self._processes[thread] = _Process()
        if self._killed:
            process.lifeline.close()
            raise BrokenProcessPool("the processes were ended")
        return process.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes when they have done what they were asked for."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        for process in self._processes.values():
            process.shutdown(wait)

    def kill(self) -> None:
        """Ends the processes at once; calls that wait for one fail with a `BrokenProcessPool`."""
        # Futures that are cancelled in the queue would never be done for those who wait for them.
        self._killed = True
        super().shutdown(wait=False)
        for process in list(self._processes.values()):
            process.lifeline.close()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self.kill()
        self.shutdown()


class _Process(ProcessPoolExecutor):
    """A process, which lives no longer than its lifeline is open."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")  # threads and forks do not go together
        end, self.lifeline = context.Pipe(duplex=False)
        super().__init__(1, context, _prepare, (end,))


def _block_interrupts() -> None:
    """Processes that this thread starts do not see Ctrl-C, not even while they begin."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _prepare(lifeline: Connection) -> None:
    """What a new process does first."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ.setdefault("MUJOCO_GL", "disabled")  # nothing is drawn here
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks

    def wait_for_the_end() -> None:
        with contextlib.suppress(EOFError, OSError):
            lifeline.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait_for_the_end, daemon=True).start()


@contextlib.contextmanager
def dask_cluster(address: str, workers: int) -> Generator[tuple[Executor, Callable[[], int]]]:
    """An executor on a dask cluster, and how many calls it has use for at a time.

    dask itself repeats what a worker was at when it died. Raises OSError if nobody answers.

    Args:
        address: of a scheduler, such as `tcp://10.0.0.1:8786`; or `local` for a cluster of this
            machine.
        workers: number of processes of a local cluster.

    Raises:
        OctarmError: if the package distributed is not installed, or there is no scheduler at the
            address.
    """
    try:
        import distributed
    except ImportError:
        raise OctarmError(
            "--cluster needs the package distributed: pip install 'octarm[cluster]'"
        ) from None
    with contextlib.ExitStack() as stack:
        # What it does when all is well is of no interest here, and what its client has to say of a
        # scheduler that is gone is said below in one sentence.
        for name, level in (("", logging.WARNING), (".client", logging.CRITICAL)):
            logger = logging.getLogger(f"distributed{name}")
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(level)
        target: Any = address
        if address == "local":
            cluster: Any = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # a port that is free
            )
            target = stack.enter_context(cluster)
        try:
            client: Any = stack.enter_context(distributed.Client(target, set_as_default=False))
        except (OSError, ValueError) as error:
            raise OctarmError(f"no dask scheduler answers at {address}: {error}") from None
        executor = client.get_executor(pure=False)  # a shard that failed may be tried again

        def useful() -> int:
            if address == "local":
                target.scale(workers)  # dask gives up on a worker that dies while it starts
                return workers
            try:
                threads = sum(client.nthreads().values())
            except OSError:
                raise OctarmError(
                    f"the dask scheduler at {address} does not answer any more"
                ) from None
            return max(8, 2 * threads)  # for a cluster that grows with the demand

        yield executor, useful
