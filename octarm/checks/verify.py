"""Whether a run, or an episode of a sweep, comes out again bit by bit, and where it does not."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from octarm.checks.differences import (
    Comparison,
    Deviation,
    array_differences,
    checksum_differences,
    compare,
    listed,
    origin,
    recording_differences,
    stored_arrays,
)
from octarm.declared import CodeChanged
from octarm.errors import OctarmError
from octarm.interfaces import ControllerFactory
from octarm.runs import folder as runs
from octarm.runs.experiment import Experiment, perform
from octarm.runs.versions import host, versions
from octarm.simulation.trajectory import Ending
from octarm.sweeps import engine_check
from octarm.sweeps.episodes import FinishedSweep, first_difference
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import run_arms
from octarm.sweeps.store import RECORDED, origin_of

# All that may differ: versions and machine, which are named instead; the command, which the
# SHA-256 of run.json covers; and what depends on where within a period a run was interrupted.
_MAY_DIFFER = (*runs.NAMED, "command")
_OF_INTERRUPTED = ("disturbances", "message")


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunCheck(Comparison):
    """A run folder beside a re-run of what its `run.json` says.

    Differences are those of `run.json`, of the form of arrays, of checksums and of files, and those
    of the recording when nothing else differs.
    """

    rows: int
    arrays: int
    recorded: bool
    deviations: tuple[Deviation, ...]

    @property
    def identical(self) -> bool:
        """Whether everything came out again."""
        return not self.deviations and not self.differences

    def lines(self) -> list[str]:
        """The outcome, for the terminal."""
        if self.identical:
            recording = ", the recording" if self.recorded else ""
            same = f"{self.rows} control instants, {self.arrays} arrays{recording} and run.json"
            return [f"identical: {same}, bit for bit"]
        moved = [d for d in self.deviations if d.array in ("q", "v")]
        lines = ["different"]
        if moved:
            d, *_ = moved
            begin = f"different from t = {d.t:.9g} s on, control instant {d.row} of {self.rows}"
            lines = [f"{begin}: {d.array} of {d.place} was {d.was!r} and is {d.now!r}"]
        elif not {"rows", "form of q", "form of v"} & {d.key for d in self.differences}:
            lines = [
                f"different, although q and v are the same at all {self.rows} control instants"
            ]
        if self.deviations:
            lines.append(
                "  array               first at t [s]  of        was -> is (largest difference)"
            )
        for d in self.deviations:
            numbers = f"{d.was!r} -> {d.now!r} ({d.largest:.2g})"
            lines.append(f"  {d.array:<18}  {d.t:<14.9g}  {d.place:<8}  {numbers}")
        return [*lines, *listed(self.differences, "entry"), *self.origins()]


def check_run(
    folder: Path, factory: ControllerFactory, progress: Callable[[], object] | None = None
) -> RunCheck:
    """Runs again what `run.json` of a run folder says, and compares all that the folder holds.

    A run that diverged or was interrupted is repeated up to where it ended. The factory makes the
    controller from all its gains; the progress is called after every control period. Raises
    OctarmError if the folder holds no complete run, or one that cannot be made again, CodeChanged,
    before anything is run, if code that is not built in is not what it was, and KeyboardInterrupt.
    """
    description = runs.read_description(folder)
    was = _stored(folder, description)
    interrupted = "status" in was and str(was["status"]) == "interrupted"
    try:
        experiment = Experiment.from_description(description)
        environment, controller = experiment.begin(factory)
    except CodeChanged:
        raise
    except ValueError as error:
        raise OctarmError(f"{folder} cannot be run again: {error}") from None
    announced = experiment.announcement(environment, controller)
    if interrupted:
        progress = _interrupting(len(was["t"]), progress)
    again, described = perform(environment, controller, announced, progress=progress)
    if again.status == "interrupted" and not (interrupted and len(again) == len(was["t"])):
        raise KeyboardInterrupt
    now, written = again.saved(), runs.written(described)
    names = environment.physics.coordinates.names
    form, deviations = array_differences(was, now, names)
    stated = {key: value for key, value in description.items() if key != runs.SUMS}
    may_differ = (*_MAY_DIFFER, *(_OF_INTERRUPTED if interrupted else ()))
    differences = [
        *form,
        *compare(stated, written, may_differ),
        *checksum_differences(folder, description),
    ]
    recording = folder / runs.RECORDING
    if recording.is_file() and not (differences or deviations):
        as_then = written | {key: description[key] for key in may_differ}
        differences = [*recording_differences(recording, again, as_then)]
    return RunCheck(
        rows=len(was["t"]),
        arrays=len(was.keys() - Ending._fields),
        recorded=recording.is_file(),
        deviations=tuple(deviations),
        differences=tuple(differences),
        then=origin(description),
        now=origin(described),
    )


def _stored(folder: Path, description: Mapping[str, Any]) -> dict[str, np.ndarray]:
    file = folder / runs.ARRAYS
    if not file.is_file():
        killed = description.get("status") == runs.RUNNING
        why = "it is still going on or was killed" if killed else "it is incomplete"
        raise OctarmError(f"{folder} has no {runs.ARRAYS} to compare with: {why}")
    return stored_arrays(file)


def _interrupting(rows: int, progress: Callable[[], object] | None) -> Callable[[], object]:
    """A `progress` that interrupts the run after so many rows."""
    count = itertools.count(1)

    def step() -> None:
        if progress is not None:
            progress()
        if next(count) == rows:
            raise KeyboardInterrupt

    return step


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpisodeCheck(Comparison):
    """A row of a sweep's table compared with that of the episode run alone.

    Differences are those of the columns, the checkpoints aside. The motion parts between two
    instants [s], if it does.
    """

    episode: int
    label: str
    between: tuple[float, float] | None
    recorded: Path | None

    @property
    def identical(self) -> bool:
        """Whether everything came out again."""
        return self.between is None and not self.differences

    def lines(self) -> list[str]:
        """The outcome, for the terminal."""
        head = f"episode {self.episode} ({self.label})"
        if self.identical:
            return [f"{head}: identical when run alone: digest, checkpoints and all measures"]
        if self.between is None:
            lines = [f"{head}: the motion is the same, but not what the table says of it"]
        else:
            begin, end = self.between
            lines = [f"{head}: different from an instant between t = {begin:g} s and {end:g} s on"]
            if self.recorded is not None:
                lines.append(f"  octarm verify {self.recorded} says from which one on")
        return [*lines, *listed(self.differences, "column"), *self.origins()]


def check_episode(sweep: FinishedSweep, episode: int, factory: ControllerFactory) -> EpisodeCheck:
    """Runs an episode of a sweep alone, and compares; the factory is the one that the sweep had.

    Raises OctarmError if the episode is not there, or cannot be made again.
    """
    row = sweep.row(episode)
    (stored,) = row.to_pylist()
    arms, spec = sweep.plan.episode(episode), sweep.plan.spec
    (again,) = run_arms(sweep.plan, arms, factory).to_pylist()
    was, now = (values.pop("checkpoints") for values in (stored, again))
    for values in (stored, again):  # that an episode alone does not show again
        values.pop(engine_check.COLUMN, None)
    return EpisodeCheck(
        episode=episode,
        label=_label(sweep.plan, episode),
        between=first_difference(was, now, spec.duration),
        differences=tuple(compare(stored, again, ["wall_time"])),
        recorded=next(iter((sweep.path / RECORDED).glob(f"{episode}-*")), None),
        then=origin(origin_of(row)),
        now=origin({"versions": versions(spec.engine, spec.code), "host": host()}),
    )


def _label(plan: Plan, episode: int) -> str:
    number = np.array([episode])
    values = {name: column[0] for name, column in plan.values(number).items()}
    words = [str(values.pop(name)) for name in ("controller", "reference")]
    for name, value in values.items():
        words.append(f"{name} {value}" if isinstance(value, str) else f"{name} {value:g}")
    return ", ".join([*words, f"seed {plan.seeds(number)[0]}"])
