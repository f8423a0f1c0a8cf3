"""How much is run: all of it, or a small part with the same rules."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is run.

    Attributes:
        name: `full` or `quick`.
        seeds: in each cell with noise.
        duration: of an episode of the main study [s].
        short: of an episode of the other studies [s].
        mismatches: of the nominal models in the main study without noise [1].
        apart: whether cells without noise have a sweep of their own, with a single seed.
        long: of the episodes that show drift, none if 0 [s].
        rates: at which control is tried, beside the default of 2 kHz [Hz].
        times: correlation times of the noise that are tried, beside 10 ms [s].
        noises: of the degradation curve [1].
        complete: whether there are all controllers and studies, or those alone that verdicts need.
    """

    name: str
    seeds: int
    duration: float
    short: float
    mismatches: tuple[float, ...]
    apart: bool
    long: float
    rates: tuple[float, ...]
    times: tuple[float, ...]
    noises: tuple[float, ...]
    complete: bool


# Episodes end with whole periods of the sine, 2 s, after the 2 s that are not counted.
FULL = Effort(
    name="full",
    seeds=64,
    duration=6.0,
    short=4.0,
    mismatches=(-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3),
    apart=True,
    long=20.0,
    rates=(500.0, 1000.0, 5000.0),
    times=(0.001, 0.1),
    noises=(0.2, 0.4, 0.6, 0.8, 1.0, 1.2),
    complete=True,
)
QUICK = Effort(
    name="quick",
    seeds=4,
    duration=4.0,
    short=4.0,
    mismatches=(-0.3, 0.0, 0.3),
    apart=False,
    long=0.0,
    rates=(),
    times=(),
    noises=(),
    complete=False,
)
