"""A bar on a terminal that shows how far a sweep is."""

from __future__ import annotations

import sys
import time

from tqdm import tqdm

from octarm.sweeps.plan import Plan
from octarm.sweeps.spec import SweepSpec


class ProgressBar:
    """Episodes, how many a second, simulated seconds a second, and the time left.

    Parts of episodes under way count, so that the bar moves while a shard is at work. Its methods
    are what `octarm.sweep` takes as `progress`, `under_way` and `say`.
    """

    def __init__(self, spec: SweepSpec) -> None:
        """A bar for a sweep; it is shown on terminals only."""
        self._duration = spec.duration
        self._bar = tqdm(
            total=Plan(spec).episodes,
            disable=None,
            leave=False,
            unit=" episodes",
            bar_format="{percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}, "
            "{rate_noinv_fmt}{postfix}]",
        )
        self._done: int | None = None
        self._under_way = 0.0
        self._started = time.time()

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def update(self, episodes: int) -> None:
        """So many episodes are finished."""
        if self._done is None:  # those that were there already take no time
            self._done = self._bar.initial = self._bar.n = episodes
            self._started = self._bar.start_t = time.time()
            self._bar.refresh()
            return
        self._done += episodes
        self.go_on(max(0.0, self._under_way - episodes))

    def go_on(self, under_way: float) -> None:
        """Those under way are worth so many."""
        self._under_way = under_way
        self._bar.n = (self._done or 0) + int(under_way)
        run = (self._bar.n - self._bar.initial) * self._duration
        speed = run / max(1e-3, time.time() - self._started)
        self._bar.set_postfix_str(f"{digits(speed)} simulated s/s")  # draws the bar

    def say(self, sentence: str) -> None:
        """Prints a sentence beside the bar."""
        self._bar.clear()
        print(f"octarm: {sentence}", file=sys.stderr)


def digits(number: float) -> str:
    """A number with three digits, or all of those before the point."""
    return f"{number:.0f}" if number >= 999.5 else f"{number:.3g}"
