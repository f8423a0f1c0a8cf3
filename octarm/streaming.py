"""The loop for runs of any length: what happens goes on block by block, and none of it is held."""

from __future__ import annotations

import contextlib
import hashlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import FrameType
from typing import Any

import numpy as np
from dm_control.rl import control

from octarm.archive import BLOCK, Ending
from octarm.interfaces import Controller
from octarm.plant import ArmPhysics
from octarm.rollout import Instant, drive
from octarm.trajectory import Trajectory

SIGNALS = (signal.SIGINT, signal.SIGTERM)  # what ends a run early


def rollout(
    environment: control.Environment,
    controller: Controller,
    duration: float,
    *,
    keep: Callable[[Trajectory], object],
    progress: Callable[[], object] | None = None,
    block: int = BLOCK,
) -> Ending:
    """Runs one episode of one arm from the start, as `octarm.rollout.rollout` does.

    An interrupt ends the run; a block of rows that is being kept is kept whole before.

    Args:
        environment: what `octarm.load` returns, possibly wrapped.
        controller: see `octarm.interfaces`.
        duration: length of the run [s], rounded up to whole control periods.
        keep: called with every `block` of rows while the run goes on, and with the last ones.
        progress: called after every control period.
        block: number of rows.

    Returns:
        How it ended.

    Raises:
        ValueError: see there.
        KeyboardInterrupt: if interrupted before there was a row.
    """
    physics = environment.physics
    if physics.batch_shape:
        raise ValueError(
            f"a trajectory records one arm; this environment has {physics.batch_shape[0]}"
        )
    rows = _Rows(physics, block)

    def hand_on() -> None:
        with held_interrupts():
            keep(rows.take())

    def observe(instant: Instant) -> None:
        rows.append(instant)
        if progress is not None:
            progress()
        if rows.full:
            hand_on()

    status = ""
    try:
        message = drive(environment, controller, duration, observe)
    except KeyboardInterrupt:
        if not rows.count:
            raise
        status, message = "interrupted", f"interrupted at t = {physics.time():.6g} s"
    if not rows.empty:
        with contextlib.suppress(KeyboardInterrupt):  # the run is over, there is nothing to end
            hand_on()
    return Ending(status or ("diverged" if message else "ok"), message, rows.digest())


def joined(blocks: Sequence[Trajectory], ending: Ending) -> Trajectory:
    """Blocks of rows as one trajectory."""
    tables = [dict(rows.arrays()) for rows in blocks]
    arrays = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    return Trajectory.from_arrays(arrays, ending._asdict())


@contextlib.contextmanager
def held_interrupts() -> Iterator[None]:
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


class _Rows:
    """A block of rows that fills up, and the digest of all states so far.

    Attributes:
        count: number of rows so far, those included that were taken.
    """

    def __init__(self, physics: ArmPhysics, size: int) -> None:
        self._physics, self._size = physics, size
        self._used = self.count = 0
        self._columns: dict[str, np.ndarray] = {}
        self._states: list[bytes] = []
        self._hash = hashlib.sha256()

    @property
    def empty(self) -> bool:
        """Whether all rows were taken."""
        return self._used == 0

    @property
    def full(self) -> bool:
        """Whether the next row would not fit."""
        return self._used == self._size

    def append(self, instant: Instant) -> None:
        """One control instant and the period after it; not at all if it is interrupted."""
        row = _row(instant, self._physics)
        if not self._columns:
            self._columns = {
                name: np.empty((self._size, *np.shape(value))) for name, value in row.items()
            }
        for name, column in self._columns.items():
            column[self._used] = row[name]
        del self._states[self._used :]
        self._states.append(self._physics.integration_state().tobytes())
        self._used, self.count = self._used + 1, self.count + 1

    def take(self) -> Trajectory:
        """The rows since the last time."""
        for state in self._states[: self._used]:
            self._hash.update(state)
        arrays = {name: column[: self._used] for name, column in self._columns.items()}
        self._states, self._used = [], 0
        return Trajectory.from_arrays(arrays, Ending("ok", "", "")._asdict())

    def digest(self) -> str:
        """Of the rows that were taken."""
        return self._hash.hexdigest()


def _row(instant: Instant, physics: ArmPhysics) -> Mapping[str, Any]:
    """The numbers of a row by name, as a trajectory has them."""
    measurement, reference = instant.measurement, instant.reference
    row: dict[str, Any] = {
        "t": measurement.t,
        "q": instant.q,
        "v": instant.v,
        "q_d": reference.q,
        "v_d": reference.v,
        "tau": instant.tau,
        "force": instant.command.force,
        "disturbance": instant.disturbance,
    }
    signals = dict(instant.command.signals)
    if physics.acting is not None and physics.acting.sensors:
        signals |= {"q_measured": measurement.q, "v_measured": measurement.v}
    taken = [name for name in signals if name in row]
    if taken:
        raise ValueError(f"a signal cannot be called {taken[0]!r}: the trajectory has that")
    return row | signals
