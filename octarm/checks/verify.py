"""Whether a run, or an episode of a sweep, comes out again bit by bit, and where it does not."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octarm.checks import run_files
from octarm.checks.differences import Comparison, Difference, compare, listed, origin
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

_RESULTS = ("disturbances", "metrics", "status", "message", "digest")

# All that may differ: versions and machine, which are named instead; the command, which the
# SHA-256 of run.json covers; and what depends on where within a period a run was interrupted.
_MAY_DIFFER = (*runs.NAMED, "command")
_OF_INTERRUPTED = ("disturbances", "message")


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunCheck(Comparison):
    """A run folder beside a re-run of what its `run.json` says.

    Differences are those of `run.json`, of the form of arrays, of checksums and of files; those of
    results only when no array deviates, and those of the recording when nothing else differs. The
    digests are those that `run.json` and `run.npz` state, and that of the re-run.
    """

    rows: int
    arrays: int
    recorded: bool
    deviations: tuple[run_files.Deviation, ...]
    digests: tuple[str, str, str]

    @property
    def identical(self) -> bool:
        """Whether everything came out again."""
        return not self.deviations and not self.differences and len(set(self.digests)) == 1

    def lines(self) -> list[str]:
        """The outcome, for the terminal."""
        if self.identical:
            recording = ", the recording" if self.recorded else ""
            same = f"{self.rows} control instants, {self.arrays} arrays{recording} and run.json"
            return [f"identical: {same}, bit for bit", *self.harmless_changes()]
        lines = [f"different, although q and v are the same at all {self.rows} control instants"]
        if {"rows", *(f"{x} of {a}" for x in ("type", "shape") for a in "qv")} & {
            d.key for d in self.differences
        }:
            lines = ["different"]
        for d in [d for d in self.deviations if d.array in ("q", "v")][:1]:
            begin = f"different from t = {d.t:.9g} s on, control instant {d.row} of {self.rows}"
            lines = [f"{begin}: {d.array} of {d.place} was {d.was!r} and is {d.now!r}"]
        if self.deviations:
            lines.append(
                "  array               first at t [s]  of        was -> is (largest difference)"
            )
        for d in self.deviations:
            numbers = f"{d.was!r} -> {d.now!r} ({d.largest:.2g})"
            lines.append(f"  {d.array:<18}  {d.t:<14.9g}  {d.place:<8}  {numbers}")
        lines += [*listed(self.differences, "entry"), self._diagnosis()]
        return lines if self.digests[0] == self.digests[2] else [*lines, *self.origins()]

    def _diagnosis(self) -> str:
        stated, kept, now = self.digests
        if now == stated and (self.deviations or kept != now):
            return "the re-run has the digest that run.json states: run.npz was changed"
        if now == stated:
            return (
                "the motion came out again: the files were changed, or this version writes "
                "something else"
            )
        if now == kept and not self.deviations:
            return "the re-run has the digest that run.npz states: run.json was changed"
        if changes := self.changes():
            return f"changed since the run: {', '.join(changes)}"
        unknown = [key for key in self.now if key not in self.then]
        missing = f", and {', '.join(unknown)} are not known" if unknown else ""
        return f"run.json or the code was changed: versions and machine are as then{missing}"


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
    now, written = run_files.saved_arrays(again), runs.written(described)
    names = environment.physics.coordinates.names
    form, deviations = run_files.array_differences(was, now, names)
    stated = {key: value for key, value in description.items() if key != runs.SUMS}
    if deviations:  # what was measured of another motion is another one anyway
        form = [d for d in form if d.key != f"digest in {runs.ARRAYS}"]
        stated |= {key: written[key] for key in _RESULTS if key in stated}
    may_differ = (*_MAY_DIFFER, *(_OF_INTERRUPTED if interrupted else ()))
    entries = [*compare(stated, written, may_differ)]
    sums = _unexplained(
        run_files.checksum_differences(folder, description), entries, [*form, *deviations]
    )
    recording = folder / runs.RECORDING
    if recording.is_file() and not (entries or form or deviations or sums):
        as_then = written | {key: description[key] for key in may_differ}
        sums = [*run_files.recording_differences(recording, again, as_then)]
    return RunCheck(
        rows=len(was["t"]),
        arrays=len(was.keys() - Ending._fields),
        recorded=recording.is_file(),
        deviations=tuple(deviations),
        differences=(*form, *entries, *sums),
        digests=(str(description.get("digest")), str(was.get("digest")), again.digest),
        then=origin(description),
        now=origin(described),
    )


def _stored(folder: Path, description: Mapping[str, Any]) -> dict[str, np.ndarray]:
    file = folder / runs.ARRAYS
    if not file.is_file():
        killed = description.get("status") == runs.RUNNING
        why = "it is still going on or was killed" if killed else "it is incomplete"
        raise OctarmError(f"{folder} has no {runs.ARRAYS} to compare with: {why}")
    return run_files.stored_arrays(file)


def _interrupting(rows: int, progress: Callable[[], object] | None) -> Callable[[], object]:
    """A `progress` that interrupts the run after so many rows."""
    count = itertools.count(1)

    def step() -> None:
        if progress is not None:
            progress()
        if next(count) == rows:
            raise KeyboardInterrupt

    return step


def _unexplained(
    sums: Sequence[Difference], entries: Sequence[object], arrays: Sequence[object]
) -> list[Difference]:
    """The differing checksums but those of files of which it is known already what differs."""
    known = {runs.DESCRIPTION: entries or arrays, runs.ARRAYS: arrays}
    return [d for d in sums if not known.get(d.key.removeprefix(f"{runs.SUMS}."))]


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpisodeCheck(Comparison):
    """A row of a sweep's table compared with that of the episode run alone.

    Differences are those of the columns, the checkpoints aside, and of the controller's gains for
    the nominal arm. The motion parts between two instants [s], if it does.
    """

    episode: int
    label: str
    between: tuple[float, float] | None
    gains: tuple[Difference, ...]
    recorded: Path | None

    @property
    def identical(self) -> bool:
        """Whether everything came out again."""
        return self.between is None and not self.differences and not self.gains

    def lines(self) -> list[str]:
        """The outcome, for the terminal."""
        head = f"episode {self.episode} ({self.label})"
        if self.identical:
            same = f"{head}: identical when run alone: digest, checkpoints and all measures"
            return [same, *self.harmless_changes()]
        if self.between is None:
            lines = [f"{head}: the motion is the same, but not what the table says of it"]
        else:
            begin, end = self.between
            lines = [f"{head}: different from an instant between t = {begin:g} s and {end:g} s on"]
            if self.recorded is not None:
                lines.append(f"  octarm verify {self.recorded} says from which one on")
        lines += [*listed(self.differences, "column"), *listed(self.gains, "gain")]
        return [*lines, *self.origins()]


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
    gains = runs.gains_of(spec.controller(arms.controller, spec.all_believed()[0], factory))
    return EpisodeCheck(
        episode=episode,
        label=_label(sweep.plan, episode),
        between=first_difference(was, now, spec.duration),
        differences=tuple(compare(stored, again, ["wall_time"])),
        gains=tuple(compare(sweep.gains.get(arms.controller, {}), gains)),
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
