"""What Ctrl-C and SIGTERM do, from the first import of a program to its end.

While it imports, they end it at once (`end_at_once`); while it works, they raise
`KeyboardInterrupt` (`raise_interrupts`); around what must not be cut in two they wait
(`held_interrupts`), and while a run that is over is being closed nothing comes of them
(`ignored_interrupts`).
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)  # what ends a run early
_MOMENT = 3.0  # [s]
_LATER = 0.01  # [s]
_INTERRUPTED = 130  # `octarm.errors.ExitCode.INTERRUPTED`, which is not imported yet


def end_at_once() -> None:
    """Lets an interrupt end the process; there is nothing to clean up yet."""

    def end(*_: object) -> None:
        os.write(2, b"octarm: interrupted\n")
        os._exit(_INTERRUPTED)

    for number in SIGNALS:
        signal.signal(number, end)


def raise_interrupts() -> None:
    """Lets an interrupt raise `KeyboardInterrupt`.

    A second one within a moment changes nothing: a run that was interrupted is being closed. One
    that comes while an object is deleted, where Python ignores exceptions, comes once more.
    """
    before, usual = -math.inf, sys.unraisablehook

    def interrupt(*_: object) -> None:
        nonlocal before
        now = time.monotonic()
        if now - before > _MOMENT:
            before = now
            raise KeyboardInterrupt

    def repeat(ignored: sys.UnraisableHookArgs) -> None:
        nonlocal before
        if not isinstance(ignored.exc_value, KeyboardInterrupt):
            usual(ignored)
            return
        before = -math.inf
        threading.Timer(_LATER, os.kill, (os.getpid(), signal.SIGINT)).start()

    sys.unraisablehook = repeat
    for number in SIGNALS:
        signal.signal(number, interrupt)


@contextlib.contextmanager
def held_interrupts() -> Generator[None]:
    """Lets an interrupt wait until the block ends."""
    came: list[tuple[int, FrameType | None]] = []
    with _handled_by(lambda number, frame: came.append((number, frame))) as before:
        yield
    for number, frame in came[:1]:
        handler = before[number]
        if callable(handler):
            handler(number, frame)
        elif handler == signal.SIG_DFL:
            signal.raise_signal(number)


@contextlib.contextmanager
def ignored_interrupts() -> Generator[None]:
    """Lets nothing come of an interrupt until the block ends."""
    with _handled_by(signal.SIG_IGN):
        yield


@contextlib.contextmanager
def _handled_by(
    handler: Callable[[int, FrameType | None], Any] | signal.Handlers,
) -> Generator[Mapping[int, Any]]:
    """Replaces the handlers of interrupts for a while; yields those from before by number."""
    if threading.current_thread() is not threading.main_thread():
        yield {}  # signals do not come here
        return
    known = [number for number in SIGNALS if signal.getsignal(number) is not None]
    before = {int(number): signal.signal(number, handler) for number in known}
    try:
        yield before
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
