"""The terminal as it is found: streams may be closed, full or of few letters, files limited.

Results that are in files do not depend on whether somebody can read what is printed of them.
"""

from __future__ import annotations

import contextlib
import io
import os
import resource
import sys
from collections.abc import Callable, Generator
from typing import Any, TextIO, cast

from octarm.errors import OctarmError, printable

_FILES = 48  # that a command may open at a time, worker processes aside


def note(sentence: str) -> None:
    """Prints a sentence on standard error."""
    print(f"octarm: {printable(sentence)}", file=sys.stderr)


def repair_streams() -> None:
    """Opens what is closed of the standard streams, and lets them take every letter.

    The next files that a program opens would have the numbers of closed ones, and what is printed
    would be written into them. Of output and errors, one stands in for the other.
    """
    closed = [number for number in range(3) if not os.path.exists(f"/dev/fd/{number}")]
    for _ in closed:
        os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    for number, other in ((1, 2), (2, 1)):
        if number in closed and other not in closed:
            os.dup2(other, number)
    sys.stdin = sys.stdin or open(0, closefd=False)
    sys.stdout = sys.stdout or open(1, "w", buffering=1, closefd=False)
    sys.stderr = sys.stderr or open(2, "w", buffering=1, closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def check_open_files() -> None:
    """Raises OctarmError if the system lets this process open too few files to do anything."""
    limit, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        needed = len(os.listdir("/dev/fd")) + _FILES
    except OSError:  # no further file can be opened
        needed = 3 + _FILES
    if not 0 <= limit < needed:  # a negative number stands for no limit
        return
    if 0 <= most < needed:
        raise OctarmError(
            f"the system allows {limit} open files, and octarm needs {needed}: ulimit -n {needed}"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, most))


def surviving_output(
    work: Callable[..., int | None], *arguments: Any, **options: Any
) -> Callable[[], int | None]:
    """Work with its arguments whose results are in files: it goes on although output fails.

    What a standard output that is full does not take goes to standard error; whoever has closed a
    pipe has seen enough.
    """

    def survivor() -> int | None:
        with contextlib.redirect_stdout(cast("TextIO", _Stream(sys.stdout, sys.stderr))):
            return work(*arguments, **options)

    return survivor


@contextlib.contextmanager
def surviving_errors() -> Generator[None]:
    """Lets what standard error does not take go to standard output, or nowhere."""
    with contextlib.redirect_stderr(cast("TextIO", _Stream(sys.stderr, sys.stdout))):
        yield


class _Stream:
    """A stream whose place another one takes when it fails; the last one fails silently."""

    def __init__(self, *streams: TextIO) -> None:
        self._streams = list(streams)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # also while it is being made or copied
            raise AttributeError(name)
        return getattr(self._streams[0], name)

    def flush(self) -> None:
        """Nothing: what is written is flushed."""

    def write(self, text: str) -> int:
        """Writes to the first stream that takes it; never fails."""
        while True:
            try:
                self._streams[0].write(text)
                self._streams[0].flush()
            except BrokenPipeError:
                silence(self._streams[0])
            except OSError:
                silence(self._streams[0])
                if len(self._streams) > 1:
                    del self._streams[0]
                    continue
            return len(text)


def silence(stream: TextIO) -> None:
    """Lets what a stream still holds, and all that comes, go nowhere."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
