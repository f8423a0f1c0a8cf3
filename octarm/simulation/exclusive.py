"""Arms are moved by one user at a time: a second thread, or a second loop, is refused."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Generator

from octarm.errors import OctarmError


class Exclusive:
    """`with exclusive:` stands around whatever moves the arms; other threads are refused there."""

    def __init__(self) -> None:
        self._change, self._loop = threading.RLock(), threading.Lock()
        self._turn = _Turn()
        self._mixed = False  # two threads have met, and nobody knows whose state this is

    def __enter__(self) -> None:
        """Begins a change.

        Raises OctarmError if another thread or a loop moves the arms, or two threads have done so
        since they were reset.
        """
        if not self._change.acquire(blocking=False):
            self._mixed = not self._loop.locked()
            raise _refusal()
        if self._mixed or (self._loop.locked() and self._turn.thread != threading.get_ident()):
            self._change.release()
            raise _refusal()

    def __exit__(self, *_: object) -> None:
        """Ends the change."""
        self._change.release()

    def anew(self) -> Exclusive:
        """For a change after which it does not matter who has moved the arms before."""
        self._mixed = False
        return self

    @contextlib.contextmanager
    def loop(self) -> Generator[_Turn]:
        """A loop, which alone moves the arms, within `with turn:`; OctarmError if there is one."""
        if not self._loop.acquire(blocking=False):
            raise _refusal()
        try:
            yield self._turn
        finally:
            self._loop.release()


class _Turn:
    """The part of a loop in which its thread may move the arms."""

    thread: int | None = None

    def __enter__(self) -> None:
        self.thread = threading.get_ident()

    def __exit__(self, *_: object) -> None:
        self.thread = None


def _refusal() -> OctarmError:
    return OctarmError(
        "this environment is in use by another thread or loop; each of them needs its own, "
        "from octarm.load"
    )
