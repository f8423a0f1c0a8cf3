"""Arms are moved by one user at a time: a second thread, or a second loop, is refused."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Generator

from octarm.errors import OctarmError


class Exclusive:
    """`with exclusive:` stands around whatever moves the arms; a second user is refused there."""

    def __init__(self) -> None:
        self._user = threading.RLock()
        self._turn: _Turn | None = None  # of the loop that there is
        self._mixed = False  # two threads have met, and nobody knows whose state this is

    def __enter__(self) -> None:
        """Begins a change.

        Raises OctarmError if another thread or a loop moves the arms, or two threads have done so
        since they were reset.
        """
        if not self._user.acquire(blocking=False):
            self._mixed = self._turn is None
        elif self._mixed or (self._turn is not None and not self._turn.moves):
            self._user.release()
        else:
            return
        raise OctarmError(
            "this environment is in use by another thread or loop; each of them needs its own, "
            "from octarm.load"
        )

    def __exit__(self, *_: object) -> None:
        """Ends the change."""
        self._user.release()

    def anew(self) -> Exclusive:
        """For a change after which it does not matter who has moved the arms before."""
        self._mixed = False
        return self

    @contextlib.contextmanager
    def loop(self) -> Generator[_Turn]:
        """A loop, which alone moves the arms, within `with turn:`; OctarmError if there is one."""
        with self.anew():
            self._turn = turn = _Turn()
            try:
                yield turn
            finally:
                self._turn = None


class _Turn:
    """The part of a loop in which it moves the arms."""

    moves = False

    def __enter__(self) -> None:
        self.moves = True

    def __exit__(self, *_: object) -> None:
        self.moves = False
