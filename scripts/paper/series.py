"""Runs of a variant over time, side by side: what figures 1 and 2 show, and what drifts."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.forces import BandLimitedNoise
from octarm.files import whole_file
from octarm.interfaces import Instant
from octarm.simulation.batch import BatchPhysics
from octarm.simulation.environment import load, whole_periods
from octarm.simulation.rollout import simulate
from paper.effort import Effort
from paper.studies import BENDS, MODELS, NOISE, SEED, SLIDES, TIME, WRONG
from paper.variants import PROPOSED, SIGN, SMC, UNGUARDED, Cast, Factory, Variant

EVERY = 0.01  # [s]; between two rows that are kept
LONG = {PROPOSED: "long-guarded", UNGUARDED: "long-unguarded"}


class Request(NamedTuple):
    """Arms of one variant.

    Attributes:
        name: of the file.
        variant: what controls them.
        reference: what they shall do.
        mismatches: model errors, each with and without noise [1].
        seeds: of the noise; those of the sweeps.
        quiet: whether there is an arm without noise for each model error, too.
        duration: [s].
    """

    name: str
    variant: Variant
    reference: str
    mismatches: tuple[float, ...]
    seeds: int
    quiet: bool
    duration: float

    @property
    def arms(self) -> int:
        """Their number."""
        return len(self.mismatches) * (self.seeds + self.quiet)

    @property
    def seconds(self) -> float:
        """What is simulated, all arms counted [s]."""
        return self.arms * self.duration


class Series(NamedTuple):
    """What n arms did at T instants.

    Attributes:
        t: shape (T,) [s].
        q_d: desired coordinates, shape (T, 2N) [m], [rad].
        q: true ones, shape (T, n, 2N); NaN from when an arm left its limits.
        E: gain of the compensation, shape (T, n, 2N) [N], [N m]; empty where there is none.
        mismatch: shape (n,) [1].
        noise: shape (n,) [1].
        diverged_at: shape (n,) [s]; NaN for arms that stayed within their limits.
    """

    t: np.ndarray
    q_d: np.ndarray
    q: np.ndarray
    E: np.ndarray
    mismatch: np.ndarray
    noise: np.ndarray
    diverged_at: np.ndarray

    def of(self, mismatch: float, noise: float) -> np.ndarray:
        """The coordinates of some of the arms, shape (T, k, 2N)."""
        return self.q[:, (self.mismatch == mismatch) & (self.noise == noise)]


def requests(cast: Cast, effort: Effort) -> list[Request]:
    """Those of figures 1 and 2 in both readings, and the long ones."""
    found = [
        Request(
            name=name_of(label, reference),
            variant=cast[label],
            reference=reference,
            mismatches=MODELS,
            seeds=effort.seeds,
            quiet=True,
            duration=effort.short,
        )
        for label in shown(effort)
        for reference in readings(effort)
    ]
    if effort.long:
        for label, name in LONG.items():
            variant = cast[label]
            found.append(Request(name, variant, BENDS, (WRONG,), effort.seeds, False, effort.long))
    return found


def shown(effort: Effort) -> tuple[str, ...]:
    """The variants of figures 1 and 2."""
    return (SIGN, SMC, PROPOSED) if effort.complete else (SMC, PROPOSED)


def readings(effort: Effort) -> tuple[str, ...]:
    """The references of figures 1 and 2."""
    return (BENDS, SLIDES) if effort.complete else (BENDS,)


def name_of(label: str, reference: str) -> str:
    """The name of a series of figures 1 and 2."""
    return f"{reference}-{label}"


def run(request: Request, factory: Factory) -> Series:
    """Runs the arms."""
    seeds = [*([-1] if request.quiet else []), *range(request.seeds)]
    mismatch = np.repeat(request.mismatches, len(seeds))
    noise = np.tile([0.0 if seed < 0 else NOISE for seed in seeds], len(request.mismatches))
    environment = load(
        request.reference,
        disturbances=[BandLimitedNoise(ratio=noise[:, None], correlation_time=TIME)],
        batch=len(noise),
        seed=[np.random.SeedSequence(SEED, spawn_key=(max(i, 0),)) for i in seeds]
        * len(request.mismatches),
    )
    nominal = nominal_parameters().mismatched(mismatch)
    controller = factory(request.variant.controller, nominal, request.variant.gains)
    period = environment.control_timestep()
    keeper = _Keeper(environment.physics, whole_periods(EVERY, period))
    simulate(environment, controller, request.duration, keeper)
    physics: BatchPhysics = environment.physics
    columns = {name: np.stack(rows) for name, rows in keeper.rows.items()}
    t = EVERY * np.arange(len(columns["q"]))
    E = columns.get("E", np.empty(0))
    return Series(t, columns["q_d"], columns["q"], E, mismatch, noise, physics.diverged_at())


class _Keeper:
    """Keeps every k-th instant."""

    def __init__(self, physics: BatchPhysics, every: int) -> None:
        self.rows: dict[str, list[np.ndarray]] = {}
        self._physics, self._every, self._seen = physics, every, 0

    def __call__(self, instant: Instant) -> None:
        if self._seen % self._every == 0:
            lost = ~self._physics.intact()[:, None]
            row = {"q": np.where(lost, np.nan, instant.q), "q_d": instant.reference.q}
            if "E" in instant.command.signals:
                row["E"] = np.where(lost, np.nan, instant.command.signals["E"])
            for name, values in row.items():
                self.rows.setdefault(name, []).append(np.array(values))
        self._seen += 1


def write(series: Series, path: Path) -> None:
    """Writes the arrays, whole or not at all."""
    with whole_file(path) as part, open(part, "wb") as file:
        np.savez(file, allow_pickle=False, **series._asdict())


def read(path: Path) -> Series:
    """Reads what `write` wrote."""
    with np.load(path, allow_pickle=False) as file:
        return Series(**{name: file[name] for name in Series._fields})
