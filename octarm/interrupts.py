"""Letting an interrupt wait until what must not be cut in two is done."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Generator
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)  # what ends a run early


@contextlib.contextmanager
def held_interrupts() -> Generator[None]:
    """Lets Ctrl-C and SIGTERM wait until the block ends."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals do not come here
        return
    came: list[tuple[int, FrameType | None]] = []
    known = [number for number in SIGNALS if signal.getsignal(number) is not None]
    before = {n: signal.signal(n, lambda number, at: came.append((number, at))) for n in known}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number, at in came[:1]:
        handler = before[signal.Signals(number)]
        if callable(handler):
            handler(number, at)
        elif handler == signal.SIG_DFL:
            signal.raise_signal(number)
