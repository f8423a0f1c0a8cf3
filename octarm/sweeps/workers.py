"""An executor for shards: processes of this machine; for a cluster see `octarm.sweeps.cluster`.

This module imports nothing heavy: it is the first thing that a new process imports.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any

from octarm.errors import OctarmError

_NAME = "octarm worker"
_MAIN = '`if __name__ == "__main__":`'
_GUARD = (
    "the worker processes cannot begin: each of them imports the script that starts them, whose "
    f"work must stand below {_MAIN}"
)
_IMPORTED = "what worker processes call must be a function that they can import from a file"


def cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0))


class WorkersError(OctarmError):
    """Workers that cannot begin; to try it again is of no use."""


def check_not_beginning() -> None:
    """Ends this process if it is a worker that has got no further than to import its script."""
    process = multiprocessing.current_process()
    if getattr(process, "_inheriting", False):  # as multiprocessing itself finds it out
        raise SystemExit(1 if process.name == _NAME else _GUARD)


def _check_script() -> None:
    """Raises WorkersError if new processes cannot import the script of this one."""
    script: dict[str, Any] = vars(sys.modules["__main__"])
    file: str | None = None if script.get("__spec__") else script.get("__file__")
    if file is not None and not os.path.exists(file):
        raise WorkersError(
            f"worker processes import the script that starts them, and {file} is no file: save it "
            f"as one, with its work below {_MAIN}"
        )


class WorkerProcesses(ThreadPoolExecutor):
    """Processes of one thread each, and for each of them a thread that waits for its answers.

    When a process dies, only the call that it was at fails, with a `BrokenProcessPool`; another
    one takes its place. When the process that made them dies, all of them end. A call fails with a
    `WorkersError` if no process can begin, or what is to be called is not known there.

    Attributes:
        count: of the processes.
    """

    def __init__(self, workers: int) -> None:
        """So many processes, each started when there is a call for it.

        Raises WorkersError if they could not import the script of this process.
        """
        check_not_beginning()
        _check_script()
        super().__init__(workers, initializer=_block_interrupts)
        self.count = workers
        self._processes: dict[int, _Process] = {}
        self._killed = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Has the next process that is free call a function."""
        return super().submit(self._call, fn, args, kwargs)

    def _call(self, *call: Any) -> Any:
        """Has the process of this thread call a function; a new one if it has none that lives."""
        thread = threading.get_ident()
        process = self._processes.get(thread)
        if not self._killed and (process is None or not process.process.is_alive()):
            process = self._processes[thread] = _Process()
        if self._killed or process is None:
            if process is not None:
                process.process.kill()
            raise BrokenProcessPool("the processes were ended")
        return process.call(call)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes when they have done what they were asked for."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        for process in list(self._processes.values()) if wait else ():
            process.end()

    def kill(self) -> None:
        """Ends the processes at once; calls that wait for one fail with a `BrokenProcessPool`."""
        # Futures that are cancelled in the queue would never be done for those who wait for them.
        self._killed = True
        super().shutdown(wait=False)
        for process in list(self._processes.values()):
            process.process.kill()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self.kill()
        self.shutdown()


class _Process:
    """A process that does one call at a time, and lives no longer than its connection is open."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")  # threads and forks do not go together
        self._connection, end = context.Pipe()
        self.process = context.Process(target=_serve, args=(end,), name=_NAME, daemon=True)
        self.process.start()
        end.close()
        self._begun = False

    def call(self, call: tuple[Any, ...]) -> Any:
        """What the function returns, or the exception that it raises."""
        try:
            content = pickle.dumps(call)
        except Exception as error:  # of many kinds
            raise WorkersError(f"{error}; {_IMPORTED}") from None
        try:
            if not self._begun:
                self._connection.recv_bytes()
                self._begun = True
            self._connection.send_bytes(content)
            answer = self._connection.recv_bytes()
        except (EOFError, OSError):
            # By itself it ends only if its script cannot be imported.
            self.process.join()
            if not self._begun and (self.process.exitcode or 0) > 0:
                raise WorkersError(_GUARD) from None
            raise BrokenProcessPool("a worker process died") from None
        good, value = pickle.loads(answer)
        if not good:
            raise value
        return value

    def end(self) -> None:
        self._connection.close()
        self.process.join()


def _block_interrupts() -> None:
    """Processes that this thread starts do not see Ctrl-C, not even while they begin."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _serve(connection: Connection) -> None:
    """What a new process does: one call after another, until the connection is closed."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ.setdefault("MUJOCO_GL", "disabled")  # nothing is drawn here
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                calls.put(connection.recv_bytes())
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    with contextlib.suppress(OSError):  # the process that asks has died
        connection.send_bytes(b"begun")
        while True:
            connection.send_bytes(_answer(calls.get()))
    os._exit(0)


def _answer(content: bytes) -> bytes:
    """Whether a call came to its end, and what it returned or raised."""
    try:
        fn, args, kwargs = pickle.loads(content)
    except Exception as error:  # of many kinds
        return pickle.dumps((False, WorkersError(f"{error}; {_IMPORTED}")))
    try:
        return pickle.dumps((True, fn(*args, **kwargs)))
    except BaseException as error:
        error.add_note(traceback.format_exc())
        with contextlib.suppress(Exception):  # not every exception can be sent
            content = pickle.dumps((False, error))
            if isinstance(pickle.loads(content)[1], Exception):
                return content
        return pickle.dumps((False, RuntimeError(traceback.format_exc())))
