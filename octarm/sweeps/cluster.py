"""An executor for shards on a dask cluster, whose workers are looked at before they get any."""

from __future__ import annotations

import contextlib
import logging
import os
import time
import warnings
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Executor, Future
from typing import Any

from octarm.errors import OctarmError
from octarm.runs.versions import versions
from octarm.sweeps.workers import check_not_beginning

_UNUSED = ("platform", "rerun-sdk")  # by shards
_GLANCE = 0.1  # [s]


@contextlib.contextmanager
def dask_cluster(
    address: str, workers: int, wait: float = 60.0
) -> Generator[tuple[Executor, Callable[[], int]]]:
    """An executor on a dask cluster, and how many calls it has use for at a time.

    dask itself repeats what a worker was at when it died. The number of calls is 0 as long as there
    is no worker.

    Args:
        address: of a scheduler, such as `tcp://10.0.0.1:8786`; `local` for a cluster of this
            machine.
        workers: number of processes of a local cluster.
        wait: how long it may have no worker, at the beginning or later [s].

    Raises:
        OctarmError: if the package distributed is not installed, no scheduler answers, it has no
            worker for too long, or a worker lacks something. The number of calls raises it, too.
    """
    check_not_beginning()
    if not wait >= 0.0:
        raise OctarmError(f"wait-for-workers is {wait:g} s; it must be at least 0 s")
    try:
        import distributed
        from distributed.versions import VersionMismatchWarning
    except ImportError:
        raise OctarmError(
            "--cluster needs the package distributed: pip install 'octarm[cluster]'"
        ) from None
    with contextlib.ExitStack() as stack:
        stack.enter_context(_quiet("distributed", logging.ERROR))  # warns of what it mends itself
        stack.enter_context(_quiet("distributed.client", logging.CRITICAL))  # `_Watch` says it
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore", VersionMismatchWarning)  # said below, of what matters
        target: Any = address
        if address == "local":
            cluster: Any = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # a port that is free
                silence_logs=logging.CRITICAL,
            )
            stack.callback(_close, cluster)
            target = cluster
        try:
            client: Any = stack.enter_context(distributed.Client(target, set_as_default=False))
        except (OSError, ValueError) as error:
            raise OctarmError(f"no dask scheduler answers at {address}: {error}") from None
        watch = _Watch(client, address, wait)
        call = client.submit(os.getpid, pure=False)  # a cluster may grow with the demand
        while not watch.threads():
            time.sleep(_GLANCE)
        call.release()

        def useful() -> int:
            threads = watch.threads()
            if address == "local":
                target.scale(workers)  # dask gives up on a worker that dies while it starts
                return workers
            return threads and max(8, 2 * threads)  # for a cluster that grows with the demand

        yield _Executor(client), useful


class _Executor(Executor):
    """Has a cluster call functions.

    A call fails with an `OctarmError` if all workers died that dask had tried it on.
    """

    def __init__(self, client: Any) -> None:
        self._executor: Executor = client.get_executor(pure=False)  # what failed is tried again

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        from distributed import KilledWorker

        answer: Future[Any] = Future()

        def hand_on(call: Future[Any]) -> None:
            try:
                answer.set_result(call.result())
            except KilledWorker as error:
                died = f"its worker died {error.allowed_failures + 1} times"
                answer.set_exception(OctarmError(died))
            except BaseException as error:  # such as that of a call that was cancelled
                answer.set_exception(error)

        self._executor.submit(fn, *args, **kwargs).add_done_callback(hand_on)
        return answer


def _close(cluster: Any) -> None:
    """Ends a cluster of this machine; its work is over, whatever dask says of its workers."""
    # While a worker that died is begun anew, dask fails at its own assertions.
    with contextlib.suppress(AssertionError, OSError, TimeoutError):
        cluster.close()


class _Watch:
    """Looks at the workers of a cluster: whether there are any, and whether they will do."""

    def __init__(self, client: Any, address: str, patience: float) -> None:
        self._client, self._address, self._patience = client, address, patience
        self._seen = time.monotonic()  # when there were workers
        self._looked_at: set[str] = set()

    def threads(self) -> int:
        """The number of threads of all workers; raises OctarmError if they will not do."""
        try:
            threads: Mapping[str, int] = self._client.nthreads()
            if not self._looked_at >= threads.keys():
                self._look_at(self._client.get_versions(packages=[*_needed()])["workers"])
        except OSError:
            raise OctarmError(
                f"the dask scheduler at {self._address} does not answer any more"
            ) from None
        now = time.monotonic()
        if threads:
            self._seen = now
        elif now - self._seen > self._patience:
            raise OctarmError(
                f"the dask cluster at {self._address} has had no worker for {self._patience:g} s; "
                "--wait-for-workers waits longer"
            )
        return sum(threads.values())

    def _look_at(self, workers: Mapping[str, Any]) -> None:
        """Raises OctarmError if a worker lacks something, or has it in another version."""
        needed = _needed()
        for worker, system in workers.items():
            there: Mapping[str, str | None] = {
                **system["packages"],
                "python": _minor(system["host"]["python"]),
            }
            wrong = [
                f"{name} {there[name]} and not {version}" if there.get(name) else f"no {name}"
                for name, version in needed.items()
                if there.get(name) != version
            ]
            if wrong:
                raise OctarmError(
                    f"the dask worker {worker} has {', '.join(wrong)}; all workers need the "
                    "versions that are installed here"
                )
            self._looked_at.add(worker)


def _needed() -> dict[str, str]:
    needed = {name: x for name, x in versions().items() if name not in _UNUSED}
    return {**needed, "python": _minor(needed["python"])}


def _minor(version: str) -> str:
    return ".".join(version.split(".")[:2])


@contextlib.contextmanager
def _quiet(name: str, level: int) -> Generator[None]:
    """Lets a logger say what is at least of this level."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(before)
