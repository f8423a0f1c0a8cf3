"""How far a sweep is: a note that each shard at work leaves, and a bar on the terminal.

The process that runs a shard notes in a file of the sweep's folder, about once a second, which
share of it is done. That works on any executor whose workers see the folder, and costs nothing
where they do not.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path

from dm_control.rl import control

from octarm.bars import bar as new_bar
from octarm.interfaces import Instant
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec import SweepSpec

_EVERY = 1.0  # [s]


class Note:
    """Which share of a shard is done, in a file; an observer of `simulate` that writes it.

    Attributes:
        file: in which it stands; it is gone when the note is taken back.
    """

    def __init__(self, file: Path, duration: float) -> None:
        """A note in a file, on a run of so many seconds."""
        self.file, self._duration, self._due = file, duration, 0.0

    def __call__(self, instant: Instant) -> None:
        """Takes a control instant."""
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + _EVERY
            with contextlib.suppress(OSError):  # such as a folder that is not seen from here
                part = self.file.with_suffix(".part")
                part.write_text(f"{instant.measurement.t / self._duration:.6f}")
                part.replace(self.file)

    def share(self) -> float:
        """Which share is done, as far as known [1]."""
        try:
            return min(1.0, max(0.0, float(self.file.read_text())))
        except (OSError, ValueError):  # none yet
            return 0.0


@contextlib.contextmanager
def notes_in(folder: Path) -> Generator[Path]:
    """A folder for notes, of which nothing is left afterwards; its absolute path."""
    folder = folder.resolve()
    shutil.rmtree(folder, ignore_errors=True)  # what a process that was killed has left
    folder.mkdir(exist_ok=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def arm_seconds(
    environment: control.Environment, duration: float, progress: Callable[[float], object]
) -> Generator[Callable[[Instant], None]]:
    """An observer that reports the seconds that a run simulates, all arms counted.

    In the end it reports what was not needed since all arms diverged.
    """
    period, left = environment.control_timestep(), duration
    (arms,) = environment.physics.batch_shape

    def observe(_: Instant) -> None:
        nonlocal left
        left -= period
        progress(arms * period)

    yield observe
    progress(arms * max(left, 0.0))


class ProgressBar:
    """Episodes, how many a second, simulated seconds a second, and the time left.

    Parts of the episodes at work count, so that the bar moves while a shard runs. Its methods
    are what `octarm.sweep` takes as `progress` and `say`.
    """

    def __init__(self, spec: SweepSpec) -> None:
        """A bar for a sweep; it is drawn on terminals only."""
        self._duration, self._started = spec.duration, 0.0
        self._bar = new_bar(
            total=Plan(spec).episodes,
            unit=" episodes",
            bar_format="{percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}, "
            "{rate_noinv_fmt}{postfix}]",
        )

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def update(self, episodes: float) -> None:
        """So many episodes are finished; those of the first call were so before."""
        self._bar.n = int(episodes)
        if not self._started:  # they take no time
            self._bar.initial = self._bar.n
            self._started = self._bar.start_t = time.time()
        run = (self._bar.n - self._bar.initial) * self._duration
        speed = run / max(1e-3, time.time() - self._started)
        self._bar.set_postfix_str(f"{digits(speed)} simulated s/s")  # draws the bar

    def say(self, sentence: str) -> None:
        """Prints a sentence above the bar."""
        self._bar.clear()
        print(f"octarm: {sentence}", file=sys.stderr)


def digits(number: float) -> str:
    """A number with three digits, or all of those before the point."""
    return f"{number:.0f}" if number >= 999.5 else f"{number:.3g}"
